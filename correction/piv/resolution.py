"""What a vector is unsure of because its window is large, apart from noise.

Three things, added as squares:

1. **Taken off.** Detail that is no stronger than its noise goes with the noise (`correction.piv.denoise`, which
   knows what it takes).
2. **Not seen.** Of a wave of two windows the passes show the share g (`correction.piv.response`); second
   differences over half a window are twice its height, so (1 - g)/2 of them is missing.
3. **Seen in the wrong place.** A window weighs particles, not places. In a field of second derivative c its N
   independent pieces lie elsewhere than its weights, so what it sees of a curved field is off by about
   s^2 c/sqrt(N), s^2 the variance of its weights. The passes bend the predictor to the field, but by what windows
   saw, and see the rest in the same wrong places: what stays in the end is s^2 c/N times a number (`UNEVEN`,
   measured in waves of 48 to 256 px and turbulence at N = 3 to 19, windows of 16 and 32 px: 1.4 to 2.4).

The first two are the same in every pair of a steady flow; the third changes with the particles. A step within a
window is none of these, and twice as wrong as they say.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.piv.refine import window_weights
from correction.piv.response import response_of
from correction.piv.settings import PivSettings
from correction.piv.windows import WindowGrid

UNEVEN = 1.9

Floats = NDArray[np.float64]


def unresolved_px(
    vectors: Floats, taken_px: Floats, pieces: Floats, grid: WindowGrid, settings: PivSettings
) -> Floats:
    """Standard deviation (ny, nx) of a component by what windows do not resolve.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], finite everywhere.
    taken_px : ndarray of float64, shape (ny, nx)
        Standard deviation of a component of the flow that the last filter took off.
    pieces : ndarray of float64, shape (ny, nx)
        Independent pieces in a window.
    grid : WindowGrid
        Where vectors stand.
    settings : PivSettings
        How they were measured.
    """
    weights = window_weights(grid.size_px, settings.window_sigma)
    place = np.arange(grid.size_px) - (grid.size_px - 1) / 2
    spread_px2 = float((weights * place**2).sum() / weights.sum())
    shown, _ = response_of(settings, np.array([2.0 * grid.size_px]))
    apart = max(1, round(0.5 * grid.size_px / grid.step_px))
    bent_px = second_differences(vectors, apart)
    displaced = UNEVEN * spread_px2 / (apart * grid.step_px) ** 2 * bent_px / pieces
    missing = 0.5 * (1.0 - float(shown[0])) * bent_px
    total: Floats = np.sqrt(taken_px**2 + displaced**2 + missing**2)
    return total


def second_differences(vectors: Floats, apart: int) -> Floats:
    """Root mean square (ny, nx) over 3 x 3 vectors of a component's second differences over `apart` nodes."""
    square = np.zeros(vectors.shape[:2])
    for axis in range(2):
        field = np.moveaxis(vectors, axis, 0)
        step = min(apart, len(field) - 1)
        if step < 1:
            continue
        ends = 2.0 * field[0] - field[step:0:-1], 2.0 * field[-1] - field[-2 : -step - 2 : -1]
        wide = np.concatenate([ends[0], field, ends[1]])
        second = wide[2 * step :] - 2.0 * field + wide[: -2 * step]
        square += 0.5 * np.square(np.moveaxis(second, 0, axis)).sum(axis=-1)
    around: Floats = scipy.ndimage.uniform_filter(square, 3, mode="nearest")
    return np.sqrt(np.maximum(around, 0.0))  # running sums may leave less than nothing
