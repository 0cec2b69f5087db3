"""A ray and a sphere, solid or with spheres in it, in rotation form.

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

**Cores**: hollow balls, shells, anything concentric.  Everything is symmetric about one centre, so n r sin(angle
to the radius) is the same all along the ray (Bouguer): it is b, the impact parameter outside, and it turns in one
plane.  At core k, of radius r, with index n' outside of it and n inside,

    sin i = b / (n' r),     sin t = b / (n r),     turn 2 (i - t) on the way in and out,

which is a solid sphere of OPTICAL RADIUS  rho = n' r  and relative index  nu = n / n'  about the same centre.
So nothing new is calculated: each core is one more sphere in the form above, with the
same b^2, and the turns of all surfaces passed add up.  Cosine and q = sine / b of a sum of turns:

    C = C1 C2 - b^2 q1 q2,          q = C1 q2 + q1 C2.

A core of the glass around it turns by exactly nothing.  Optical path and light go with each core as with a
sphere: 2 rho (nu cos t - cos i), and T at each of the two crossings.

How deep a ray comes is decided by b alone, never by the sign of a root: it meets core k if b < rho, and enters it
if also b < nu rho.  If it does not enter, it is totally reflected there and leaves by the way it came: the turn
is 2 i - pi in place of 2 (i - t), the path -2 rho cos i.  All its light goes on, so it is a way through the ball
like the others.  Beside the core, through it, reflected by it: three families of rays, smooth each, that meet at
a kink.  They are different ways of one ball, and different branches:

    way 0          beside all cores, as through a solid sphere
    way 2 k - 1    through core k, beside or without core k + 1          (cores counted 1, 2, ... inwards)
    way 2 k        through core k - 1, totally reflected at core k.

Rows of a sphere table with cores are longer than SOLID: radius and relative index (to the room) of each core
follow, inwards; radius 0 where a sphere has none or fewer.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.vectors import Vector, add_dot, combine, dot, move

# Columns of a sphere table (N, 6 or more).  Cores follow inwards.
CENTRE_X, CENTRE_Y, CENTRE_Z, RADIUS, REFRACTIVE_INDEX, OPAQUE, SOLID = range(7)
Turn = tuple[float, float]  # cos delta and q = sin delta / b, or their derivatives


@kernel
def way_through(b2: float, sphere: Array) -> int:
    """Way of a ray of squared impact parameter b2 through a sphere (a row of the table)."""
    way = 0
    if b2 < sphere[RADIUS] * sphere[RADIUS]:
        outside = sphere[REFRACTIVE_INDEX]
        for at in range(SOLID, sphere.shape[0], 2):
            rho, inner = outside * sphere[at], sphere[at + 1] * sphere[at]
            if not b2 < rho * rho:
                break
            if not b2 < inner * inner:
                return int(at - SOLID + 2)
            way = int(at - SOLID + 1)
            outside = sphere[at + 1]
    return way


@kernel
def core_turn(b2: float, rho: float, nu: float, reflected: bool) -> tuple[float, ...]:
    """Turn at one core: cos, q, optical path, light that passes."""
    cos_i, cos_t = angles(b2, rho, nu)
    if reflected:
        return 2.0 * b2 / (rho * rho) - 1.0, -2.0 * cos_i / rho, -2.0 * rho * cos_i, 1.0
    cosine, q = through(b2, rho, nu, cos_i, cos_t)
    surface = transmittance(cos_i, cos_t, nu)
    return cosine, q, 2.0 * rho * (nu * cos_t - cos_i), surface * surface


@kernel
def core_turn_rates(
    b2: float, rho: float, nu: float, reflected: bool, b2_rate: float, rho_rate: float, nu_rate: float
) -> Turn:
    """Derivatives of `core_turn`'s cos and q for given rates of b^2, rho and nu."""
    cos_i, cos_t = angles(b2, rho, nu)
    if reflected:
        chi_rate = (b2_rate - 2.0 * b2 * rho_rate / rho) / (rho * rho)
        return 2.0 * chi_rate, (chi_rate / cos_i + 2.0 * cos_i * rho_rate / rho) / rho
    return through_rates(b2, rho, nu, cos_i, cos_t, b2_rate, rho_rate, nu_rate)


