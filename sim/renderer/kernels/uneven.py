"""Balls out of round of the renderer: an implicit surface, found by chords; its normal by differences.

Row of such a ball: centre, mean radius, n / n around, opaque, UNEVEN, highest degree, then coefficients [mm] by
order and degree, cosines before sines, times their normalisation.  With the unit vector (x, y, z) from the centre

    r = R + sum A_lm(z) (c_lm Re (x + i y)^m + s_lm Im (x + i y)^m),

A_lm being Legendre's functions without their power of the cosine, by their recursion in degree: no pole.  A ray
meets the surface where its distance from the centre is r: between a point outside and the one nearest the centre,
by the chord of both whose older end counts half (Illinois).  (The tracer knows polynomials of degree 6, their
gradients and Newton's tangents; nothing here is shared with it.)
"""

import numpy as np

from ground.jit import kernel
from sim.renderer.kernels.surfaces import SOLID, Float64

UNEVEN = -1.0  # where other rows have the radius of a core
DEGREE, FIRST = SOLID + 1, SOLID + 2
STEP = 1e-4  # [rad] of differences
CHORDS, CLOSE_MM = 40, 1e-12
LOWEST = 2


@kernel
def is_uneven(s: Float64) -> bool:
    """Return whether the row is one of a ball out of round."""
    return bool(s.shape[0] > SOLID and s[SOLID] == UNEVEN)


@kernel
def radius_at(x: float, y: float, z: float, s: Float64) -> float:
    """Distance of the surface from the centre along (x, y, z), of any length."""
    length = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    r, cosine, sine, first, place = s[3], 1.0, 0.0, 1.0, FIRST
    highest = int(s[DEGREE])
    for m in range(highest + 1):
        below, value = 0.0, first
        for degree in range(m, highest + 1):
            if degree >= LOWEST:
                r += value * (s[place] * cosine + s[place + 1] * sine)
                place += 2
            below, value = value, ((2 * degree + 1) * z * value - (degree + m) * below) / (degree + 1 - m)
        cosine, sine = cosine * x - sine * y, sine * x + cosine * y
        first *= 2 * m + 1
    return float(r)


@kernel
def beyond(x: float, y: float, z: float, s: Float64) -> float:
    """Distance of a point, relative to the centre, from the surface; positive outside."""
    return float(np.sqrt(x * x + y * y + z * z) - radius_at(x, y, z, s))


@kernel
def crossing(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, s: Float64, entering: bool
) -> float:
    """Path length to the surface of a ball ahead, infinity for a miss; to the far side if not `entering`."""
    x, y, z = ox - s[0], oy - s[1], oz - s[2]
    nearest = -(dx * x + dy * y + dz * z)
    if entering and nearest <= 0.0:
        return float(np.inf)
    off2 = x * x + y * y + z * z - nearest * nearest
    around = 1.1 * s[3]
    if off2 >= around * around:
        return float(np.inf)
    reach = np.sqrt(around * around - off2)
    a, b = nearest - reach if entering else nearest + reach, nearest
    f_a = beyond(x + a * dx, y + a * dy, z + a * dz, s)
    f_b = beyond(x + b * dx, y + b * dy, z + b * dz, s)
    if f_b >= 0.0:
        return float(np.inf) if entering else float(b)
    for _ in range(CHORDS):
        c = b - f_b * (b - a) / (f_b - f_a)
        f = beyond(x + c * dx, y + c * dy, z + c * dz, s)
        if abs(f) < CLOSE_MM:
            return float(c)
        if f * f_b < 0.0:
            a, f_a = b, f_b
        else:
            f_a *= 0.5
        b, f_b = c, f
    return float(b)


@kernel
def normal_at(px: float, py: float, pz: float, s: Float64) -> tuple[float, float, float]:
    """Outward unit normal at a point of the surface."""
    x, y, z = px - s[0], py - s[1], pz - s[2]
    rho = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / rho, y / rho, z / rho
    if abs(z) < 0.7:  # two directions across
        ex, ey, ez = y, -x, 0.0
    else:
        ex, ey, ez = 0.0, z, -y
    length = np.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex / length, ey / length, ez / length
    fx, fy, fz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex
    one = radius_at(x + STEP * ex, y + STEP * ey, z + STEP * ez, s)
    one = (one - radius_at(x - STEP * ex, y - STEP * ey, z - STEP * ez, s)) / (2.0 * STEP * rho)
    two = radius_at(x + STEP * fx, y + STEP * fy, z + STEP * fz, s)
    two = (two - radius_at(x - STEP * fx, y - STEP * fy, z - STEP * fz, s)) / (2.0 * STEP * rho)
    x, y, z = x - one * ex - two * fx, y - one * ey - two * fy, z - one * ez - two * fz
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
