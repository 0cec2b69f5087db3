"""What the neighbourhood of a chessboard corner looks like: two blurred edges that cross.

Around the corner p, with d = x - p + s1 s2 g and for each edge k = 1, 2 its direction t_k, its normal n_k:

    I(x) = (A + B (f(z1) f(z2) + T)) (1 + g . (x - x0)),       f(z) = erf(z) + h z (3 - 2 z^2) exp(-z^2)
    z_k  = (n_k . d + c_k ((t_k . d)^2 + s_k^2)) / (sqrt(2) s_k)
    T    = 4 sum_m rho^m / m! phi^(m-1)(sqrt(2) z1) phi^(m-1)(sqrt(2) z2)
    rho  = n_1 . n_2 + (t_1 x t_2) (c_1 t_1 + c_2 t_2) . d

Thirteen numbers are free: p, both angles, both curvatures c_k (glass bends edges; a straight line through an
arc would miss the corner by c l^2 / 3 for arms of length l), both blurs (pixel integration only adds 1/12
px^2 to s^2, in any direction), A, B, the slope g of the illumination, which would otherwise pull on p, and
the shape h of the edge, which lenses give tails that erf has not.  n_1 and n_2 are turned so that the product
of the two edges is positive in the quadrant between +axis 1 and +axis 2, whichever handedness the view has;
the sign of B is the shade of the square there.

What lies in the scene comes before the blur, which draws a bent edge towards its hollow side by c s^2 and, in
light that changes, everything against g by s^2 g (each 0.07 px at s = 2 px near a rim), and makes more of a
corner than a product where edges do not cross at right angles: sgn sgn blurred is the bivariate normal
integral, T as Mehler's series, phi the normal density (without it sigmas were up to ten times too large).  Of the
turn of a bent edge, 2 c t, half counts in rho: its skewness takes back the other half.

The pixels asked are those of a cross: arms of half length `reach` and half width `arm` squares in the affine
frame of the view.  The window is an exact set of pixels.
"""

from math import cos, erf, exp, sin

import numpy as np

from ground.jit import Array, kernel

FREE = 13  # px, py, angle 1, angle 2, curvature 1, 2, blur 1, 2, A, B, slope u, slope v, edge shape
SIDE = 121  # largest bounding box of a window [px]
PLAIN = 3.2  # erf is +-1 to 6e-6 from here
INV_SQRT_2 = 0.7071067811865476
TWO_OVER_SQRT_PI = 1.1283791670955126
TWO_OVER_PI = 0.6366197723675814
SQRT_2 = 1.4142135623730951
LEANS = 5  # terms of the series: 1e-3 of the contrast for edges that cross at 50 degrees

# Verdicts; correction.target.corners.CornerReason gives them names.
OK, EDGE, MASKED, SMALL, LOST, MOVED = 0, 1, 2, 3, 4, 5


