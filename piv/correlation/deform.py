"""Both frames of a pair seen at their common middle time, through the displacement found so far.

Where single pixels were filled (`piv.correlation.fill`), what stands there errs by variances e_a and e_b beside
the noise n, and both frames show the same: each is drawn to the other by its share of the variance,

    a + e_a w' (b - a),     b + e_b w' (a - b),     w' = 1/(e_a + e_b + n).

What is left of the difference, from which all that is found about displacement comes, weighs n w', as it should by
its variance; the picture itself keeps no gaps, whose pattern would be noise of its own.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.fill import FilledPixels
from piv.correlation.inclined_images import Inclination
from piv.correlation.kernels.deform import agree_rows, deform_rows, refine_lines
from piv.correlation.windows import WindowGrid, around

SOLID = np.float32(0.5)


class DeformedPair(NamedTuple):
    """Frames a, b and how far their pixels are valid in both, from 0 to 1; all (H, W) float32.

    Frames are 0 where they are not valid, and small where hardly. `floor` is the mean square up to which a window
    counts as constant. `worth` is what differences between both frames are worth where single pixels have been
    filled, from 0 to 1; None if none were.
    """

    a: NDArray[np.float32]
    b: NDArray[np.float32]
    valid: NDArray[np.float32]
    floor: float
    worth: NDArray[np.float32] | None = None
    inclination: Inclination | None = None

    def solid(self) -> NDArray[np.uint8]:
        """Pixels (H, W) that are more valid than not, for windows without weights."""
        return (self.valid > SOLID).view(np.uint8)


class Frames(NamedTuple):
    """Input of all passes: spline coefficients of both frames, mask (H, W) float32, variance of filled pixels.

    `floor` is the mean square up to which a window counts as constant; `given` as in `Pair`; `inclination` of
    particle images, None of round ones.
    """

    coefficients: tuple[NDArray[np.float32], NDArray[np.float32]]
    valid: NDArray[np.float32]
    floor: float
    filled: FilledPixels | None
    given: NDArray[np.float32] | None = None
    inclination: Inclination | None = None


def deform_pair(
    coefficients: tuple[NDArray[np.float32], NDArray[np.float32]],
    valid: NDArray[np.float32],
    field: NDArray[np.float64],
    grid: WindowGrid,
    floor: float,
    threads: int | None = None,
    filled: FilledPixels | None = None,
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
    filled : FilledPixels, optional
        How unsure what stands in single pixels is.
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
        None if filled is None else np.empty((height, width), np.float32),
    )

    def rows(first: int, last: int) -> None:
        offset, fraction = np.empty((2, width), np.int32), np.empty((2, width), np.float32)
        for source, target, scale in ((coefficients[0], out.a, -0.5), (coefficients[1], out.b, 0.5)):
            deform_rows(
                source, valid, masked, refined, cell, share, np.float32(scale), first, last,
                offset, fraction, target, out.valid,
            )  # fmt: skip
        if filled is not None and out.worth is not None:
            agree_rows(
                out.a, out.b, filled.variance, np.float32(filled.noise), refined, cell, share, first, last,
                offset, fraction, np.empty((2, width), np.float32), out.worth,
            )  # fmt: skip
        for target in (out.a, out.b):
            target[first:last] *= out.valid[first:last]

    run_rows(rows, height, threads=threads)
    return out
