"""Least-squares fit of the model of a corner (`corner_model`) to the pixels of its window.

Levenberg-Marquardt with Marquardt's scaling (J. SIAM 11, 431 (1963)) over the pixels of the window, which is
moved to the fitted corner and fitted again until it stays.

How sure a fitted corner is, the residuals in its window say.  Frames have noise of different size on edges and
plains, and blur correlates neighbours, so sigma^2 (J^T J)^-1 would be wrong.  With the pull of pixel i on p, a_i =
(J^T J)^-1 J_i r_i / (1 - h_i), where its leverage h_i = J_i^T (J^T J)^-1 J_i makes up for the part of the noise
that the fit swallowed,

    cov = sum_ij k(i - j) a_i a_j,      k a triangle of base 2 CORRELATED_PX px in each direction

(White, Econometrica 48, 817 (1980); MacKinnon, White, J. Econometrics 29, 305 (1985), HC3; Conley,
J. Econometrics 92, 1 (1999)), summed as squares of block sums.  A wider block knows more correlation and
loses more to the fit, whose pulls sum to zero.  Block 2 measured: errors are 1.05 sigma in noise that is
white, as a camera's, 1.3 sigma in noise blurred by 0.5 px.
"""

from math import atan2, hypot, sqrt

import numpy as np

from correction.target.kernels.corner_block import PIXEL_LANES, WIDE, gradients, products, start_levels
from correction.target.kernels.corner_model import (
    FREE,
    LOST,
    MOVED,
    OK,
    SIDE,
    SMALL,
    gather,
    set_turn,
)
from ground.jit import Array, kernel
from ground.kernels.cholesky import factorise, solve
from piv.resampling.kernels.prefilter import copy_line

CORRELATED_PX = 2  # block of pixels taken as correlated [px]
NEGLIGIBLE_STEP_PX = 5e-4  # a step that no longer matters
TOLERANCE_RATIO = 2.0  # relative gain in the squares that belongs to a step of 1 px
MAX_ROUNDS = 4  # moves of the window
MAX_STEPS = 25  # steps of the optimiser in one window
RIDGE = 3.0  # weight, in pixels of full contrast, of equal blurs and of an edge like erf
MIN_BLUR = 0.2  # [px] pixel integration alone gives 0.29; below, no pixel may lie on an edge


@kernel
def covariance(
    p: Array, pixels: Array, count: int, box: Array, turn: Array, row: Array, normal: Array, lower: Array,
    inverse: Array, weights: Array, step: Array, pull: Array, sums: Array, block: Array, beside: Array, out: Array,
) -> bool:  # fmt: skip
    """Variance of u, of v and their covariance [px^2] into out (3,), from the residuals in the window.

    inverse (FREE, FREE or more), weights (2, FREE), pull (SIDE^2, 2), sums (SIDE, 2), block (FREE + 1,
    PIXEL_LANES) and beside (4 or more, PIXEL_LANES) are scratch.
    """
    if not factorise(normal, 0.0, lower):
        return False
    for axis in range(2):
        for i in range(FREE):
            row[i] = 1.0 if i == axis else 0.0
        solve(lower, row, step)
        for i in range(FREE):
            weights[axis, i] = step[i]
    for j in range(FREE):  # of lower, column by column
        for i in range(j, FREE):
            value = 1.0 if i == j else 0.0
            for k in range(j, i):
                value -= lower[i, k] * inverse[k, j]
            inverse[i, j] = value / lower[i, i]
    set_turn(p, turn)
    width, height = box[2], box[3]
    for k in range(width * height):
        pull[k, 0] = 0.0
        pull[k, 1] = 0.0
    leverage, across, by_u, by_v = beside[0], beside[1], beside[2], beside[3]
    for first in range(0, count, PIXEL_LANES):
        gradients(p, turn, pixels[0, first : first + PIXEL_LANES], pixels[1, first : first + PIXEL_LANES], block)
        leverage[:], by_u[:], by_v[:] = 0.0, 0.0, 0.0
        for i in range(FREE):
            across[:] = 0.0
            for j in range(i + 1):
                for n in range(PIXEL_LANES):
                    across[n] += inverse[i, j] * block[j, n]
            for n in range(PIXEL_LANES):
                leverage[n] += across[n] * across[n]
                by_u[n] += weights[0, i] * block[i, n]
                by_v[n] += weights[1, i] * block[i, n]
        for n in range(min(PIXEL_LANES, count - first)):
            place = int(pixels[3, first + n])
            residual = (pixels[2, first + n] - block[FREE, n]) / max(1.0 - leverage[n], 0.1)
            pull[place, 0], pull[place, 1] = by_u[n] * residual, by_v[n] * residual
    uu = vv = uv = 0.0
    for top in range(1 - CORRELATED_PX, height):
        for c in range(width):
            sums[c, 0] = 0.0
            sums[c, 1] = 0.0
            for r in range(max(top, 0), min(top + CORRELATED_PX, height)):
                sums[c, 0] += pull[r * width + c, 0]
                sums[c, 1] += pull[r * width + c, 1]
        a = b = 0.0
        for right_end in range(width + CORRELATED_PX - 1):
            if right_end < width:
                a += sums[right_end, 0]
                b += sums[right_end, 1]
            if right_end >= CORRELATED_PX:
                a -= sums[right_end - CORRELATED_PX, 0]
                b -= sums[right_end - CORRELATED_PX, 1]
            uu += a * a
            vv += b * b
            uv += a * b
    scale = 1.0 / (CORRELATED_PX * CORRELATED_PX)
    out[0], out[1], out[2] = uu * scale, vv * scale, uv * scale
    return True


