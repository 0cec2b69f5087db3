"""Grid of interrogation windows, and interpolation of a field on it to every pixel.

Between grid nodes the field follows the cubic spline through them, so that what windows see of it is what they see
of the flow: a wave of four nodes keeps 0.985 of its height between them, with the cubic convolution of Keys (which
needs no equations) 0.94, and the passes put the rest on top of the nodes. At both ends the spline is straight:
ends that keep their curvature follow waves there better, but make a tenth more noise in each pass. Beyond them it
continues linearly, so that rotation and shear stay exact up to the frame's edge.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.errors import PairError

MIN_NODE_SHARE = 1e-12  # of a node in what is interpolated


@dataclass(frozen=True)
class WindowGrid:
    """Square windows of `size_px`, `step_px` apart, centred in a frame.

    Parameters
    ----------
    row, column : ndarray of int64, shapes (ny,), (nx,)
        First pixel row and column of the windows.
    size_px, step_px : int
        Side and spacing.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    size_px: int
    step_px: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of windows (ny, nx)."""
        return len(self.row), len(self.column)

    @property
    def y_px(self) -> NDArray[np.float64]:
        """Window centres, rows."""
        return self.row.astype(np.float64) + (self.size_px - 1) / 2

    @property
    def x_px(self) -> NDArray[np.float64]:
        """Window centres, columns."""
        return self.column.astype(np.float64) + (self.size_px - 1) / 2


def window_grid(shape: tuple[int, int], size_px: int, overlap: float) -> WindowGrid:
    """Windows that fit a frame, the rest of it shared evenly between both edges.

    Parameters
    ----------
    shape : (int, int)
        Frame height and width [px].
    size_px : int
        Side of a window [px].
    overlap : float
        Shared part of neighbouring windows, 0 <= overlap < 1.

    Raises
    ------
    PairError
        A window does not fit into the frame.
    """
    return grid_with_step(shape, size_px, max(1, round(size_px * (1.0 - overlap))))


def grid_with_step(shape: tuple[int, int], size_px: int, step_px: int) -> WindowGrid:
    """Windows of a given spacing that fit a frame, as `window_grid`."""
    if size_px > min(shape):
        raise PairError(
            f"a window of {size_px} px does not fit a frame of {shape[1]} x {shape[0]} px; choose smaller"
        )
    row, column = (np.arange((side - size_px) % step_px // 2, side - size_px + 1, step_px) for side in shape)
    return WindowGrid(row, column, size_px, step_px)


def spline_weights(position: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """First of four neighbouring coefficients and their weights for positions in units of the node spacing.

    Returns
    -------
    ndarray of int64, shape (n,)
        floor(position) - 1.
    ndarray of float64, shape (n, 4)
        Cubic B-spline weights of four consecutive coefficients; they sum to 1.
    """
    cell = np.floor(position)
    t = position - cell
    weights = np.stack(
        [
            (1.0 - t) ** 3 / 6.0,
            2.0 / 3.0 + t * t * (0.5 * t - 1.0),
            1.0 / 6.0 + 0.5 * t * (1.0 + t * (1.0 - t)),
            t**3 / 6.0,
        ],
        -1,
    )
    return cell.astype(np.int64) - 1, weights


def spline_coefficients(field: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Coefficients along an axis of the cubic spline through the nodes of a field, straight at both ends."""
    nodes = np.moveaxis(field, axis, 0)
    if len(nodes) < 3:
        return field
    bands = np.ones((3, len(nodes)))
    bands[1] = 4.0
    bands[1, [0, -1]], bands[0, 1], bands[2, -2] = 6.0, 0.0, 0.0
    found = scipy.linalg.solve_banded((1, 1), bands, 6.0 * nodes.reshape(len(nodes), -1))
    return np.moveaxis(found.reshape(nodes.shape), 0, axis)


def extend_linearly(field: NDArray[Any], axis: int, before: int, after: int) -> NDArray[Any]:
    """`field` lengthened along an axis by linear continuation of its first and last two elements."""
    field = np.moveaxis(field, axis, 0)
    slopes = field[0] - field[min(1, len(field) - 1)], field[-1] - field[max(-2, -len(field))]
    head = [field[0] + n * slopes[0] for n in range(before, 0, -1)]
    tail = [field[-1] + n * slopes[1] for n in range(1, after + 1)]
    parts = [np.reshape(head, (before, *field.shape[1:])), field, np.reshape(tail, (after, *field.shape[1:]))]
    return np.moveaxis(np.concatenate(parts), 0, axis)


def interpolate(
    field: NDArray[np.float64],
    axis: int,
    nodes_px: NDArray[np.float64],
    target_px: NDArray[np.float64],
    step_px: int,
) -> NDArray[np.float64]:
    """Interpolate a field along one axis from nodes `step_px` apart to target positions [px]."""
    lines, cell, weights = around(field, axis, nodes_px, target_px, step_px)
    lines = np.moveaxis(lines, axis, 0)
    spread = (len(cell),) + (1,) * (lines.ndim - 1)
    total = sum(weights[:, m].reshape(spread) * lines[cell + m] for m in range(4))
    return np.moveaxis(np.asarray(total), 0, axis)


def interpolation_matrix(
    nodes_px: NDArray[np.float64], target_px: NDArray[np.float64], step_px: int
) -> NDArray[np.float32]:
    """Matrix (targets, nodes) of `interpolate`, for many targets of several fields.

    Shares fall by 0.27 a node; those that no float32 sum can see are left out, as numbers too small for the usual
    format (denormal) make products ten times slower.
    """
    matrix = interpolate(np.eye(len(nodes_px)), 0, nodes_px, target_px, step_px)
    return np.where(np.abs(matrix) < MIN_NODE_SHARE, 0.0, matrix).astype(np.float32)


def around(
    field: NDArray[np.float64],
    axis: int,
    nodes_px: NDArray[np.float64],
    target_px: NDArray[np.float64],
    step_px: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Coefficients that reach far enough, first of the four around each target among them, and their weights."""
    cell, weights = spline_weights((target_px - nodes_px[0]) / step_px)
    before = max(0, -int(cell.min()))
    after = max(0, int(cell.max()) + 4 - len(nodes_px))
    return extend_linearly(spline_coefficients(field, axis), axis, before, after), cell + before, weights
