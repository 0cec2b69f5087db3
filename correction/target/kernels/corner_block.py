"""The model of a corner (`corner_model`) at many pixels at once: all that is asked of a fit, in vectors.

There is no branch in it: off an edge its Gaussian is zero, and with it every derivative of the geometry.  What no
vector has, erf z and exp(-z^2), is taken from polynomials in z^2, Chebyshev series up to the last term that a
rounding would notice.  Pixels stand as `gather` lists them, four rows of numbers; what lies behind the last
of them is calculated too, and not asked.
"""

import numpy as np

from correction.target.kernels.corner_model import (
    FREE,
    INV_SQRT_2,
    LEANS,
    PLAIN,
    SQRT_2,
    TWO_OVER_PI,
    TWO_OVER_SQRT_PI,
    set_turn,
)
from ground.jit import Array, kernel, kernel_inlined

PIXEL_LANES = 64  # pixels at a time
WIDE = 16  # numbers of a row, FREE and zeros: whole vectors
TERMS = 25
TOP = PLAIN * PLAIN

# Factors by powers of t = 2 z^2 / TOP - 1, the highest first: Chebyshev series of erf z / z and exp(-z^2), made at
# 60 digits; tests/correction/target/test_corners.py holds both to 1e-15.
ERF = np.array((
    3.696874323833639e-11, -1.8406344647356728e-10, 6.594044734914685e-10, -2.992228596514745e-09,
    1.3582461401165124e-08, -5.6619960653774096e-08, 2.243274003667601e-07, -8.490618280955986e-07,
    3.052996595620401e-06, -1.0396862928996824e-05, 3.344553286214689e-05, -0.00010132386465425147,
    0.00028811531023830594, -0.000766178138139186, 0.0018980926983938324, -0.004362715591776552,
    0.009265114317770084, -0.018109670134853564, 0.032480825056649135, -0.05340756311456326,
    0.08079500215647362, -0.11388618419024309, 0.15434036697515494, -0.21729558431769655,
    0.4413343883722037,
))  # fmt: skip
GAUSS = np.array((
    1.3166389756170598e-09, -6.2384903302852e-09, 2.0453794170779954e-08, -8.752029860112884e-08,
    3.779789499416638e-07, -1.4773563030681773e-06, 5.455015502205022e-06, -1.9176599977274352e-05,
    6.36972230332815e-05, -0.00019905483254202007, 0.0005831535036602068, -0.0015945598031018432,
    0.0040486929673694124, -0.009489124343941434, 0.02038678901982078, -0.039817947257733195,
    0.0699924856725465, -0.10936325886990764, 0.14952008046106383, -0.17521884428979945,
    0.17111215262801419, -0.13368136924065427, 0.07832892728942138, -0.030597237222430036,
    0.005976022895005945,
))  # fmt: skip


@kernel_inlined
def polynomial(t: float, factors: Array) -> float:
    """Value of a polynomial at t, factors (TERMS,) the highest first."""
    value = float(factors[0])
    for n in range(1, TERMS):
        value = value * t + factors[n]
    return value


