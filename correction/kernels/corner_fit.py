"""Least-squares fit of a chessboard corner: two blurred edges that cross.

Model around the corner p, with d = x - p and for each edge k = 1, 2 its direction t_k, its normal n_k:

    I(x) = (A + B erf(e1 / (sqrt(2) s1)) erf(e2 / (sqrt(2) s2))) (1 + g . (x - x0))
    e_k  = n_k . d + c_k (t_k . d)^2

Twelve numbers are free: p, both angles, both curvatures c_k (glass bends edges; a straight line through an
arc would miss the corner by c h^2 / 3 for arms of length h), both blurs (pixel integration only adds 1/12
px^2 to s^2, in any direction), A, B, and the slope g of the illumination, which would otherwise pull on p.
n_1 and n_2 are turned so that the product of the two edges is positive in the quadrant between +axis 1 and
+axis 2, whichever handedness the view has; the sign of B is the shade of the square there.

Levenberg-Marquardt with Marquardt's scaling (J. SIAM 11, 431 (1963)) over the pixels of a cross: arms of
half length `reach` and half width `arm` squares in the affine frame of the view.  The window is an exact
set of pixels, moved to the fitted corner and fitted again until it stays.

Covariance: frames have noise of different size on edges and plains, and blur correlates neighbours, so
sigma^2 (J^T J)^-1 would be wrong.  With the pull of pixel i on p, a_i = (J^T J)^-1 J_i r_i / (1 - h_i),
where its leverage h_i = J_i^T (J^T J)^-1 J_i makes up for the part of the noise that the fit swallowed,

    cov = sum_ij k(i - j) a_i a_j,      k a triangle of base 2 BLOCK px in each direction

(White, Econometrica 48, 817 (1980); MacKinnon, White, J. Econometrics 29, 305 (1985), HC3; Conley,
J. Econometrics 92, 1 (1999)), summed as squares of block sums.  A wider block knows more correlation and
loses more to the fit, whose pulls sum to zero.  Block 2 measured: errors are 1.05 sigma in noise that is
white, as a camera's, 1.3 sigma in noise blurred by 0.5 px.
"""

from math import atan2, cos, erf, exp, hypot, sin, sqrt

import numpy as np

from tracer.kernels._jit import Array, kernel

FREE = 13  # px, py, angle 1, angle 2, curvature 1, 2, blur 1, 2, A, B, slope u, slope v, edge shape
SIDE = 121  # largest bounding box of a window [px]
BLOCK = 2  # block of pixels taken as correlated [px]
SETTLED_PX = 5e-4  # a step that no longer matters
TOLERANCE_RATIO = 2.0  # relative gain in the squares that belongs to a step of 1 px
MAX_ROUNDS = 4  # moves of the window
MAX_STEPS = 25  # steps of the optimiser in one window
RIDGE = 3.0  # weight, in pixels of full contrast, of equal blurs and of an edge like erf
PLAIN = 3.2  # erf is +-1 to 6e-6 from here
MIN_BLUR = 0.2  # [px] pixel integration alone gives 0.29; below, no pixel may lie on an edge
INV_SQRT_2 = 0.7071067811865476
TWO_OVER_SQRT_PI = 1.1283791670955126

# Verdicts; correction.corners.CornerReason gives them names.
OK, EDGE, MASKED, SMALL, LOST, MOVED = 0, 1, 2, 3, 4, 5


def new_scratch() -> tuple[Array, ...]:
    """Return working memory of `fit_corners`: pixels, pulls, block sums, box, small vectors, normal equations."""
    pixels, pull, sums = np.empty((SIDE * SIDE, 4)), np.empty((SIDE * SIDE, 2)), np.empty((SIDE, 2))
    return pixels, pull, sums, np.empty(4, np.int64), np.empty((4, 2)), np.zeros((8 + 2 * FREE, FREE))


