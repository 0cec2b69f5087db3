"""Bias of a corner in a view that bends more than the corner fit can follow.

The fit knows straight and evenly curved edges.  Next to a fold, and behind chains of balls, edges twist as well,
and what no model of an edge follows draws the corner aside, all corners alike that are seen so.  How far, the fit
itself says: the view around each corner is traced pixel by pixel, the board is drawn as it is bent there, blurred
as edges were measured, and fitted as those of the frame are.

With X(u) the traced point of the board about the corner, in squares, an edge of kind k is where X_k is a whole
number m, and (X_k - m) / |grad X_k| how far a point is off the nearest one.  Between pixels X is a cubic spline:
it is smooth within a branch.

All edges are drawn, not the corner's own two alone: where the view bends, the next ones come into the window.  So
is the light that surfaces let pass, by Fresnel, which falls towards a rim the faster the nearer.  The fit follows
its slope; what it bends beyond that, times dark and bright squares, draws a corner aside one way where the square
between +x and +y is bright, and the other way where it is dark.  Left out, both made corners behind two balls seem
drawn aside by half as much again.

The middle of the picture of a dot is never quite where its centre is seen.  Where its rim says it lies off by
little (`dot_rims`), that is taken off; where it is more, dots are drawn and fitted like corners.
"""

from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.fit.seen.kernels.edges import shade_edges
from correction.fit.seen.prediction import Expected, in_target_frame
from correction.target import Chessboard
from correction.target.corners import ASIDE_PX
from correction.target.marks import refine_marks
from ground.rows import run_rows
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

FINER = 4  # points a pixel that are drawn
CONTRAST = 0.85  # of black and white print
DRAWN_PX = 0.2  # blur of what is drawn, before the rest of it is added
WINDOW_MARGIN_PX = 3  # what is drawn beyond a window
CORNERS_AT_ONCE = 64  # corners traced and fitted at a time
WORTH_PX = 0.0005  # of the rough forecast (`prediction`), from which a corner is drawn
WORTH_OF_DOTS_PX = 0.01  # of what the rim of a dot says, the same
LEFT_BY_RIM, LEFT_OF_DOTS = 0.03, 0.02  # of what is taken off dots, by their rims and as drawn
# Of what is taken off, one standard deviation: renders show 0.8 behind two balls, all behind three
LEFT = 0.2


