"""Noise filter after views were combined: against the truth, against views that were filtered one by one."""

import numpy as np
import pytest
import scipy

from piv.correlation.settings import PivSettings
from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.three_components import combine_views

STEP = 8
SETTINGS = PivSettings(windows_px=(64, 32), finest_px=16)
SHAPE, NOISE = (40, 44), 0.03
W = 0.4


def slopes():
    """Two views whose slopes change over four places, as behind balls, 0.3 apart."""
    rows, columns = np.indices(SHAPE)
    bumps = 0.12 * np.sin(2.0 * np.pi * columns / 6.0) * np.cos(2.0 * np.pi * rows / 6.0)
    first = np.stack((bumps, 0.5 * bumps), axis=-1)
    return np.stack((first, -first + (0.3, 0.0)))


def smooth_noise(rng, shape):
    """Noise of windows that overlap, of standard deviation 1; about as white as that of several passes."""
    raw = scipy.ndimage.gaussian_filter(rng.standard_normal(shape), (0, 0.6, 0.6, 0), mode="wrap")
    return raw / raw.std()


def filtered(found, noise, beta=2.0):
    how = NoiseFilter.of(SETTINGS, STEP, beta)
    return how.apply(found, found.uvw, noise, how.filter_w(found.uvw[..., 2], noise[..., 2]))


def pair(rng, beta=2.0):
    """Error, stated sigma and unfiltered error of a pair of two views."""
    slope, variance = slopes(), np.full((2, *SHAPE, 2), NOISE**2)
    true = np.stack([np.ones(SHAPE), np.zeros(SHAPE), np.full(SHAPE, W)], axis=-1)
    uv = true[..., :2] - slope * true[..., 2:] + NOISE * smooth_noise(rng, slope.shape)
    found = combine_views(uv, variance, slope, np.zeros(SHAPE), np.inf)
    noise = np.diagonal(found.covariance, axis1=-2, axis2=-1)
    uvw, covariance, taken = filtered(found, noise, beta)
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1) + taken)
    return uvw - true, sigma, found.uvw - true, np.sqrt(noise)


def test_detail_of_the_slopes_stays_and_noise_goes():
    rng = np.random.default_rng(1)
    pairs = [pair(rng) for _ in range(20)]
    error, sigma, before, _ = (np.stack(part)[:, 3:-3, 3:-3] for part in zip(*pairs, strict=True))
    assert np.std(error[..., 2]) < 0.5 * np.std(before[..., 2])
    for axis in range(3):
        assert np.sqrt(np.mean(np.square(error[..., axis]) / np.square(sigma[..., axis]))) == pytest.approx(
            1.0, abs=0.3
        )
    # The mean of the pairs lacks nothing that has the pattern of the slopes.
    pattern = slopes()[0, 3:-3, 3:-3, 0]
    for axis in (0, 2):
        share = (error.mean(axis=0)[..., axis] * pattern).sum() / np.square(pattern).sum() / W
        assert abs(share) < 0.05


def test_places_without_w_are_filtered_apart():
    rng = np.random.default_rng(2)
    slope, variance = slopes(), np.full((2, *SHAPE, 2), NOISE**2)
    uv = -slope * W + NOISE * smooth_noise(rng, slope.shape)
    uv[1, :, 20:] = np.nan
    found = combine_views(uv, variance, slope, np.full(SHAPE, W), np.inf)
    noise = np.diagonal(found.covariance, axis1=-2, axis2=-1)
    uvw, covariance, _ = filtered(found, noise)
    assert np.isnan(uvw[:, 20:, 2]).all()
    assert np.isfinite(uvw[..., :2]).all()
    assert np.isfinite(covariance).all()
    assert abs(np.mean(uvw[:, 16:20, 0])) < 0.01  # not drawn to the perspective error beside it


def test_no_filter_changes_nothing():
    error, sigma, before, noise = pair(np.random.default_rng(3), beta=0.0)
    np.testing.assert_allclose(error, before, atol=1e-12)
    np.testing.assert_allclose(sigma, noise, rtol=1e-9)
