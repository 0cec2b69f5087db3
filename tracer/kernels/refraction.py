"""A single surface: intersection, refraction, and the derivatives of both.

Spheres need nothing of this (``tracer.kernels.sphere``).  Windows and tubes, which have another medium on each
side, are made of single surfaces.  With the unit normal N against the ray, the ratio e = n before / n behind and
the cosines c1 = -N . d before and c2 = sqrt(1 - e^2 (1 - c1^2)) behind,

    d' = e d + k N,     k = e c1 - c2 = (e^2 - 1) / (e c1 + c2).

The second form of k has no cancellation at e = 1, where the surface bends by exactly nothing.  The light is
reflected totally where the square under the root is not positive; nothing else decides it.

A cylinder of radius R about the axis s + l k is met at m -+ h by a line p + t d: across the axis, with
e = d - (d . k) k, the foot point a = w + m e, m = -(w . e) / e^2, lies b = |a| from the axis, and
h^2 = (R^2 - b^2) / e^2.

Derivatives follow from the surface itself.  If p changes by f, d by u and the surface by its own rates, the point
q = p + t d changes by f + t u + t' d, and N . q' = (how fast the surface moves along N) gives t'.
"""

import math

from ground.jit import kernel
from tracer.kernels.vectors import Vector, add_dot, combine, divide, dot, move, subtract

Cylinder = tuple[Vector, Vector, float]  # start of the axis, its unit direction, radius [mm]


@kernel
def refract(d: Vector, n: Vector, e: float) -> tuple[Vector, float, float]:
    """Return the direction behind a surface of normal n against the ray, c1 and c2; c2 = 0: total reflection."""
    c1 = -dot(n, d)
    square = 1.0 - e * e * (1.0 - c1 * c1)
    if not square > 0.0:
        return move(d, 2.0 * c1, n), c1, 0.0
    c2 = math.sqrt(square)
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    return combine(e, d, k, n), c1, c2


@kernel
def refract_rates(
    d: Vector, n: Vector, e: float, c1: float, c2: float, u: Vector, r: Vector, e_rate: float
) -> Vector:
    """Derivative of the direction of `refract` when d changes by u, the normal by r and e by its rate."""
    c1_rate = -add_dot(dot(r, d), n, u)
    if c2 == 0.0:
        return move(u, 2.0, combine(c1_rate, n, c1, r))
    c2_rate = (e * e * c1 * c1_rate - e * e_rate * (1.0 - c1 * c1)) / c2
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    k_rate = e_rate * c1 + e * c1_rate - c2_rate
    return move(move(combine(e_rate, d, e, u), k_rate, n), k, r)


@kernel
def nearest_to_axis(p: Vector, d: Vector, s: Vector, k: Vector) -> tuple[float, float, float, float]:
    """Distance m to the point nearest an axis, its square distance b^2, e^2 and where along the axis it lies."""
    w = subtract(p, s)
    along, slope = dot(w, k), dot(d, k)
    w, e = move(w, -along, k), move(d, -slope, k)
    e2 = dot(e, e)
    if e2 == 0.0:
        return 0.0, dot(w, w), 0.0, along
    m = -dot(w, e) / e2
    a = move(w, m, e)
    # Once more: from far away the first subtraction leaves a part along e of the size of its rounding.
    more = -dot(a, e) / e2
    a = move(a, more, e)
    return m + more, dot(a, a), e2, along + (m + more) * slope


@kernel
def cylinder_normal(q: Vector, s: Vector, k: Vector, radius: float) -> Vector:
    """Outward unit normal of a cylinder at its point q."""
    w = subtract(q, s)
    return divide(move(w, -dot(w, k), k), radius)


@kernel
def plane_point_rates(d: Vector, t: float, n: Vector, f: Vector, u: Vector, shift: float) -> Vector:
    """Derivative of q = p + t d on a plane of normal n that moves by `shift` along n there."""
    f = move(f, t, u)
    return move(f, (shift - dot(n, f)) / dot(n, d), d)


@kernel
def cylinder_point_rates(
    q: Vector, d: Vector, t: float, n: Vector, cylinder: Cylinder, f: Vector, u: Vector, rates: Cylinder
) -> tuple[Vector, Vector]:
    """Derivatives of q = p + t d on a cylinder and of its outward normal n there.

    p changes by f, d by u, and the cylinder by its `rates`.
    """
    (s, k, radius), (s_rate, k_rate, radius_rate) = cylinder, rates
    w = subtract(q, s)
    along = dot(w, k)
    g = plane_point_rates(d, t, n, f, u, add_dot(radius_rate, n, move(s_rate, along, k_rate)))
    r = subtract(g, s_rate)
    r_along = dot(r, k) + dot(w, k_rate)  # the point moves along an axis that turns itself
    r = move(move(r, -r_along, k), -along, k_rate)
    return g, divide(move(r, -radius_rate, n), radius)


@kernel
def sphere_point_rates(
    d: Vector, t: float, n: Vector, radius: float, f: Vector, u: Vector, c_rate: Vector, radius_rate: float
) -> tuple[Vector, Vector]:
    """Derivatives of q = p + t d on a sphere and of its outward normal n there; its centre changes by `c_rate`."""
    g = plane_point_rates(d, t, n, f, u, add_dot(radius_rate, n, c_rate))
    return g, divide(move(subtract(g, c_rate), -radius_rate, n), radius)