@kernel
def gather(
    image: Array, mask: Array, centre_u: float, centre_v: float, inverse: Array, extent: Array,
    reach: float, arm: float, box: Array, pixels: Array,
) -> int:  # fmt: skip
    """List the pixels of the cross around a centre; return their number, -EDGE or -MASKED.

    inverse (2, 2) float64 px -> squares; extent (2,) half size of the window for reach = 1 [px];
    mask (H, W) uint8, 0 = not to be used, or (1, 1) = all usable; box (4,) int64 out: u0, v0, width, height;
    pixels (4, SIDE^2 or more) float64 out: u - centre, v - centre, intensity, place in the box.
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
            pixels[0, count] = du
            pixels[1, count] = dv
            pixels[2, count] = image[v, u]
            pixels[3, count] = (v - v0) * (u1 - u0 + 1) + (u - u0)
            count += 1
    return count


@kernel
def gradient(p: Array, turn: Array, du: float, dv: float, row: Array) -> float:
    """Model intensity at a pixel and its derivatives by the free numbers into row (FREE,).

    p (FREE,) the free numbers, position relative to the window's centre; turn (4,) cosine and sine of both
    angles; row[0:8] is zero off the edges.
    """
    drag = p[6] * p[7]  # blurred light that rises along g looks like light shifted by s^2 g
    x, y = du - p[0] + drag * p[10], dv - p[1] + drag * p[11]
    c1, s1, c2, s2 = turn[0], turn[1], turn[2], turn[3]
    t1, m1 = c1 * x + s1 * y, c1 * y - s1 * x
    t2, m2 = c2 * x + s2 * y, s2 * x - c2 * y
    arc1, arc2 = t1 * t1 + p[6] * p[6], t2 * t2 + p[7] * p[7]
    z1 = (m1 + p[4] * arc1) * INV_SQRT_2 / p[6]
    z2 = (m2 + p[5] * arc2) * INV_SQRT_2 / p[7]
    w1, w2 = z1 * z1, z2 * z2
    b1 = exp(-w1) if w1 < PLAIN * PLAIN else 0.0
    b2 = exp(-w2) if w2 < PLAIN * PLAIN else 0.0
    h1, h2 = z1 * (3.0 - 2.0 * w1) * b1, z2 * (3.0 - 2.0 * w2) * b2
    f1 = erf(z1) + p[12] * h1 if b1 > 0.0 else (1.0 if z1 > 0.0 else -1.0)
    f2 = erf(z2) + p[12] * h2 if b2 > 0.0 else (1.0 if z2 > 0.0 else -1.0)
    light = 1.0 + p[10] * du + p[11] * dv
    if b1 == 0.0 and b2 == 0.0:
        plain = f1 * f2
        level = p[8] + p[9] * plain
        row[:8] = 0.0
        row[8], row[9], row[10], row[11], row[12] = light, plain * light, level * du, level * dv, 0.0
        return float(level * light)
    bright = p[9] * light
    g1 = bright * f2 * b1 * (TWO_OVER_SQRT_PI + p[12] * (3.0 - w1 * (12.0 - 4.0 * w1)))
    g2 = bright * f1 * b2 * (TWO_OVER_SQRT_PI + p[12] * (3.0 - w2 * (12.0 - 4.0 * w2)))
    bend1, bend2 = 2.0 * p[4] * t1, 2.0 * p[5] * t2
    product, by_rho = f1 * f2, 0.0
    upright, across, bow = -c1 * c2 - s1 * s2, c1 * s2 - s1 * c2, p[4] * t1 + p[5] * t2
    if b1 > 0.0 and b2 > 0.0:
        rho, both = upright + bow * across, TWO_OVER_PI * b1 * b2
        h, k = SQRT_2 * z1, SQRT_2 * z2
        a, b, a_next, b_next, power = 1.0, 1.0, h, k, both  # Hermite polynomials, rho^(m - 1) / (m - 1)!
        by_h = by_k = 0.0
        for m in range(1, 1 + LEANS):
            by_rho += power * a * b
            power *= rho / m
            product += power * a * b
            by_h -= power * a_next * b
            by_k -= power * a * b_next
            a, a_next = a_next, h * a_next - m * a
            b, b_next = b_next, k * b_next - m * b
        by_rho *= bright
        g1 += bright * SQRT_2 * by_h
        g2 += bright * SQRT_2 * by_k
    shade = p[8] + p[9] * product
    d1, d2 = g1 * INV_SQRT_2 / p[6], g2 * INV_SQRT_2 / p[7]
    lean = by_rho * (bow * upright - across)  # by angle 1; by angle 2 the opposite
    turn1, turn2 = by_rho * across * p[4], by_rho * across * p[5]  # by t1, t2
    row[0] = d1 * (s1 - bend1 * c1) - d2 * (s2 + bend2 * c2) - turn1 * c1 - turn2 * c2
    row[1] = -d1 * (c1 + bend1 * s1) + d2 * (c2 - bend2 * s2) - turn1 * s1 - turn2 * s2
    row[2] = d1 * (bend1 * m1 - t1) + turn1 * m1 + lean
    row[3] = d2 * (t2 - bend2 * m2) - turn2 * m2 - lean
    row[4] = d1 * arc1 + by_rho * across * t1
    row[5] = d2 * arc2 + by_rho * across * t2
    dragged = -row[0] * p[10] - row[1] * p[11]
    row[6] = 2.0 * d1 * p[4] * p[6] - g1 * z1 / p[6] + dragged * p[7]
    row[7] = 2.0 * d2 * p[5] * p[7] - g2 * z2 / p[7] + dragged * p[6]
    row[8] = light
    row[9] = product * light
    row[10] = shade * du - drag * row[0]
    row[11] = shade * dv - drag * row[1]
    row[12] = bright * (h1 * f2 + h2 * f1)
    return float(shade * light)


@kernel
def set_turn(p: Array, turn: Array) -> None:
    """Cosine and sine of both angles of p (FREE,) into turn (4,)."""
    turn[0], turn[1], turn[2], turn[3] = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])


@kernel
def draw_smeared(
    axes: Array, blur: Array, steps: Array, share: Array, first: int, last: int, p: Array, turn: Array,
    row: Array, out: Array,
) -> None:  # fmt: skip
    """Draw corners first..last-1, each the sum of displaced ones, about the middles of their tiles.

    axes (N, 2, 2) px per square; blur (N,) px; steps (K, N, 2) where each part shows the corner [px] and share
    (K, N) of the light; p (FREE,), turn (4,), row (FREE,) are scratch; out (N, S, S), S odd, dark -1, bright 1.
    """
    half = out.shape[1] // 2
    for n in range(first, last):
        p[:] = 0.0
        p[2] = np.arctan2(axes[n, 1, 0], axes[n, 0, 0])
        p[3] = np.arctan2(axes[n, 1, 1], axes[n, 0, 1])
        p[6], p[7], p[9] = blur[n], blur[n], 1.0
        set_turn(p, turn)
        out[n] = 0.0
        for k in range(len(steps)):
            p[0], p[1] = steps[k, n, 0], steps[k, n, 1]
            for j in range(out.shape[1]):
                for i in range(out.shape[2]):
                    out[n, j, i] += share[k, n] * gradient(p, turn, float(i - half), float(j - half), row)