@kernel_inlined
def gradients(p: Array, turn: Array, du: Array, dv: Array, out: Array) -> None:
    """Model intensity and its derivatives at pixels du, dv (PIXEL_LANES,), into out (FREE + 1, PIXEL_LANES).

    p (FREE,) the free numbers, position relative to the window's centre; turn (4,) cosine and sine of both angles.
    The intensity stands last.
    """
    p0, p1, p4, p5, p6, p7 = p[0], p[1], p[4], p[5], p[6], p[7]
    p8, p9, p10, p11, p12 = p[8], p[9], p[10], p[11], p[12]
    c1, s1, c2, s2 = turn[0], turn[1], turn[2], turn[3]
    r6, r7 = 1.0 / p6, 1.0 / p7
    # Blurred light that rises along g looks like light shifted by s^2 g.
    drag, upright, across = p6 * p7, -c1 * c2 - s1 * s2, c1 * s2 - s1 * c2
    for i in range(PIXEL_LANES):
        x, y = du[i] - p0 + drag * p10, dv[i] - p1 + drag * p11
        t1, m1 = c1 * x + s1 * y, c1 * y - s1 * x
        t2, m2 = c2 * x + s2 * y, s2 * x - c2 * y
        arc1, arc2 = t1 * t1 + p6 * p6, t2 * t2 + p7 * p7
        z1 = (m1 + p4 * arc1) * (INV_SQRT_2 * r6)
        z2 = (m2 + p5 * arc2) * (INV_SQRT_2 * r7)
        w1, w2 = z1 * z1, z2 * z2
        in1, in2 = w1 < TOP, w2 < TOP
        a1, a2 = min(w1, TOP) * (2.0 / TOP) - 1.0, min(w2, TOP) * (2.0 / TOP) - 1.0
        b1 = polynomial(a1, GAUSS) if in1 else 0.0
        b2 = polynomial(a2, GAUSS) if in2 else 0.0
        h1, h2 = z1 * (3.0 - 2.0 * w1) * b1, z2 * (3.0 - 2.0 * w2) * b2
        f1 = z1 * polynomial(a1, ERF) + p12 * h1 if in1 else (1.0 if z1 > 0.0 else -1.0)
        f2 = z2 * polynomial(a2, ERF) + p12 * h2 if in2 else (1.0 if z2 > 0.0 else -1.0)
        light = 1.0 + p10 * du[i] + p11 * dv[i]
        bright = p9 * light
        g1 = bright * f2 * b1 * (TWO_OVER_SQRT_PI + p12 * (3.0 - w1 * (12.0 - 4.0 * w1)))
        g2 = bright * f1 * b2 * (TWO_OVER_SQRT_PI + p12 * (3.0 - w2 * (12.0 - 4.0 * w2)))
        bend1, bend2, bow = 2.0 * p4 * t1, 2.0 * p5 * t2, p4 * t1 + p5 * t2
        rho, both = upright + bow * across, TWO_OVER_PI * b1 * b2
        h, k = SQRT_2 * z1, SQRT_2 * z2
        product, by_rho, by_h, by_k = f1 * f2, 0.0, 0.0, 0.0
        a, b, a_next, b_next, power = 1.0, 1.0, h, k, both  # Hermite polynomials, rho^(m - 1) / (m - 1)!
        for m in range(1, 1 + LEANS):
            by_rho += power * a * b
            power *= rho * (1.0 / m)
            product += power * a * b
            by_h -= power * a_next * b
            by_k -= power * a * b_next
            a, a_next = a_next, h * a_next - m * a
            b, b_next = b_next, k * b_next - m * b
        by_rho *= bright
        g1 += bright * SQRT_2 * by_h
        g2 += bright * SQRT_2 * by_k
        shade = p8 + p9 * product
        d1, d2 = g1 * (INV_SQRT_2 * r6), g2 * (INV_SQRT_2 * r7)
        lean = by_rho * (bow * upright - across)  # by angle 1; by angle 2 the opposite
        turn1, turn2 = by_rho * across * p4, by_rho * across * p5  # by t1, t2
        by_u = d1 * (s1 - bend1 * c1) - d2 * (s2 + bend2 * c2) - turn1 * c1 - turn2 * c2
        by_v = -d1 * (c1 + bend1 * s1) + d2 * (c2 - bend2 * s2) - turn1 * s1 - turn2 * s2
        dragged = -by_u * p10 - by_v * p11
        out[0, i], out[1, i] = by_u, by_v
        out[2, i] = d1 * (bend1 * m1 - t1) + turn1 * m1 + lean
        out[3, i] = d2 * (t2 - bend2 * m2) - turn2 * m2 - lean
        out[4, i] = d1 * arc1 + by_rho * across * t1
        out[5, i] = d2 * arc2 + by_rho * across * t2
        out[6, i] = 2.0 * d1 * p4 * p6 - g1 * z1 * r6 + dragged * p7
        out[7, i] = 2.0 * d2 * p5 * p7 - g2 * z2 * r7 + dragged * p6
        out[8, i], out[9, i] = light, product * light
        out[10, i], out[11, i] = shade * du[i] - drag * by_u, shade * dv[i] - drag * by_v
        out[12, i] = bright * (h1 * f2 + h2 * f1)
        out[13, i] = shade * light