@kernel
def with_cores(b2: float, sphere: Array, way: int, turn: Turn) -> tuple[Turn, float, float]:
    """Add the turns of the cores to a solid sphere's; optical path added, share of light that passes."""
    (cosine, q), path, passed, outside = turn, 0.0, 1.0, sphere[REFRACTIVE_INDEX]
    for k in range((way + 1) // 2):
        radius, inside = sphere[SOLID + 2 * k], sphere[SOLID + 2 * k + 1]
        c, s, more, share = core_turn(b2, outside * radius, inside / outside, way == 2 * k + 2)
        cosine, q = cosine * c - b2 * q * s, cosine * s + q * c
        path += more
        passed *= share
        outside = inside
    return (cosine, q), path, passed


@kernel
def with_cores_rates(
    b2: float, sphere: Array, way: int, turn: Turn, rates: Turn, b2_rate: float, n_rate: float
) -> Turn:
    """Derivatives of cos and q of `with_cores`, from those of the solid sphere and the rates of b^2 and its n."""
    (cosine, q), (cosine_rate, q_rate), outside = turn, rates, sphere[REFRACTIVE_INDEX]
    for k in range((way + 1) // 2):
        radius, inside, reflected = sphere[SOLID + 2 * k], sphere[SOLID + 2 * k + 1], way == 2 * k + 2
        rho, nu = outside * radius, inside / outside
        c, s, _, _ = core_turn(b2, rho, nu, reflected)
        c_rate, s_rate = core_turn_rates(b2, rho, nu, reflected, b2_rate, n_rate * radius, -n_rate * nu / outside)
        cosine_rate, q_rate = (
            cosine_rate * c + cosine * c_rate - b2_rate * q * s - b2 * (q_rate * s + q * s_rate),
            cosine_rate * s + cosine * s_rate + q_rate * c + q * c_rate,
        )
        cosine, q = cosine * c - b2 * q * s, cosine * s + q * c
        outside, n_rate = inside, 0.0
    return cosine_rate, q_rate


@kernel
def foot(w: Vector, d: Vector) -> tuple[float, Vector]:
    """Distance along the ray to the foot point, and the foot point, of a ray from w relative to a centre."""
    m = -dot(w, d)
    a = move(w, m, d)
    # Once more: for a far camera the first subtraction leaves a part along d of the size of its rounding.
    return m, move(a, -dot(a, d), d)


@kernel
def angles(b2: float, radius: float, n: float) -> tuple[float, float]:
    """Cos i, cos t for squared impact parameter b2 < R^2; cos t is 0 from the critical angle on."""
    r2 = radius * radius
    inner2 = n * n * r2
    cos_i = math.sqrt((r2 - b2) / r2)
    cos_t = math.sqrt((inner2 - b2) / inner2) if b2 < inner2 else 0.0
    return cos_i, cos_t


@kernel
def through(b2: float, radius: float, n: float, cos_i: float, cos_t: float) -> Turn:
    """Cos delta and q of the turn by 2 (i - t): in, and straight out again."""
    g = (n - 1.0) * (n + 1.0) / (n * n) / (cos_t + cos_i / n)
    chi = b2 / (radius * radius)
    return 1.0 - 2.0 * chi * g * g, 2.0 * g * (cos_i * cos_t + chi / n) / radius


@kernel
def rotate(a: Vector, d: Vector, b2: float, turn: Turn) -> tuple[Vector, Vector]:
    """Foot point and direction after a turn, given by cos delta and q = sin delta / b."""
    cosine, q = turn
    return combine(cosine, a, b2 * q, d), combine(cosine, d, -q, a)


@kernel
def transmittance(cos_i: float, cos_t: float, n: float) -> float:
    """Share of unpolarised light that passes one surface (the same from either side)."""
    s = cos_i + n * cos_t
    p = n * cos_i + cos_t
    return 2.0 * n * cos_i * cos_t * (1.0 / (s * s) + 1.0 / (p * p))


@kernel
def foot_tangent(w: Vector, d: Vector, m: float, v: Vector, e: Vector) -> Vector:
    """Derivative of the foot point when w changes by v and d by e (m from `foot`)."""
    return move(move(v, -add_dot(dot(v, d), w, e), d), m, e)


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
) -> Turn:
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
def rotate_tangent(
    a: Vector, d: Vector, b2: float, turn: Turn, u: Vector, e: Vector, b2_rate: float, rates: Turn
) -> tuple[Vector, Vector]:
    """Derivative of `rotate` when a changes by u, d by e, b^2 and the turn by their rates."""
    (cosine, q), (cosine_rate, q_rate) = turn, rates
    along_rate = b2_rate * q + b2 * q_rate
    foot_rate = move(move(combine(cosine, u, cosine_rate, a), b2 * q, e), along_rate, d)
    return foot_rate, move(move(combine(cosine, e, cosine_rate, d), -q, u), -q_rate, a)
