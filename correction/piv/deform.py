"""Both frames of a pair seen at their common middle time, through the displacement found so far."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.piv.kernels.deform import deform_rows, refine_lines
from correction.piv.windows import WindowGrid, around
from ground.rows import run_rows

SOLID = np.float32(0.5)


class DeformedPair(NamedTuple):
    """Frames a, b and how far their pixels are valid in both, from 0 to 1; all (H, W) float32.

    Frames are 0 where they are not valid, and small where hardly. `floor` is the mean square up to which a window
    counts as constant.
    """

    a: NDArray[np.float32]
    b: NDArray[np.float32]
    valid: NDArray[np.float32]
    floor: float

    def solid(self) -> NDArray[np.uint8]:
        """Pixels (H, W) that are more valid than not, for windows without weights."""
        return (self.valid > SOLID).view(np.uint8)


def deform_pair(
    coefficients: tuple[NDArray[np.float32], NDArray[np.float32]],
    valid: NDArray[np.float32],
    field: NDArray[np.float64],
    grid: WindowGrid,
    floor: float,
    threads: int | None = None,
) -> DeformedPair:
    """Sample frame A at x - d(x)/2 and frame B at x + d(x)/2.

    Parameters
    ----------
    coefficients : pair of ndarray of float32, shape (H, W)
        Spline coefficients of frames A and B.
    valid : ndarray of float32, shape (H, W)
        1 where a pixel is valid in both frames, else 0.
    field : ndarray of float64, shape (ny, nx, 2)
        Displacement [px] on the nodes of `grid`, finite everywhere.
    grid : WindowGrid
        Where the nodes lie.
    floor : float
        Mean square up to which a window counts as constant.
    threads : int, optional
        Threads to use.
    """
    height, width = valid.shape
    lines, cell_u, weight_u = around(field, 1, grid.x_px, np.arange(float(width)), grid.step_px)
    lines, cell, weight = around(lines, 0, grid.y_px, np.arange(float(height)), grid.step_px)
    refined = np.empty((2, len(lines), width), np.float32)
    refine_lines(np.ascontiguousarray(lines), cell_u, weight_u, refined)
    share = weight.astype(np.float32)
    masked = bool(valid.min() == 0.0)
    out = DeformedPair(
        np.empty((height, width), np.float32),
        np.empty((height, width), np.float32),
        np.ones((height, width), np.float32),
        floor,
    )

    def rows(first: int, last: int) -> None:
        offset, fraction = np.empty((2, width), np.int32), np.empty((2, width), np.float32)
        for source, target, scale in ((coefficients[0], out.a, -0.5), (coefficients[1], out.b, 0.5)):
            deform_rows(
                source, valid, masked, refined, cell, share, np.float32(scale), first, last,
                offset, fraction, target, out.valid,
            )  # fmt: skip
        for target in (out.a, out.b):
            target[first:last] *= out.valid[first:last]

    run_rows(rows, height, threads=threads)
    return out
