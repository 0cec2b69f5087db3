"""A ray and a solid sphere, in rotation form.

State of a ray relative to a sphere's centre: the unit direction d and the foot point a, the point of the
line nearest the centre (a . d = 0).  With impact parameter b = |a| and relative index n:

    cos i = sqrt(1 - b^2/R^2),   cos t = sqrt(1 - b^2/(n R)^2)            (Snell: sin i = n sin t = b/R)

A ray that enters and leaves meets both surfaces at the same angles, and leaves with the same b: the pair
(a, d) has simply been turned by delta = 2 (i - t) in its own plane.  No entry point, no exit point, no
normal, no second root of a quadratic is ever formed.  With

    g = cos t - cos i / n = (1 - 1/n^2) / (cos t + cos i / n),     sin(i - t) = (b/R) g,
    cos(i - t) = cos i cos t + b^2/(n R^2),     q = 2 g cos(i - t) / R          (b q = sin delta)

    d' = d cos delta - a q,      a' = a cos delta + d b^2 q,      cos delta = 1 - 2 (b g / R)^2.

The second form of g has no cancellation as n -> 1 (the first loses log10(1/(n-1)) digits); at n = 1 the
turn is exactly nothing.  Total reflection (n < 1) is decided by b >= n R, never by the sign of a root.

Light is unpolarised at every surface:

    T = 2 n cos i cos t [1/(cos i + n cos t)^2 + 1/(n cos i + cos t)^2].
"""

import math

from ground.jit import kernel

# Columns of a sphere table (N, 6 or more).  Cores follow inwards (``tracer.kernels.shell``).
CENTRE_X, CENTRE_Y, CENTRE_Z, RADIUS, INDEX, OPAQUE, SOLID = range(7)


@kernel
def foot(wx: float, wy: float, wz: float, dx: float, dy: float, dz: float) -> tuple[float, ...]:
    """Distance along the ray to the foot point, and the foot point, of a ray from w relative to a centre."""
    m = -(wx * dx + wy * dy + wz * dz)
    ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
    # Once more: for a far camera the first subtraction leaves a part along d of the size of its rounding.
    e = ax * dx + ay * dy + az * dz
    return m, ax - e * dx, ay - e * dy, az - e * dz


@kernel
def angles(b2: float, radius: float, n: float) -> tuple[float, ...]:
    """Cos i, cos t for squared impact parameter b2 < R^2; cos t is 0 from the critical angle on."""
    r2 = radius * radius
    inner2 = n * n * r2
    cos_i = math.sqrt((r2 - b2) / r2)
    cos_t = math.sqrt((inner2 - b2) / inner2) if b2 < inner2 else 0.0
    return cos_i, cos_t


@kernel
def through(b2: float, radius: float, n: float, cos_i: float, cos_t: float) -> tuple[float, ...]:
    """Cos delta and q of the turn by 2 (i - t): in, and straight out again."""
    g = (n - 1.0) * (n + 1.0) / (n * n) / (cos_t + cos_i / n)
    chi = b2 / (radius * radius)
    return 1.0 - 2.0 * chi * g * g, 2.0 * g * (cos_i * cos_t + chi / n) / radius


@kernel
def turned(
    ax: float, ay: float, az: float, dx: float, dy: float, dz: float, b2: float, cosine: float, q: float
) -> tuple[float, ...]:
    """Foot point and direction after a turn given by cos delta and q = sin delta / b."""
    along = b2 * q
    return (
        ax * cosine + dx * along,
        ay * cosine + dy * along,
        az * cosine + dz * along,
        dx * cosine - ax * q,
        dy * cosine - ay * q,
        dz * cosine - az * q,
    )


@kernel
def transmittance(cos_i: float, cos_t: float, n: float) -> float:
    """Share of unpolarised light that passes one surface (the same from either side)."""
    s = cos_i + n * cos_t
    p = n * cos_i + cos_t
    return 2.0 * n * cos_i * cos_t * (1.0 / (s * s) + 1.0 / (p * p))


@kernel
def foot_tangent(
    wx: float,
    wy: float,
    wz: float,
    dx: float,
    dy: float,
    dz: float,
    m: float,
    vx: float,
    vy: float,
    vz: float,
    ex: float,
    ey: float,
    ez: float,
) -> tuple[float, ...]:
    """Derivative of the foot point when w changes by v and d by e (m from `foot`)."""
    k = -(vx * dx + vy * dy + vz * dz + wx * ex + wy * ey + wz * ez)
    return vx + k * dx + m * ex, vy + k * dy + m * ey, vz + k * dz + m * ez


@kernel
def through_rates(
    b2: float,
    radius: float,
    n: float,
    cos_i: float,
    cos_t: float,
    b2_rate: float,
    radius_rate: float,
    n_rate: float,
) -> tuple[float, ...]:
    """Derivatives of `through`'s cos delta and q for given rates of b^2, R and n."""
    nu = 1.0 / n
    nu_rate = -n_rate * nu * nu
    chi = b2 / (radius * radius)
    chi_rate = b2_rate / (radius * radius) - 2.0 * chi * radius_rate / radius
    i_rate = -0.5 * chi_rate / cos_i
    t_rate = -(0.5 * chi_rate * nu * nu + chi * nu * nu_rate) / cos_t
    denominator = cos_t + cos_i * nu
    g = (n - 1.0) * (n + 1.0) / (n * n) / denominator
    g_rate = -(2.0 * nu * nu_rate + g * (t_rate + nu * i_rate + cos_i * nu_rate)) / denominator
    c = cos_i * cos_t + chi * nu
    c_rate = i_rate * cos_t + cos_i * t_rate + chi_rate * nu + chi * nu_rate
    cosine_rate = -2.0 * g * (chi_rate * g + 2.0 * chi * g_rate)
    q_rate = 2.0 * (g_rate * c + g * c_rate) / radius - 2.0 * g * c * radius_rate / (radius * radius)
    return cosine_rate, q_rate


@kernel
def turned_tangent(
    ax: float,
    ay: float,
    az: float,
    dx: float,
    dy: float,
    dz: float,
    b2: float,
    cosine: float,
    q: float,
    ux: float,
    uy: float,
    uz: float,
    ex: float,
    ey: float,
    ez: float,
    b2_rate: float,
    cosine_rate: float,
    q_rate: float,
) -> tuple[float, ...]:
    """Derivative of `turned` when a changes by u, d by e and the turn by its rates."""
    along = b2 * q
    along_rate = b2_rate * q + b2 * q_rate
    return (
        ux * cosine + ax * cosine_rate + ex * along + dx * along_rate,
        uy * cosine + ay * cosine_rate + ey * along + dy * along_rate,
        uz * cosine + az * cosine_rate + ez * along + dz * along_rate,
        ex * cosine + dx * cosine_rate - ux * q - ax * q_rate,
        ey * cosine + dy * cosine_rate - uy * q - ay * q_rate,
        ez * cosine + dz * cosine_rate - uz * q - az * q_rate,
    )