def new_scratch() -> tuple[Array, ...]:
    """Return working memory of `fit_corners`: pixels, pulls, block sums, box, vectors, a block, equations."""
    pixels, pull, sums = np.zeros((4, SIDE * SIDE + PIXEL_LANES)), np.empty((SIDE * SIDE, 2)), np.empty((SIDE, 2))
    block = np.zeros((2 * WIDE, PIXEL_LANES))
    return pixels, pull, sums, np.empty(4, np.int64), np.empty((4, 2)), block, np.zeros((11 + 3 * FREE, WIDE))


@kernel
def normal_equations(
    p: Array, pixels: Array, count: int, ridge: float, shape_ridge: float, turn: Array, block: Array, rows: Array,
    normal: Array, right: Array,
) -> float:  # fmt: skip
    """Sum J^T J into normal (FREE + 1, WIDE), J^T r into right (FREE,); return the sum of r^2.

    ridge weighs the wish that both blurs agree, shape_ridge the wish that edges look like erf.
    """
    products(p, pixels, count, turn, block, rows, normal)
    for i in range(FREE):
        right[i] = normal[FREE, i]
    astigmatism = p[6] - p[7]
    normal[6, 6] += ridge
    normal[7, 7] += ridge
    normal[7, 6] -= ridge
    right[6] -= ridge * astigmatism
    right[7] += ridge * astigmatism
    normal[12, 12] += shape_ridge
    right[12] -= shape_ridge * p[12]
    return float(normal[FREE, FREE] + ridge * astigmatism * astigmatism + shape_ridge * p[12] * p[12])


@kernel
def optimise(
    p: Array, pixels: Array, count: int, ridge: float, shape_ridge: float, limit: float, tolerance: float,
    trial: Array, turn: Array, block: Array, rows: Array, normal: Array,
    right: Array, trial_normal: Array, trial_right: Array, lower: Array, step: Array, total: Array,
) -> bool:  # fmt: skip
    """Levenberg-Marquardt from p (FREE,), in place; True if it settled within `limit` px of the window's centre.

    On return normal holds J^T J at p and total[0] the sum of squares.  A step that is refused costs its own look
    at the pixels only: the equations at p are kept beside those at the trial.
    """
    best = normal_equations(p, pixels, count, ridge, shape_ridge, turn, block, rows, normal, right)
    damping = 1e-3
    for _ in range(MAX_STEPS):
        if not factorise(normal, damping, lower):
            damping = max(10.0 * damping, 1e-6)
            continue
        solve(lower, right, step)
        for i in range(FREE):
            trial[i] = p[i] + step[i]
        for i in range(6, 8):  # a long first step must not jump to a blur where no pixel lies on an edge
            trial[i] = max(trial[i], 0.5 * p[i], MIN_BLUR)
        if not hypot(trial[0], trial[1]) <= limit:
            damping *= 10.0
            if damping > 1e8:
                return False
            continue
        now = normal_equations(
            trial, pixels, count, ridge, shape_ridge, turn, block, rows, trial_normal, trial_right
        )
        if now <= best:
            settled = hypot(step[0], step[1]) < tolerance and best - now <= TOLERANCE_RATIO * tolerance * best
            copy_line(trial, p)
            for row in range(normal.shape[0]):
                copy_line(trial_normal[row], normal[row])
            copy_line(trial_right, right)
            best = now
            damping = max(0.1 * damping, 1e-12)
            total[0] = best
            if settled:
                return True
        else:
            if hypot(step[0], step[1]) < 1e-5:
                total[0] = best
                return True
            damping = min(damping * 10.0, 1e10)
    return False


