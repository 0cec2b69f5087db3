"""The model of a corner at one pixel, by the library's erf and exp: what `corner_block` has to say of many."""

from math import erf, exp

from correction.target.kernels.corner_model import (
    INV_SQRT_2,
    LEANS,
    PLAIN,
    SQRT_2,
    TWO_OVER_PI,
    TWO_OVER_SQRT_PI,
)


def gradient(p, turn, du, dv, row):
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