@kernel
def gather(
    image: Array, mask: Array, centre_u: float, centre_v: float, inverse: Array, extent: Array,
    reach: float, arm: float, box: Array, pixels: Array,
) -> int:  # fmt: skip
    """List the pixels of the cross around a centre; return their number, -EDGE or -MASKED.

    inverse (2, 2) float64 px -> squares; extent (2,) half size of the window for reach = 1 [px];
    mask (H, W) uint8, 0 = not to be used, or (1, 1) = all usable; box (4,) int64 out: u0, v0, width, height;
    pixels (SIDE^2, 4) float64 out: u - centre, v - centre, intensity, place in the box.
    """
    height, width = image.shape
    u0 = int(np.ceil(centre_u - reach * extent[0]))
    u1 = int(np.floor(centre_u + reach * extent[0]))
    v0 = int(np.ceil(centre_v - reach * extent[1]))
    v1 = int(np.floor(centre_v + reach * extent[1]))
    if u0 < 0 or v0 < 0 or u1 >= width or v1 >= height:
        return -EDGE
    box[0], box[1], box[2], box[3] = u0, v0, u1 - u0 + 1, v1 - v0 + 1
    masked = mask.size > 1
    count = 0
    for v in range(v0, v1 + 1):
        dv = v - centre_v
        for u in range(u0, u1 + 1):
            du = u - centre_u
            a = abs(inverse[0, 0] * du + inverse[0, 1] * dv)
            b = abs(inverse[1, 0] * du + inverse[1, 1] * dv)
            if a > reach or b > reach or (a > arm and b > arm):
                continue
            if masked and mask[v, u] == 0:
                return -MASKED
            pixels[count, 0] = du
            pixels[count, 1] = dv
            pixels[count, 2] = image[v, u]
            pixels[count, 3] = (v - v0) * (u1 - u0 + 1) + (u - u0)
            count += 1
    return count


@kernel
def gradient(p: Array, turn: Array, du: float, dv: float, row: Array) -> float:
    """Model intensity at a pixel and its derivatives by the free numbers into row (FREE,).

    p (FREE,) the free numbers, position relative to the window's centre; turn (4,) cosine and sine of both
    angles; row[0:8] is zero off the edges,
    which the caller can tell from the returned row[6] == row[7] == 0 and row[0] == row[1] == 0.
    """
    x, y = du - p[0], dv - p[1]
    c1, s1, c2, s2 = turn[0], turn[1], turn[2], turn[3]
    t1, m1 = c1 * x + s1 * y, c1 * y - s1 * x
    t2, m2 = c2 * x + s2 * y, s2 * x - c2 * y
    z1 = (m1 + p[4] * t1 * t1) * INV_SQRT_2 / p[6]
    z2 = (m2 + p[5] * t2 * t2) * INV_SQRT_2 / p[7]
    w1, w2 = z1 * z1, z2 * z2
    b1 = exp(-w1) if w1 < PLAIN * PLAIN else 0.0
    b2 = exp(-w2) if w2 < PLAIN * PLAIN else 0.0
    h1, h2 = z1 * (3.0 - 2.0 * w1) * b1, z2 * (3.0 - 2.0 * w2) * b2
    f1 = erf(z1) + p[12] * h1 if b1 > 0.0 else (1.0 if z1 > 0.0 else -1.0)
    f2 = erf(z2) + p[12] * h2 if b2 > 0.0 else (1.0 if z2 > 0.0 else -1.0)
    light = 1.0 + p[10] * du + p[11] * dv
    shade = p[8] + p[9] * f1 * f2
    bright = p[9] * light
    g1 = bright * f2 * b1 * (TWO_OVER_SQRT_PI + p[12] * (3.0 - w1 * (12.0 - 4.0 * w1)))
    g2 = bright * f1 * b2 * (TWO_OVER_SQRT_PI + p[12] * (3.0 - w2 * (12.0 - 4.0 * w2)))
    d1, d2 = g1 * INV_SQRT_2 / p[6], g2 * INV_SQRT_2 / p[7]
    bend1, bend2 = 2.0 * p[4] * t1, 2.0 * p[5] * t2
    row[0] = d1 * (s1 - bend1 * c1) - d2 * (s2 + bend2 * c2)
    row[1] = -d1 * (c1 + bend1 * s1) + d2 * (c2 - bend2 * s2)
    row[2] = d1 * (bend1 * m1 - t1)
    row[3] = d2 * (t2 - bend2 * m2)
    row[4] = d1 * t1 * t1
    row[5] = d2 * t2 * t2
    row[6] = -g1 * z1 / p[6]
    row[7] = -g2 * z2 / p[7]
    row[8] = light
    row[9] = f1 * f2 * light
    row[10] = shade * du
    row[11] = shade * dv
    row[12] = bright * (h1 * f2 + h2 * f1)
    return float(shade * light)


@kernel
def set_turn(p: Array, turn: Array) -> None:
    """Cosine and sine of both angles of p (FREE,) into turn (4,)."""
    turn[0], turn[1], turn[2], turn[3] = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])


