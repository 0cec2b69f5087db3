"""Views combined with all parts of their sigma: what is common, what is assumed, and what says more than that."""

from types import SimpleNamespace

import numpy as np
import pytest

from piv.statistics.denoised_components import NoiseFilter
from rtpiv.analysis.series.joined_views import MIN_W_PLACES, _combine, _Limits

GRID = (8, 10)
NOISE, RESOLUTION = 0.02, 0.03
UNFILTERED = _Limits(1.0, NoiseFilter((), (1.0,), 0.0))


def combined(w, seen_twice, resolution=0.0, seed=0, map_sigma=0.0, common=(None, None)):
    """Two views with slopes of -0.3 and 0.3, the second of some places; u and v are the same everywhere."""
    rng = np.random.default_rng(seed)
    true = np.stack((np.full(GRID, 1.0), np.full(GRID, 0.5), np.broadcast_to(w, GRID)), axis=-1)
    slopes = [np.broadcast_to((a, 0.1 * a), (*GRID, 2)) for a in (-0.3, 0.3)]
    uv = np.stack([true[..., :2] - slope * true[..., 2:] for slope in slopes])
    uv += NOISE * rng.standard_normal(uv.shape)
    uv[1][~seen_twice] = np.nan
    variance = np.broadcast_to((map_sigma**2, 0.0), (*GRID, 2))
    views = [
        SimpleNamespace(slope=slope, map_variance=variance, joint="key", common=part)
        for slope, part in zip(slopes, common, strict=True)
    ]
    nothing = [np.zeros(GRID)] * 2  # assumed: w as u and v vary, which is not at all
    fit = _combine(views, uv, np.full(uv.shape, NOISE**2), np.full((2, *GRID), resolution), nothing, UNFILTERED)
    return true, fit


def test_w_is_as_large_where_it_is_not_measured():
    seen_twice = np.broadcast_to(np.arange(GRID[1]) < 6, GRID)
    true, fit = combined(0.5 * (-1.0) ** np.indices(GRID).sum(axis=0), seen_twice)
    assert np.isnan(fit.found.uvw[~seen_twice][:, 2]).all()
    off = (fit.found.uvw - true)[~seen_twice][:, 0]
    sigma = np.sqrt(fit.systematic + np.diagonal(fit.noise, axis1=-2, axis2=-1))[~seen_twice][:, 0]
    assert np.sqrt(np.mean(np.square(off / sigma))) == pytest.approx(1.0, abs=0.1)  # 7 by the assumption alone


def test_few_places_tell_no_size():
    few = np.arange(GRID[0] * GRID[1]).reshape(GRID) < MIN_W_PLACES - 1
    _, fit = combined(2.0, few)
    np.testing.assert_allclose(fit.systematic[~few][:, :2], 0.0, atol=1e-12)


def test_resolution_is_common_in_u_and_independent_in_w():
    everywhere = np.ones(GRID, np.bool_)
    _, fit = combined(0.0, everywhere, RESOLUTION)
    np.testing.assert_allclose(fit.systematic[..., 0], RESOLUTION**2, rtol=1e-6)  # not half of it
    np.testing.assert_allclose(fit.systematic[..., 2], 2.0 * RESOLUTION**2 / (0.6**2 + 0.06**2), rtol=1e-6)
    assert fit.tests[0, 1] == everywhere.size


def test_errors_that_maps_share_cancel_or_add():
    everywhere = np.ones(GRID, np.bool_)
    size = 0.01
    same = [np.broadcast_to(np.array([[sign * size], [0.0]]), (*GRID, 2, 1)) for sign in (1.0, 1.0)]
    apart = [same[0], -same[0]]
    found = {}
    for name, common in (("none", (None, None)), ("same", same), ("apart", apart)):
        _, fit = combined(0.0, everywhere, map_sigma=size, common=common)
        found[name] = fit.systematic.mean(axis=(0, 1))
    # Slopes of -0.3 and 0.3: u is half the sum, w the difference over -0.6 (less the part by v).
    assert found["same"][0] == pytest.approx(size**2, rel=0.02)
    assert found["same"][2] == pytest.approx(0.0, abs=1e-9)
    assert found["apart"][0] == pytest.approx(0.0, abs=1e-9)
    assert found["apart"][2] == pytest.approx((2.0 * size / 0.6) ** 2, rel=0.05)
    assert found["none"][2] == pytest.approx(2.0 * (size / 0.6) ** 2, rel=0.05)
