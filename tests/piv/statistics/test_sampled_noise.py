"""The correlation of sampled noise against noise that was sampled."""

import numpy as np
import pytest

from piv.correlation.deform import deform_pair
from piv.correlation.prepare import Pair
from piv.correlation.windows import window_grid
from piv.statistics.ensemble import noise_correlation


@pytest.mark.parametrize("spread_px2", [0.25, 0.63, 0.9])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (1.0, 0.5), (-0.6, 1.3)])
def test_it_is_that_of_noise_in_deformed_frames(spread_px2, shift):
    rng = np.random.default_rng(1)
    shape = (512, 512)
    a, b = rng.normal(size=(2, *shape)).astype(np.float32)
    pair = Pair(a, b, np.ones(shape, np.float32), 0.0, spread_px2, 0)
    grid = window_grid(shape, 32, 0.5)
    field = np.broadcast_to(np.array(shift), (*grid.shape, 2))
    seen = deform_pair(pair.coefficients(), pair.valid, field, grid, 0.0)
    lags = np.array([(0, 0), (0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 1), (0, 4)])
    expected = noise_correlation(field, lags, spread_px2)[:, 0, 0]
    for frame in (seen.a, seen.b):
        inner = frame[20:-20, 20:-20].astype(np.float64)
        for (v, u), value in zip(lags, expected, strict=True):
            moved = frame[20 + v : shape[0] - 20 + v, 20 + u : shape[1] - 20 + u]
            assert np.mean(inner * moved) == pytest.approx(value, abs=0.01), (v, u)