@kernel_inlined
def start_levels(p: Array, pixels: Array, count: int, turn: Array, block: Array) -> None:
    """Least-squares A and B for the start geometry; p (FREE,) is changed in place."""
    set_turn(p, turn)
    p[8], p[9] = 0.0, 1.0
    q1 = q2 = y0 = y1 = 0.0
    for first in range(0, count, PIXEL_LANES):
        gradients(p, turn, pixels[0, first : first + PIXEL_LANES], pixels[1, first : first + PIXEL_LANES], block)
        for i in range(min(PIXEL_LANES, count - first)):
            q1 += block[9, i]
            q2 += block[9, i] * block[9, i]
            y0 += pixels[2, first + i]
            y1 += block[9, i] * pixels[2, first + i]
    p[9] = (y1 - q1 * y0 / count) / (q2 - q1 * q1 / count)
    p[8] = (y0 - p[9] * q1) / count


@kernel_inlined
def products(p: Array, pixels: Array, count: int, turn: Array, block: Array, rows: Array, sums: Array) -> None:
    """Sums over all pixels (4, count or more) of products of derivatives and residual into sums (FREE + 1, WIDE).

    The residual stands last.  block (FREE + 1, PIXEL_LANES), rows (PIXEL_LANES, WIDE; zero from FREE + 1 on) are
    scratch.
    """
    set_turn(p, turn)
    sums[:] = 0.0
    for first in range(0, count, PIXEL_LANES):
        gradients(p, turn, pixels[0, first : first + PIXEL_LANES], pixels[1, first : first + PIXEL_LANES], block)
        for i in range(PIXEL_LANES):
            block[FREE, i] = pixels[2, first + i] - block[FREE, i]
        for k in range(PIXEL_LANES):
            for j in range(FREE + 1):
                rows[k, j] = block[j, k]
        some = min(PIXEL_LANES, count - first)
        whole = (some + 7) // 8 * 8
        rows[some:whole] = 0.0
        for k in range(0, whole, 8):
            for i in range(FREE + 1):
                a, b, c, d = rows[k, i], rows[k + 1, i], rows[k + 2, i], rows[k + 3, i]
                e, f, g, h = rows[k + 4, i], rows[k + 5, i], rows[k + 6, i], rows[k + 7, i]
                for j in range(WIDE):
                    value = sums[i, j] + a * rows[k, j] + b * rows[k + 1, j] + c * rows[k + 2, j]
                    value += d * rows[k + 3, j] + e * rows[k + 4, j] + f * rows[k + 5, j]
                    sums[i, j] = value + g * rows[k + 6, j] + h * rows[k + 7, j]


@kernel
def draw_smeared(
    axes: Array, blur: Array, steps: Array, share: Array, first: int, last: int, p: Array, turn: Array,
    block: Array, out: Array,
) -> None:  # fmt: skip
    """Draw corners first..last-1, each the sum of displaced ones, about the middles of their tiles.

    axes (N, 2, 2) px per square; blur (N,) px; steps (K, N, 2) where each part shows the corner [px] and share (K,
    N) of the light; p (FREE,), turn (4,), block (FREE + 3, PIXEL_LANES) are scratch; out (N, S, S), S odd, dark
    -1, bright 1.
    """
    side = out.shape[1]
    du, dv = block[FREE + 1], block[FREE + 2]
    for n in range(first, last):
        p[:] = 0.0
        p[2] = np.arctan2(axes[n, 1, 0], axes[n, 0, 0])
        p[3] = np.arctan2(axes[n, 1, 1], axes[n, 0, 1])
        p[6], p[7], p[9] = blur[n], blur[n], 1.0
        set_turn(p, turn)
        out[n] = 0.0
        for begin in range(0, side * side, PIXEL_LANES):
            for i in range(PIXEL_LANES):
                du[i], dv[i] = float((begin + i) % side - side // 2), float((begin + i) // side - side // 2)
            for k in range(len(steps)):
                p[0], p[1] = steps[k, n, 0], steps[k, n, 1]
                gradients(p, turn, du, dv, block)
                for i in range(min(PIXEL_LANES, side * side - begin)):
                    out[n, (begin + i) // side, (begin + i) % side] += share[k, n] * block[FREE, i]
