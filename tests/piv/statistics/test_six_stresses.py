"""Six stresses summed pair by pair: those of NumPy, without the noise that views have in common."""

import numpy as np
import pytest

from piv.statistics.six_stresses import COMPONENTS, StressSums

GRID = (6, 8)
TRUE = np.array([[1.0, 0.3, -0.2], [0.3, 0.6, 0.1], [-0.2, 0.1, 0.8]])


def test_sums_are_those_of_numpy_with_gaps():
    rng = np.random.default_rng(0)
    fields = 100.0 + rng.normal(0.0, 1.0, (30, *GRID, 3))
    fields[rng.random((30, *GRID)) < 0.2] = np.nan
    sums = StressSums(np.full((*GRID, 3), 99.0))
    for one in fields:
        sums.add(one, np.zeros((*GRID, 3, 3)))
    for place in np.ndindex(GRID):
        own = fields[(slice(None), *place)]
        own = own[np.isfinite(own).all(axis=-1)]
        assert sums.count[place] == len(own)
        np.testing.assert_allclose(sums.mean[place], own.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(sums.covariance[place], np.cov(own.T), rtol=1e-8, atol=1e-12)


def test_mixed_noise_is_taken_off_and_sigma_is_as_large_as_the_scatter():
    rng, pairs = np.random.default_rng(1), 400
    noise = 0.5 * np.array([[1.0, 0.2, 0.6], [0.2, 1.0, 0.0], [0.6, 0.0, 2.0]])
    sums = StressSums(np.zeros((*GRID, 3)))
    for _ in range(pairs):
        flow = rng.multivariate_normal(np.zeros(3), TRUE, GRID)
        sums.add(flow + rng.multivariate_normal(np.zeros(3), noise, GRID), np.broadcast_to(noise, (*GRID, 3, 3)))
    wanted = np.array([TRUE[i, j] for i, j in COMPONENTS])
    ratio = (sums.stresses - wanted) / sums.stress_sigma(np.full(GRID, float(pairs)))
    assert np.abs(ratio.mean(axis=(0, 1))).max() < 0.5  # 0.14 by chance; without the mixed noise 4
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("pairs", [2, 3, 60])
def test_fluctuation_is_known_from_few_pairs(pairs):
    rng, noise, grid = np.random.default_rng(2), 0.3**2 * np.eye(3), (24, 30)
    sums = StressSums(np.zeros((*grid, 3)))
    for _ in range(pairs):
        sums.add(rng.normal(0.0, np.hypot(1.0, 0.3), (*grid, 3)), np.broadcast_to(noise, (*grid, 3, 3)))
    np.testing.assert_allclose(sums.noise, 0.09)
    assert sums.fluctuation.mean() == pytest.approx(1.0, abs=0.1)
    assert sums.fluctuation.std() < 0.35  # 1.4 of two pairs by themselves


def test_no_pair_no_stress():
    sums = StressSums(np.zeros((*GRID, 3)))
    sums.add(np.full((*GRID, 3), np.nan), np.full((*GRID, 3, 3), np.nan))
    assert np.isnan(sums.mean).all()
    assert np.isnan(sums.stresses).all()