@kernel
def fit_corners(
    image: Array, mask: Array, start: Array, axes: Array, reaches: Array, arm: float, least_px: float,
    max_shift: float, start_error_px: float, first: int, last: int, scratch: tuple[Array, ...], out: Array,
    verdict: Array,
) -> None:  # fmt: skip
    """Fit corners first..last-1.

    image (H, W) float32; mask see `gather`; start (N, 2) px; axes (N, 2, 2) px per square, columns +x, +y;
    reaches (N,) half length of the window in squares; arm half width in squares; least_px the smallest half
    window [px] to shrink to at a border; max_shift largest move from the start in squares; start_error_px
    the expected one; scratch from `new_scratch`, one a thread; out (N, 11): u, v, var u, var v, cov, rms
    residual, A, B, both blurs, reach used; verdict (N,) uint8.
    """
    pixels, pull, sums, box, small, blocks, square = scratch
    extent, inverse, total = small[0], small[1:3], small[3]
    block, rows = blocks[: FREE + 1], blocks[WIDE:].reshape(PIXEL_LANES, WIDE)
    p, trial, row = square[0, :FREE], square[1, :FREE], square[2, :FREE]
    right, step, trial_right = square[3, :FREE], square[4, :FREE], square[5, :FREE]
    turn, weights, normal = square[6, :4], square[7:9, :FREE], square[9 : 10 + FREE]
    trial_normal, lower = square[10 + FREE : 11 + 2 * FREE], square[11 + 2 * FREE :, :FREE]
    for n in range(first, last):
        out[n, :] = np.nan
        det = axes[n, 0, 0] * axes[n, 1, 1] - axes[n, 0, 1] * axes[n, 1, 0]
        inverse[0, 0], inverse[0, 1] = axes[n, 1, 1] / det, -axes[n, 0, 1] / det
        inverse[1, 0], inverse[1, 1] = -axes[n, 1, 0] / det, axes[n, 0, 0] / det
        extent[0] = abs(axes[n, 0, 0]) + abs(axes[n, 0, 1])
        extent[1] = abs(axes[n, 1, 0]) + abs(axes[n, 1, 1])
        side1, side2 = hypot(axes[n, 0, 0], axes[n, 1, 0]), hypot(axes[n, 0, 1], axes[n, 1, 1])
        thin = abs(det) / max(side1, side2)  # the smaller distance of opposite sides
        if not (np.isfinite(start[n, 0] + start[n, 1]) and thin > 0.0 and np.isfinite(thin)):
            verdict[n] = SMALL
            continue
        reach = min(reaches[n], 0.5 * (SIDE - 2) / max(extent[0], extent[1]))
        least = least_px / thin
        if reach < least:
            verdict[n] = SMALL
            continue
        p[:] = 0.0
        p[2] = atan2(axes[n, 1, 0], axes[n, 0, 0])
        p[3] = atan2(axes[n, 1, 1], axes[n, 0, 1])
        blur = min(max(min(0.16 * thin, 0.5 * start_error_px), 0.7), 6.0)  # wide enough to feel the edges
        p[6], p[7] = blur, blur
        centre_u, centre_v = start[n, 0], start[n, 1]
        limit = max_shift * min(side1, side2)
        verdict[n], level = LOST, 0.0
        for rounds in range(MAX_ROUNDS):
            count = gather(image, mask, centre_u, centre_v, inverse, extent, reach, arm, box, pixels)
            while count < 0 and reach > least:
                reach = max(0.85 * reach, least)
                count = gather(image, mask, centre_u, centre_v, inverse, extent, reach, arm, box, pixels)
            if count < 0:
                verdict[n] = -count
                break
            if count < 2 * FREE:
                verdict[n] = SMALL
                break
            if rounds == 0:
                start_levels(p, pixels, count, turn, block)
                level = p[9]
            ridge = RIDGE * level * level
            # The shape is freed once the blur is right (under a wide first guess it finds a wrong minimum), and
            # given up where edges along pixel rows cannot tell it from blur.
            pin = ridge if rounds > 0 else 1e6 * ridge
            tolerance = NEGLIGIBLE_STEP_PX if rounds > 0 else 0.05
            found = False
            for _ in range(2 if rounds > 0 else 1):
                found = optimise(
                    p, pixels, count, ridge, pin, limit, tolerance, trial, turn, block, rows, normal, right,
                    trial_normal, trial_right, lower, step, total,
                )  # fmt: skip
                if found:
                    break
                p[12], pin = 0.0, 1e6 * ridge
            if not found:
                verdict[n] = LOST
                break
            moved = hypot(p[0], p[1])
            centre_u += p[0]
            centre_v += p[1]
            du, dv = centre_u - start[n, 0], centre_v - start[n, 1]
            a, b = inverse[0, 0] * du + inverse[0, 1] * dv, inverse[1, 0] * du + inverse[1, 1] * dv
            if max(abs(a), abs(b)) > max_shift:
                verdict[n] = MOVED
                break
            if (rounds > 0 and moved < 0.3) or rounds == MAX_ROUNDS - 1:
                if covariance(
                    p, pixels, count, box, turn, row, normal, lower, trial_normal, weights, step, pull, sums,
                    block, blocks[WIDE:], out[n, 2:5],
                ):  # fmt: skip
                    verdict[n] = OK
                    out[n, 0], out[n, 1] = centre_u, centre_v
                    out[n, 5] = sqrt(total[0] / max(count - FREE, 1.0))
                    out[n, 6], out[n, 7] = p[8], p[9]
                    out[n, 8], out[n, 9] = abs(p[6]), abs(p[7])
                    out[n, 10] = reach
                break
            p[0], p[1] = 0.0, 0.0
