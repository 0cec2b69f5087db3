"""A ray and a sphere with spheres in it: hollow balls, shells, anything concentric.

Everything is symmetric about one centre, so n r sin(angle to the radius) is the same all along the ray
(Bouguer): it is b, the impact parameter outside, and it turns in one plane.  At core k, of radius r, with
index n' outside of it and n inside,

    sin i = b / (n' r),     sin t = b / (n r),     turn 2 (i - t) on the way in and out,

which is a solid sphere of OPTICAL RADIUS  rho = n' r  and relative index  nu = n / n'  about the same centre.
So nothing new is calculated: each core is one more sphere in the form of ``tracer.kernels.sphere``, with the
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

from ground.jit import Array, kernel
from tracer.kernels.sphere import INDEX, RADIUS, SOLID, angles, through, through_rates, transmittance


@kernel
def way_through(b2: float, sphere: Array) -> int:
    """Way of a ray of squared impact parameter b2 through a sphere (a row of the table)."""
    way = 0
    if b2 < sphere[RADIUS] * sphere[RADIUS]:
        outside = sphere[INDEX]
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
) -> tuple[float, ...]:
    """Derivatives of `core_turn`'s cos and q for given rates of b^2, rho and nu."""
    cos_i, cos_t = angles(b2, rho, nu)
    if reflected:
        chi_rate = (b2_rate - 2.0 * b2 * rho_rate / rho) / (rho * rho)
        return 2.0 * chi_rate, (chi_rate / cos_i + 2.0 * cos_i * rho_rate / rho) / rho
    return through_rates(b2, rho, nu, cos_i, cos_t, b2_rate, rho_rate, nu_rate)


@kernel
def with_cores(b2: float, sphere: Array, way: int, cosine: float, q: float) -> tuple[float, ...]:
    """Add the turns of the cores to a solid sphere's: cos, q, optical path added, share of light that passes."""
    path, passed, outside = 0.0, 1.0, sphere[INDEX]
    cores = (way + 1) // 2
    for k in range(cores):
        radius, inside = sphere[SOLID + 2 * k], sphere[SOLID + 2 * k + 1]
        c, s, more, share = core_turn(b2, outside * radius, inside / outside, way == 2 * k + 2)
        cosine, q = cosine * c - b2 * q * s, cosine * s + q * c
        path += more
        passed *= share
        outside = inside
    return cosine, q, path, passed


@kernel
def with_cores_rates(
    b2: float,
    sphere: Array,
    way: int,
    cosine: float,
    q: float,
    cosine_rate: float,
    q_rate: float,
    b2_rate: float,
    n_rate: float,
) -> tuple[float, float]:
    """Derivatives of `with_cores`'s cos and q, from those of the solid sphere and the rates of b^2 and its n."""
    outside = sphere[INDEX]
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
