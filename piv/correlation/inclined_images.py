"""Particle images that are longer along a diagonal: streaks, astigmatism, coma.

The Gaussian fit through three points reads each component along one axis. Of images whose correlation peak is
exp(-d^T M d/4), d to the peak, it reads not r, what is left to find, but along u

    r_u + k_u r_v,      k_u = M_uv/M_uu,

and the same along v. Passes still end where both are zero, but an error along the images falls only by k a pass, k
= M_uv/sqrt(M_uu M_vv): of streaks five times as long as wide by a tenth. So both readings are solved for r. The
noise of the two is that of the readings over sqrt(1 - k^2).

M is read from the frame with itself, at 1 and 2 px along both axes and at 1 px along both diagonals, whose
difference is tanh(M_uv/2) of their sum; none of them sees the noise of pixels. It is read in cells, since streaks
turn with the flow.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import map_parts
from piv.correlation.windows import WindowGrid

SHAPE_CELL_PX, ROWS = 16, 4  # side of a cell; one row of so many is read
WINDOW_CELLS = 2.0  # means over about a window: cells hold few particles
MIN_INCLINATION = 0.1  # median of |k|: of round images 0.01 to 0.05 by chance; they are read as they are
MAX_INCLINATION = 0.85  # of |k|: beyond it the noise of the fit grows more than passes gain
MAX_STRETCH = 3.0  # of the two widths over each other
MIN_FALL = 0.02  # of the logarithm of the correlation from 1 to 2 px

Floats = NDArray[np.float64]


class Inclination(NamedTuple):
    """`k` (rows, columns) of cells of a frame, and the widths along u and v over each other, sqrt(M_vv/M_uu)."""

    k: Floats
    stretch: Floats

    def solve(self, read_px: Floats, grid: WindowGrid) -> Floats:
        """Return the displacement (ny, nx, 2) whose components were read along the axes of windows of `grid`."""
        k, stretch = (self._at(part, grid) for part in (self.k, self.stretch))
        u, v = read_px[..., 0], read_px[..., 1]
        solved = np.stack((u - k * stretch * v, v - k / stretch * u), axis=-1)
        return np.clip(solved / (1.0 - np.square(k))[..., None], -1.0, 1.0)

    def noise_growth(self, grid: WindowGrid) -> Floats:
        """Return the noise (ny, nx) of a component over that of its reading."""
        return np.asarray(1.0 / np.sqrt(1.0 - np.square(self._at(self.k, grid))))

    def _at(self, cells: Floats, grid: WindowGrid) -> Floats:
        rows, columns = (
            np.clip(place.astype(np.int64) // SHAPE_CELL_PX, 0, count - 1)
            for place, count in zip((grid.y_px, grid.x_px), cells.shape, strict=True)
        )
        return np.asarray(cells[np.ix_(rows, columns)])


def inclination_of(frame: NDArray[np.float32]) -> Inclination | None:
    """Measure how the images of a frame lie; None if they are as wide along both diagonals.

    Parameters
    ----------
    frame : ndarray of float32, shape (H, W)
        Without the mean of its surroundings.
    """
    lags = (
        ((0, 0), (0, 1)),
        ((0, 0), (0, 2)),
        ((0, 0), (1, 0)),
        ((0, 0), (2, 0)),
        ((0, 0), (1, 1)),
        ((1, 0), (0, 1)),
    )
    *along, down, up = map_parts(lambda pair: _in_cells(frame, *pair), lags)
    share = (down - up) / np.maximum(down + up, 1e-12)
    between = -2.0 * np.arctanh(np.clip(share, -0.95, 0.95))  # M_uv
    own_u, own_v = (
        4.0 / 3.0 * np.maximum(np.log(np.maximum(one, 1e-12) / np.maximum(two, 1e-12)), MIN_FALL)
        for one, two in (along[:2], along[2:])
    )
    k = np.clip(between / np.sqrt(own_u * own_v), -MAX_INCLINATION, MAX_INCLINATION)
    if np.median(np.abs(k)) < MIN_INCLINATION:
        return None
    return Inclination(k, np.clip(np.sqrt(own_v / own_u), 1.0 / MAX_STRETCH, MAX_STRETCH))


def _in_cells(frame: NDArray[np.float32], first: tuple[int, int], second: tuple[int, int]) -> Floats:
    """Means (rows, columns) around cells of products of pixels that lie so far apart (rows, columns)."""
    import cv2

    height, width = frame.shape[0] - 2, frame.shape[1] - 2
    one, other = (frame[row : row + height : ROWS, column : column + width] for row, column in (first, second))
    cells = max(width // SHAPE_CELL_PX, 1), max(height // SHAPE_CELL_PX, 1)
    means = cv2.resize(one * other, cells, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(means, (0, 0), WINDOW_CELLS), np.float64)