def window_bias(
    scene: Scene,
    pose: TargetPose,
    board: Chessboard,
    expected: Expected,
    blur_px: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the bias of corners (N, 2) [px], and its standard deviation, common to all.

    Parameters
    ----------
    scene, pose, board
        As `expect` got them.
    expected : Expected
        N corners.
    blur_px : (N,) float64
        Of their edges as measured, pixel included; NaN where a corner was not found.
    """
    if board.dots is None:
        aside, sigma, worth = np.zeros((len(expected), 2)), expected.bent_px.copy(), WORTH_PX
    else:
        aside, sigma, worth = expected.bent_px.copy(), LEFT_BY_RIM * expected.bent_px, WORTH_OF_DOTS_PX
    asked = (np.linalg.norm(expected.bent_px, axis=1) > worth) & np.isfinite(blur_px)
    if not asked.any():
        return aside, sigma
    found = find_bent_corners(scene, pose, board, expected.take(asked), float(np.median(blur_px[asked])))
    known = np.isfinite(found[:, 0])
    here = np.flatnonzero(asked)[known]
    left = LEFT if board.dots is None else LEFT_OF_DOTS
    aside[here], sigma[here] = found[known], left * found[known]
    return aside, sigma


def find_bent_corners(
    scene: Scene, pose: TargetPose, board: Chessboard, expected: Expected, blur_px: float
) -> NDArray[np.float64]:
    """Find corners (N, 2) [px] in drawn windows, from their places; NaN where the fit gives up.

    Arguments are those of `window_bias`, with one blur for all.
    """
    seen, aside = in_target_frame(scene, pose), np.full((len(expected), 2), np.nan)
    node = board.corner_mm(expected.index)
    extent = np.abs(expected.axes_px).sum(axis=2).max(axis=1, initial=0.0) * expected.window
    by_size = np.argsort(extent)
    for some in np.split(by_size, range(CORNERS_AT_ONCE, len(by_size), CORNERS_AT_ONCE)) if len(by_size) else ():
        half = int(np.ceil(extent[some].max())) + WINDOW_MARGIN_PX
        middle = np.rint(expected.pixel[some]).astype(np.int64)
        around = np.stack(np.meshgrid(*[np.arange(-half, half + 1)] * 2), axis=-1)
        pixel = middle[:, None, None] + around
        rays = trace(seen, pixel.astype(np.float64))
        key = rays.rays["key"]
        there = rays.recovered & (key == key[:, half, half][:, None, None])
        off = pixel - expected.pixel[some][:, None, None]
        affine = np.linalg.inv(expected.axes_px[some]) * board.sides_mm[:, None]
        flat = np.einsum("nij,nvuj->nvui", affine, off)
        point = board.along_mm(rays.plane_mm - node[some][:, None, None])
        nearest = nearest_there(there)
        squares = (flat + (point - flat)[nearest]) / board.sides_mm
        passed = rays.rays["transmittance"][nearest]
        tiles = draw_marks(squares, passed, board, expected.index[some], blur_px)
        height, width = expected.usable.shape
        inside = ((pixel >= 0) & (pixel < (width, height))).all(axis=-1)
        u, v = np.clip(pixel, 0, (width - 1, height - 1)).transpose(3, 0, 1, 2)
        place = expected.pixel[some] - middle + half
        place[:, 1] += tiles.shape[1] * np.arange(len(some))
        fit = refine_marks(
            tiles.reshape(-1, tiles.shape[2]),
            board,
            expected.index[some],
            place + ASIDE_PX,
            expected.axes_px[some],
            mask=(expected.usable[v, u] & inside & there).reshape(-1, tiles.shape[2]),
            window=expected.window[some],
        )
        aside[some] = np.where(fit.valid[:, None], fit.position_px - place, np.nan)
    return aside


def nearest_there(there: NDArray[np.bool_]) -> tuple[NDArray[np.int64], ...]:
    """The place nearest to each in tiles (N, n, n), of the same tile, that is `there`: its index by axis."""
    apart = (1e6, 1.0, 1.0)
    return tuple(scipy.ndimage.distance_transform_edt(~there, apart, return_distances=False, return_indices=True))


def draw_marks(
    squares: NDArray[np.float64],
    passed: NDArray[np.float64],
    board: Chessboard,
    index: NDArray[np.int64],
    blur_px: float,
) -> NDArray[np.float64]:
    """Corners, or dots, as pixels show them (N, n, n).

    Parameters
    ----------
    squares : (N, n, n, 2) float64
        Points of the board that pixels see, from the corner, in squares: edges are where a part is a whole number,
        dots around where both are.
    passed : (N, n, n) float64
        Share of the light that reaches the pixels.
    board : Chessboard
    index : (N, 2) int64
        Corners of the board.
    blur_px : float
        Standard deviation, with the pixel in it.
    """
    size = squares.shape[1]
    seen, between, spread = np.empty(passed.shape), _between(size), _spread(size, blur_px)

    def draw(first: int, last: int) -> None:
        for n in range(first, last):
            light = between @ passed[n] @ between.T
            light *= 1.0 + CONTRAST * _shade(squares[n], between, board, index[n])
            seen[n] = spread @ light @ spread.T

    run_rows(draw, len(seen), 1)
    return seen


def _shade(
    squares: NDArray[np.float64], between: NDArray[np.float64], board: Chessboard, index: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Draw the print, dark -1 and bright 1, between the pixels of a tile (M, M); arguments as of `draw_marks`."""
    x, y = (between @ squares[..., part] @ between.T for part in (0, 1))
    width = np.sqrt(2.0) * DRAWN_PX
    if board.dots is not None:
        fine = np.stack((x, y), axis=-1)
        node = np.rint(fine).astype(np.int64)
        beyond = np.linalg.norm(fine - node, axis=-1) - 0.5 * board.dot_share(node + index)
        shade = np.full(beyond.shape, -1.0 if board.dots.bright else 1.0)
        shade_edges(beyond, FINER, width, False, shade)
        return shade
    shade = np.full(x.shape, float(board.corner_sign(index)))
    for field in (x, y):
        shade_edges(field, FINER, width, True, shade)
    return shade


@cache
def _between(size: int) -> NDArray[np.float64]:
    """Interpolation matrix (M, n) between n places one apart."""
    return np.asarray(scipy.interpolate.CubicSpline(np.arange(size), np.eye(size))(_places(size)))


def _spread(size: int, blur_px: float) -> NDArray[np.float64]:
    """Weights (n, M) by which n places receive what is drawn between them."""
    off = np.arange(size)[:, None] - _places(size)
    weight = np.exp(-0.5 * off**2 / max(blur_px**2 - DRAWN_PX**2, DRAWN_PX**2))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _places(size: int) -> NDArray[np.float64]:
    return np.linspace(0.0, size - 1.0, FINER * (size - 1) + 1)
