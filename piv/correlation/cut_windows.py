"""Uncertainty of a vector whose window a mask cuts: its light lies beside the middle of the window.

Passes continue the flow beyond what windows see, so that a window whose light has its middle at x_c says what the
flow does at its own middle x_0 where that is nearly straight. Over the way from x_c to x_0 a vector is off by

    |x_0 - x_c| (2 b + g/4),

g the gradient, b what it changes by over half a window, as second differences there say: b is seen beside the
wall, where it is less than at it (boundary layer of 20 px: errors of 0.56, 0.63, 0.70 px with windows of 16 px,
found ones and 32 px); in a flow of 0.04 px/px that does not bend up to a quarter of g is left beside a mask.

Vectors that no filter has taken noise off bend by their noise, and the largest bend around is that of noise: its
square goes off b^2 (`NOISE_BEND`, of noise that windows share as they do light, windows of 16 to 64 px).
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.refine import window_weights
from piv.correlation.resolution import second_differences
from piv.correlation.windows import WindowGrid

OF_BEND, OF_GRADIENT = 2.0, 0.25
NOISE_BEND = 3.7  # largest second difference around by noise, over its deviation: 3.3 to 4.4
CUT_CELL_PX = 4  # in which a mask is looked at
Floats = NDArray[np.float64]


def cut_px(
    vectors: Floats,
    valid: NDArray[np.float32],
    grid: WindowGrid,
    side_px: int,
    window_sigma: float,
    noise_px: Floats | None = None,
) -> Floats:
    """Standard deviation (ny, nx) of a component by light that lies beside the middle of windows.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px] at the nodes of `grid`, finite everywhere.
    valid : ndarray of float32, shape (H, W)
        How far pixels are valid, from 0 to 1.
    grid : WindowGrid
        The nodes.
    side_px : int
        Side of the windows.
    window_sigma : float
        See `piv.correlation.refine.window_weights`.
    noise_px : ndarray of float64, shape (ny, nx), optional
        Standard deviation of the noise of a component that is still in the vectors; none after the noise filter.
    """
    if valid.min() >= 1.0:
        return np.zeros(grid.shape)
    beside = beside_px(valid, grid, side_px, window_sigma)
    apart = max(1, round(0.5 * side_px / grid.step_px))
    bent = second_differences(vectors, apart)
    # Beyond the mask all is a plane: what bends is seen half a window to the other side.
    near = scipy.ndimage.maximum_filter(bent, 2 * apart + 1)
    if noise_px is not None:
        near = np.sqrt(np.maximum(np.square(near) - np.square(NOISE_BEND * noise_px), 0.0))
    near = near / (apart * grid.step_px)
    slopes = [np.gradient(vectors, grid.step_px, axis=axis) for axis in range(2) if vectors.shape[axis] > 1]
    slope = np.sqrt(sum((np.square(part).sum(axis=-1) for part in slopes), np.zeros(grid.shape)) / 2.0)
    return np.asarray(beside * (OF_BEND * near + OF_GRADIENT * slope))


def beside_px(valid: NDArray[np.float32], grid: WindowGrid, side_px: int, window_sigma: float) -> Floats:
    """Distance (ny, nx) of the middle of a window's valid weight from its own; 0 where nothing is valid."""
    import cv2

    height, width = (-(-side // CUT_CELL_PX) for side in valid.shape)
    padded = np.zeros((height * CUT_CELL_PX, width * CUT_CELL_PX), np.float32)
    padded[: valid.shape[0], : valid.shape[1]] = valid
    cells = cv2.resize(padded, (width, height), interpolation=cv2.INTER_AREA)
    whole = window_weights(side_px, window_sigma)
    reach = side_px // (2 * CUT_CELL_PX)
    place = np.arange(-reach, reach + 1.0) * CUT_CELL_PX
    bell = np.interp(place, np.arange(side_px) - (side_px - 1) / 2, whole)
    kernels = bell, place * bell
    found = [
        cv2.sepFilter2D(cells, cv2.CV_64F, kernels[along_x], kernels[along_y], borderType=cv2.BORDER_CONSTANT)
        for along_x, along_y in ((0, 0), (1, 0), (0, 1))
    ]
    at = np.ix_(
        *(
            np.clip(np.rint((middle + 0.5) / CUT_CELL_PX - 0.5), 0, count - 1).astype(np.int64)
            for middle, count in ((grid.y_px, height), (grid.x_px, width))
        )
    )
    weight, along, down = (np.asarray(part)[at] for part in found)
    seen = weight > 1e-6 * bell.sum() ** 2
    return np.asarray(np.where(seen, np.hypot(along, down) / np.where(seen, weight, 1.0), 0.0))