@kernel
def normal_equations(
    p: Array,
    pixels: Array,
    count: int,
    ridge: float,
    shape_ridge: float,
    turn: Array,
    row: Array,
    normal: Array,
    right: Array,
) -> float:
    """Sum J^T J into normal (FREE, FREE, lower half), J^T r into right (FREE,); return the sum of r^2.

    ridge weighs the wish that both blurs agree, shape_ridge the wish that edges look like erf.
    """
    normal[:] = 0.0
    right[:] = 0.0
    set_turn(p, turn)
    astigmatism = p[6] - p[7]
    total = ridge * astigmatism * astigmatism + shape_ridge * p[12] * p[12]
    normal[6, 6] = normal[7, 7] = ridge
    normal[7, 6] = -ridge
    right[6], right[7] = -ridge * astigmatism, ridge * astigmatism
    normal[12, 12], right[12] = shape_ridge, -shape_ridge * p[12]
    for k in range(count):
        residual = pixels[k, 2] - gradient(p, turn, pixels[k, 0], pixels[k, 1], row)
        total += residual * residual
        for i in range(FREE):
            value = row[i]
            right[i] += value * residual
            if value != 0.0:  # off an edge its derivatives vanish
                for j in range(FREE):
                    normal[i, j] += value * row[j]
    return float(total)


@kernel
def factorise(normal: Array, damping: float, lower: Array) -> bool:
    """Cholesky factor of normal + damping diag(normal) into lower; False if it is not positive definite."""
    for i in range(FREE):
        for j in range(i + 1):
            value = normal[i, j]
            if i == j:
                value *= 1.0 + damping
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                if not value > 1e-14 * normal[i, i]:
                    return False
                lower[i, i] = sqrt(value)
            else:
                lower[i, j] = value / lower[j, j]
    return True


@kernel
def solve(lower: Array, right: Array, out: Array) -> None:
    """Solve lower lower^T out = right (FREE,)."""
    for i in range(FREE):
        value = right[i]
        for k in range(i):
            value -= lower[i, k] * out[k]
        out[i] = value / lower[i, i]
    for i in range(FREE - 1, -1, -1):
        value = out[i]
        for k in range(i + 1, FREE):
            value -= lower[k, i] * out[k]
        out[i] = value / lower[i, i]


@kernel
def start_levels(p: Array, pixels: Array, count: int, turn: Array, row: Array) -> None:
    """Least-squares A and B for the start geometry; p (FREE,) is changed in place."""
    set_turn(p, turn)
    p[8], p[9] = 0.0, 1.0
    q1 = q2 = y0 = y1 = 0.0
    for k in range(count):
        gradient(p, turn, pixels[k, 0], pixels[k, 1], row)
        q1 += row[9]
        q2 += row[9] * row[9]
        y0 += pixels[k, 2]
        y1 += row[9] * pixels[k, 2]
    p[9] = (y1 - q1 * y0 / count) / (q2 - q1 * q1 / count)
    p[8] = (y0 - p[9] * q1) / count


@kernel
def optimise(
    p: Array, pixels: Array, count: int, ridge: float, shape_ridge: float, limit: float, tolerance: float,
    trial: Array, turn: Array, row: Array, normal: Array,
    right: Array, lower: Array, step: Array, total: Array,
) -> bool:  # fmt: skip
    """Levenberg-Marquardt from p (FREE,), in place; True if it settled within `limit` px of the window's centre.

    On return normal holds J^T J at p and total[0] the sum of squares.
    """
    best = normal_equations(p, pixels, count, ridge, shape_ridge, turn, row, normal, right)
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
        now = normal_equations(trial, pixels, count, ridge, shape_ridge, turn, row, normal, right)
        if now <= best:
            settled = hypot(step[0], step[1]) < tolerance and best - now <= TOLERANCE_RATIO * tolerance * best
            p[:] = trial
            best = now
            damping = max(0.1 * damping, 1e-12)
            total[0] = best
            if settled:
                return True
        else:
            if hypot(step[0], step[1]) < 1e-5:
                total[0] = normal_equations(p, pixels, count, ridge, shape_ridge, turn, row, normal, right)
                return True
            normal_equations(p, pixels, count, ridge, shape_ridge, turn, row, normal, right)
            damping = min(damping * 10.0, 1e10)
    return False


