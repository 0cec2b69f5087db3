"""Offset of the middle of a dot's picture from the picture of its centre.

Perspective, a lens and above all balls show the far half of a circle smaller than the near one.  So the rim is
traced: RIM_POINTS points of it, each seen at the pixel u_k with X(u_k) = c + r (cos k, sin k), found by Newton's
method along rays. To these the fit of dots (`correction.target.dot_centres`) lays an ellipse, each part of the rim
counting by its length in the frame, as pixels do:

    min over p, L of  sum_k w_k ((|L (u_k - p)| - 1) / |grad|)^2,      w_k = |u_(k+1) - u_(k-1)|

p minus the pixel that shows the centre is how far the dot is found from where it is.  Where a rim is not all seen
by one way, along folds, or lies more than EGG_PX (root mean square) off any ellipse, nothing should ask for the
dot: such lie along rims of balls, where they weigh most, and are 1 % of their shift off after all.  What blur adds
goes with its square over that of the dot.
"""

import numpy as np
from numpy.typing import NDArray

from correction.target import Chessboard
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace

RIM_POINTS = 24  # points
ROUNDS, NEAR_PX = 12, 1e-3  # of Newton's method with the derivative of the centre, and how near it must come
GAUSS_NEWTON_STEPS = 8  # of Gauss and Newton
EGG_PX = 0.03


def off_centre(
    scene: Scene,
    board: Chessboard,
    index: NDArray[np.int64],
    pixel: NDArray[np.float64],
    axes_px: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the offset (N, 2) [px] of dots from the pictures of their centres; NaN if a rim is no whole ellipse.

    Parameters
    ----------
    scene : Scene
        In the coordinates of the board.
    board : Chessboard
    index : (N, 2) int64
        Dots of the board.
    pixel : (N, 2) float64
        Near which they are seen.
    axes_px : (N, 2, 2) float64
        Columns: displacement by one pitch along the board's +x, +y.
    """
    if not len(index):
        return np.zeros((0, 2))
    angle = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    around = np.concatenate((np.zeros((1, 2)), np.column_stack((np.cos(angle), np.sin(angle)))))
    offset = 0.5 * board.dot_share(index)[:, None, None] * around  # pitches; the centre first
    target = board.corner_mm(index)[:, None] + board.on_board_mm(offset * board.sides_mm)
    at = pixel[:, None] + np.einsum("nij,nkj->nki", axes_px, offset)
    step = np.zeros_like(at)
    ways = trace(scene, pixel).rays["key"]
    for _ in range(ROUNDS):
        rays = trace(scene, at)
        step = np.einsum("nij,nkj->nki", axes_px, board.along_mm(target - rays.plane_mm) / board.sides_mm)
        at = at + step
    there = (rays.rays["key"] == ways[:, None]) & (np.linalg.norm(step, axis=-1) < NEAR_PX)  # False for NaN
    whole = there.all(axis=1)
    out = np.full((len(index), 2), np.nan)
    middle, egg_px = _ellipse(at[whole, 1:])
    out[whole] = np.where((egg_px < EGG_PX)[:, None], middle - at[whole, 0], np.nan)
    return out


def _ellipse(rim: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (N, 2) of the ellipses that are most like rims (N, K, 2), and how far these lie off (N,) [px]."""
    if not len(rim):
        return np.zeros((0, 2)), np.zeros(0)
    weight = np.linalg.norm(np.roll(rim, -1, axis=1) - np.roll(rim, 1, axis=1), axis=-1)
    middle = np.average(rim, axis=1, weights=np.repeat(weight[..., None], 2, axis=-1))
    spread = np.einsum("nki,nkj->nij", rim - middle[:, None], rim - middle[:, None]) * (2.0 / rim.shape[1])
    values, vectors = np.linalg.eigh(spread)
    root = vectors / np.sqrt(values)[:, None, :] @ vectors.transpose(0, 2, 1)
    free = np.column_stack((middle, root[:, 0, 0], root[:, 0, 1], root[:, 1, 1]))
    miss = np.zeros_like(weight)
    for _ in range(GAUSS_NEWTON_STEPS):
        d = rim - free[:, None, :2]
        x, y = d[..., 0], d[..., 1]
        a, b, c = (free[:, k, None] for k in (2, 3, 4))
        lx, ly = a * x + b * y, b * x + c * y
        q = np.hypot(lx, ly)
        sx, sy = (a * lx + b * ly) / q, (b * lx + c * ly) / q
        slope = np.hypot(sx, sy)
        by = np.stack((-sx, -sy, lx * x / q, (lx * y + ly * x) / q, ly * y / q), axis=-1) / slope[..., None]
        miss = (1.0 - q) / slope
        weighted = by * weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ by
        free = free + np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ miss[..., None])[..., 0]
    return free[:, :2], np.sqrt(np.average(miss**2, axis=1, weights=weight))
