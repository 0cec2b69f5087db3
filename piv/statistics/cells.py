"""Cells of 8 px over which the products of an ensemble correlation are summed, and the windows made of them.

A window of 8, 16 or 32 px is a sum of cells that is made at the end, so one sweep serves all. Windows of several
cells overlap by half; those of one cell lie side by side.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.correlation.windows import WindowGrid

CELL_PX = 8
WINDOWS_PX = (8, 16, 32)  # whose sigma is kept; each a multiple of the cell


def cells_of(shape: tuple[int, int]) -> WindowGrid:
    """Cells of a frame (H, W), centred in it."""
    row, column = (np.arange(side % CELL_PX // 2, side - CELL_PX + 1, CELL_PX) for side in shape)
    return WindowGrid(row, column, CELL_PX, CELL_PX)


def lags_of(reach_px: int, half: bool = False) -> NDArray[np.int64]:
    """Displacements (L, 2), v and u, up to `reach_px` along each axis; `half`: one of s and -s."""
    side = np.arange(-reach_px, reach_px + 1)
    lags = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    chosen = (lags[:, 0] > 0) | ((lags[:, 0] == 0) & (lags[:, 1] >= 0))
    return np.ascontiguousarray(lags[chosen] if half else lags)


def window_cells(side_px: int) -> tuple[int, int]:
    """Cells along a window, and from one to the next: half of it, at least one."""
    many = side_px // CELL_PX
    return many, max(many // 2, 1)


def middles_of(cells: NDArray[Any], side_px: int) -> NDArray[Any]:
    """Values (..., ny, nx) at the cells' centres, at the middles of windows: of one cell, or between four."""
    many, step = window_cells(side_px)
    before = (many - 1) // 2
    for axis in (-2, -1):
        first = np.arange(0, max(cells.shape[axis] - many + 1, 0), step) + before
        here = np.take(cells, first, axis=axis)
        cells = here if many % 2 else 0.5 * (here + np.take(cells, first + 1, axis=axis))
    return cells


def windows_of(cells: NDArray[Any], side_px: int) -> NDArray[Any]:
    """Sums over windows of what was summed over cells (..., ny, nx)."""
    many, step = window_cells(side_px)
    for axis in (-2, -1):
        first = np.arange(0, max(cells.shape[axis] - many + 1, 0), step)
        parts = [np.take(cells, first + k, axis=axis) for k in range(many)]
        cells = sum(parts[1:], start=parts[0])
    return cells