@kernel
def covariance(
    p: Array, pixels: Array, count: int, box: Array, turn: Array, row: Array, normal: Array, lower: Array,
    weights: Array, step: Array, pull: Array, sums: Array, out: Array,
) -> bool:  # fmt: skip
    """Variance of u, of v and their covariance [px^2] into out (3,), from the residuals in the window.

    weights (2, FREE), pull (SIDE^2, 2), sums (SIDE, 2) are scratch.
    """
    if not factorise(normal, 0.0, lower):
        return False
    for axis in range(2):
        for i in range(FREE):
            row[i] = 1.0 if i == axis else 0.0
        solve(lower, row, step)
        for i in range(FREE):
            weights[axis, i] = step[i]
    set_turn(p, turn)
    width, height = box[2], box[3]
    for k in range(width * height):
        pull[k, 0] = 0.0
        pull[k, 1] = 0.0
    for k in range(count):
        residual = pixels[k, 2] - gradient(p, turn, pixels[k, 0], pixels[k, 1], row)
        place = int(pixels[k, 3])
        leverage = 0.0
        for i in range(FREE):
            value = row[i]
            for j in range(i):
                value -= lower[i, j] * step[j]
            step[i] = value / lower[i, i]
            leverage += step[i] * step[i]
        residual /= max(1.0 - leverage, 0.1)
        for axis in range(2):
            value = 0.0
            for i in range(FREE):
                value += weights[axis, i] * row[i]
            pull[place, axis] = value * residual
    uu = vv = uv = 0.0
    for top in range(1 - BLOCK, height):
        for c in range(width):
            sums[c, 0] = 0.0
            sums[c, 1] = 0.0
            for r in range(max(top, 0), min(top + BLOCK, height)):
                sums[c, 0] += pull[r * width + c, 0]
                sums[c, 1] += pull[r * width + c, 1]
        a = b = 0.0
        for right_end in range(width + BLOCK - 1):
            if right_end < width:
                a += sums[right_end, 0]
                b += sums[right_end, 1]
            if right_end >= BLOCK:
                a -= sums[right_end - BLOCK, 0]
                b -= sums[right_end - BLOCK, 1]
            uu += a * a
            vv += b * b
            uv += a * b
    scale = 1.0 / (BLOCK * BLOCK)
    out[0], out[1], out[2] = uu * scale, vv * scale, uv * scale
    return True


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
    the expected one; scratch from `new_scratch`, one a thread; out (N, 10): u, v, var u, var v, cov, rms
    residual, A, B, blur, reach used; verdict (N,) uint8.
    """
    pixels, pull, sums, box, small, square = scratch
    extent, inverse, total = small[0], small[1:3], small[3]
    turn = square[7 + 2 * FREE, :4]
    p, trial, row, right, step = square[0], square[1], square[2], square[3], square[4]
    weights, normal, lower = square[5:7], square[7 : 7 + FREE], square[7 + FREE : 7 + 2 * FREE]
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
                start_levels(p, pixels, count, turn, row)
                level = p[9]
            ridge = RIDGE * level * level
            # The shape is freed once the blur is right (under a wide first guess it finds a wrong minimum), and
            # given up where edges along pixel rows cannot tell it from blur.
            pin = ridge if rounds > 0 else 1e6 * ridge
            tolerance = SETTLED_PX if rounds > 0 else 0.05
            found = optimise(
                p, pixels, count, ridge, pin, limit, tolerance, trial, turn, row, normal, right, lower, step, total
            )
            if not found and rounds > 0:
                p[12] = 0.0
                pin = 1e6 * ridge
                found = optimise(
                    p,
                    pixels,
                    count,
                    ridge,
                    pin,
                    limit,
                    tolerance,
                    trial,
                    turn,
                    row,
                    normal,
                    right,
                    lower,
                    step,
                    total,
                )
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
                    p, pixels, count, box, turn, row, normal, lower, weights, step, pull, sums, out[n, 2:5]
                ):
                    verdict[n] = OK
                    out[n, 0], out[n, 1] = centre_u, centre_v
                    out[n, 5] = sqrt(total[0] / max(count - FREE, 1.0))
                    out[n, 6], out[n, 7] = p[8], p[9]
                    out[n, 8] = sqrt(0.5 * (p[6] * p[6] + p[7] * p[7]))
                    out[n, 9] = reach
                break
            p[0], p[1] = 0.0, 0.0
