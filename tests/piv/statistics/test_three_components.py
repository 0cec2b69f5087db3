"""Three components from several views: against dense solutions, against chance, against a single view."""

import numpy as np
import pytest

from piv.statistics.three_components import combine_views

SHAPE, NODES = (5, 10), 50
SIGMA = 0.04


def views(count, seed=0, slopes=0.3):
    """True u, v, w of 50 nodes, and slopes and standard deviations of the views of each."""
    rng = np.random.default_rng(seed)
    true = rng.normal(0.0, 1.0, (*SHAPE, 3))
    slope = (
        rng.uniform(-slopes, slopes, (count, *SHAPE, 2)) + np.linspace(-slopes, slopes, count)[:, None, None, None]
    )
    sigma = SIGMA * rng.uniform(0.5, 2.0, (count, *SHAPE, 2))
    return rng, true, slope, sigma


def seen(true, slope):
    """What views show of a velocity."""
    return true[..., :2] - slope * true[..., 2:]


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_dense_solution_of_each_node_is_the_same(count):
    rng, true, slope, sigma = views(count)
    uv = seen(true, slope) + sigma * rng.standard_normal(slope.shape)
    found = combine_views(uv, sigma**2, slope, np.ones(SHAPE), np.inf)
    assert found.has_w.all()
    for place in np.ndindex(SHAPE):
        rows, data = [], []
        for view in range(count):
            for axis in (0, 1):
                row = np.array([axis == 0, axis == 1, -slope[(view, *place, axis)]], float)
                rows.append(row / sigma[(view, *place, axis)])
                data.append(uv[(view, *place, axis)] / sigma[(view, *place, axis)])
        solved, chi2, _, _ = np.linalg.lstsq(np.array(rows), np.array(data), rcond=None)
        np.testing.assert_allclose(found.uvw[place], solved, rtol=1e-9, atol=1e-12)
        wanted = np.linalg.inv(np.array(rows).T @ np.array(rows))
        np.testing.assert_allclose(found.covariance[place], wanted, rtol=1e-8)
        np.testing.assert_allclose(found.chi2[place], chi2[0], rtol=1e-6)
    propagated = found.propagate(sigma**2)
    np.testing.assert_allclose(propagated, np.diagonal(found.covariance, axis1=-2, axis2=-1), rtol=1e-9)


def test_errors_are_as_large_as_said():
    rng, true, slope, sigma = views(2, seed=3)
    trials = 2000
    errors, chi2 = np.empty((trials, *SHAPE, 3)), 0.0
    for trial in range(trials):
        uv = seen(true, slope) + sigma * rng.standard_normal(slope.shape)
        found = combine_views(uv, sigma**2, slope, np.ones(SHAPE), np.inf)
        errors[trial] = found.uvw - true
        chi2 += found.residual_in_sigma**2 / trials
    said = np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1))
    assert np.sqrt(np.mean(np.square(errors / said))) == pytest.approx(1.0, abs=0.02)
    mean_off = errors.mean(axis=0) / said * np.sqrt(trials)
    assert np.sqrt(np.mean(np.square(mean_off))) == pytest.approx(1.0, abs=0.2)  # no bias
    assert chi2 == pytest.approx(1.0, abs=0.02)


def test_one_view_is_its_vector_with_its_perspective_error():
    _, true, slope, sigma = views(2)
    uv = seen(true, slope)
    uv[1, 2:] = np.nan
    found = combine_views(uv, sigma**2, slope, np.full(SHAPE, 0.7), np.inf)
    alone = np.s_[2:]
    assert np.isnan(found.uvw[alone][..., 2]).all()
    np.testing.assert_allclose(found.uvw[alone][..., :2], uv[0][alone], rtol=1e-12)
    wanted = sigma[0] ** 2 + (0.7 * slope[0]) ** 2
    for axis in (0, 1):
        np.testing.assert_allclose(found.covariance[alone][..., axis, axis], wanted[alone][..., axis])
    assert (found.views[alone] == 1).all()
    assert found.has_w[:2].all()


def test_w_above_the_limit_is_not_reported_and_the_assumption_helps():
    rng, _, slope, sigma = views(2, seed=5, slopes=0.01)
    errors, said = [], []
    for _ in range(400):
        true = rng.normal(0.0, 0.3, (*SHAPE, 3))
        uv = seen(true, slope) + sigma * rng.standard_normal(slope.shape)
        found = combine_views(uv, sigma**2, slope, np.full(SHAPE, 0.3), 0.3)
        hidden = ~found.has_w
        assert np.isnan(found.uvw[hidden][..., 2]).all()
        errors.append((found.uvw - true)[hidden][..., :2])
        said.append(np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1))[hidden][..., :2])
    ratio = np.concatenate(errors) / np.concatenate(said)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.03)


def test_a_camera_that_stands_elsewhere_raises_chi():
    rng, true, slope, sigma = views(3, seed=7)
    uv = seen(true, slope) + sigma * rng.standard_normal(slope.shape)
    assert combine_views(uv, sigma**2, slope, np.ones(SHAPE), np.inf).residual_in_sigma < 1.3
    uv[1, ..., 1] += 5.0 * SIGMA
    assert combine_views(uv, sigma**2, slope, np.ones(SHAPE), np.inf).residual_in_sigma > 2.0


def test_no_view_no_vector():
    _, true, slope, sigma = views(2)
    uv = seen(true, slope)
    uv[:, 0] = np.nan
    slope[:, 1] = np.nan
    found = combine_views(uv, sigma**2, slope, np.ones(SHAPE), np.inf)
    assert np.isnan(found.uvw[:2]).all()
    assert (found.views[:2] == 0).all()
    assert np.isnan(found.propagate(sigma**2)[:2]).all()
