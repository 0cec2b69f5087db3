"""A mean filtered once, against the truth: behind glass, where pairs that are filtered lack the same detail."""

import numpy as np
import pytest
import scipy

from piv.correlation.settings import FOUND_WINDOWS
from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.denoised_mean import DenoisedMean
from piv.statistics.effective_samples import EffectiveSamples, mean_sigma
from piv.statistics.moments import Moments
from tests.piv.sigma_table import figures, flows_of, of_means

SHAPE, STEP, NOISE = (26, 30), 8, 0.1
HOW = NoiseFilter.of(FOUND_WINDOWS, STEP, FOUND_WINDOWS.denoise)
INNER = (slice(3, -3), slice(3, -3))


def pattern():
    """Displacement (ny, nx, 2) whose slopes change over six places, weaker than the noise of a vector."""
    rows, columns = np.indices(SHAPE)
    bumps = 0.06 * np.sin(2.0 * np.pi * columns / 6.0) * np.cos(2.0 * np.pi * rows / 6.0)
    return np.stack((1.0 + bumps, 0.02 * rows - bumps), axis=-1)


def means_of(pairs, seed, flow, moving=0.0):
    """Moments of filtered and of unfiltered vectors, and the mean that is filtered once."""
    rng, filtered, unfiltered = np.random.default_rng(seed), None, None
    everywhere, sigma = np.ones(SHAPE, bool), np.full((*SHAPE, 2), NOISE)
    for _ in range(pairs):
        rough = scipy.ndimage.gaussian_filter(rng.standard_normal((*SHAPE, 2)), (0.7, 0.7, 0), mode="wrap")
        vectors = flow + NOISE * rough / rough.std() + moving * rng.standard_normal(2)
        values, variance, _ = HOW.filter_vectors(vectors, sigma**2, everywhere)
        each = Moments.of(values, None, np.sqrt(variance)), Moments.of(vectors, None, sigma)
        filtered, unfiltered = each if filtered is None else (
            filtered.merge_with(each[0]), unfiltered.merge_with(each[1])
        )  # fmt: skip
    return filtered, unfiltered, DenoisedMean.of(unfiltered, filtered, HOW)


def independent(pairs):
    return EffectiveSamples(np.full((*SHAPE, 2), float(pairs)), "", converged=True)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values[INNER]))))


def test_the_mean_keeps_detail_that_every_pair_lacks():
    flow, pairs = pattern(), 48
    filtered, unfiltered, found = means_of(pairs, 1, flow)
    one_by_one, error = filtered.mean_uv - flow, found.mean - flow
    assert rms(error) < 0.5 * rms(one_by_one)
    assert rms(error) < rms(unfiltered.mean_uv - flow)
    sigma = np.hypot(found.sigma(filtered, independent(pairs)), found.taken[..., None])
    assert rms(error) / rms(sigma) == pytest.approx(1.0, abs=0.2)
    # By the scatter of filtered pairs alone, which knows of no detail in common, it was five times too sure.
    assert rms(one_by_one) > 5.0 * rms(mean_sigma(filtered, independent(pairs)))


@pytest.mark.parametrize("moving", [0.0, 0.3])
def test_without_detail_noise_goes_and_fluctuations_stay_in_sigma(moving):
    pairs, flow = 12, np.zeros((*SHAPE, 2))
    parts = [means_of(pairs, seed, flow, moving) for seed in range(2, 7)]
    error = np.stack([found.mean for _, _, found in parts])
    sigma = np.stack([found.sigma(filtered, independent(pairs)) for filtered, _, found in parts])
    stated = np.sqrt(np.mean(sigma**2))
    if moving:
        assert stated == pytest.approx(moving / np.sqrt(pairs), rel=0.15)
    else:
        assert np.std(error) < 0.35 * NOISE / np.sqrt(pairs)
        assert np.std(error) / stated == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow  # the arithmetic is held by the first test; this one holds the vectors that pairs give
def test_weak_waves_of_frames_stay_in_the_mean():
    error, ratio, within, far = figures(*of_means(lambda seed: flows_of(seed)["weak waves"], 83072, 2.4, "noisy"))
    assert error < 0.04  # 0.051 of filtered vectors
    assert ratio < 1.6  # 4.2
    assert within > 0.45  # 0.19
    assert far == 0.0


def test_places_without_noise_known_keep_their_mean():
    sigma = np.full((*SHAPE, 2), NOISE)
    sigma[:, :5] = np.nan
    flow = pattern()
    flow[20:] = np.nan
    moments = Moments.of(flow, None, sigma)
    found = DenoisedMean.of(moments, moments, HOW)
    np.testing.assert_array_equal(found.mean[:20, :5], flow[:20, :5])
    assert np.isnan(found.mean[20:]).all()
    assert (found.taken[20:] == 0.0).all()
    assert np.isfinite(found.mean[:20]).all()
