"""A ray and a dome: a shell of glass between two spheres, with another medium, and bodies or the camera, inside.

Row (14,): centres of the outer and of the inner sphere, their radii [mm], n of the glass and of what fills the
dome, both / n of what is around, and the axis and the cosine of the half angle of the part that is glass: the rest
is its mount, opaque.  The spheres need not be concentric: a wall that is thicker on one side is a wedge.

Ways are those of a tube (``tracer.kernels.tube``): from outside IN, beside the inside THROUGH, totally reflected
by it OFF; from inside OUT.  The investigation plane may cut a dome: what reaches it first ends there, seen if it
is inside, lost (MISSED_PLANE) in the glass.

A point of a surface is taken from the foot point a of the ray on the sphere's centre, q = c + a -+ h d with
h^2 = R^2 - a^2, and its normal is (q - c) / R.  Which surface comes next is known from where the ray is.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.refraction import refract, refract_rates, sphere_point_rates
from tracer.kernels.rooms import IN, OUT, THROUGH
from tracer.kernels.sphere import foot, transmittance
from tracer.kernels.vectors import Vector, add, divide, dot, move, scale, subtract, vector_at
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, OFF_INSIDE, RECOVERED, TIR, Crossed

OUTER_AT, INNER_AT, OUTER, INNER, WALL, FILLED, AXIS, OPENING = 0, 3, 6, 7, 8, 9, 10, 13
NEAR, FAR = -1.0, 1.0


@kernel
def to_shell(p: Vector, d: Vector, row: Array, at: int, side: float) -> tuple[float, Vector, Vector]:
    """Distance to the near or far side of a sphere (OUTER_AT, INNER_AT), the point and outward normal there."""
    centre, radius = vector_at(row, at), row[OUTER if at == OUTER_AT else INNER]
    m, a = foot(subtract(p, centre), d)
    h = side * math.sqrt(max(0.0, radius * radius - dot(a, a)))
    a = move(a, h, d)
    return m + h, add(centre, a), divide(a, radius)


@kernel
def is_mount(q: Vector, row: Array) -> bool:
    """Return whether a point of the shell belongs to the mount."""
    w = subtract(q, vector_at(row, OUTER_AT))
    return bool(dot(w, vector_at(row, AXIS)) < row[OPENING] * math.sqrt(dot(w, w)))


@kernel
def passes_inside(p: Vector, d: Vector, row: Array) -> bool:
    """Return whether a ray in the glass goes on a line through the inner sphere."""
    _, a = foot(subtract(p, vector_at(row, INNER_AT)), d)
    return bool(dot(a, a) < row[INNER] * row[INNER])


@kernel
def meets_dome(p: Vector, d: Vector, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not, or meets the investigation plane first."""
    m, a = foot(subtract(p, vector_at(row, OUTER_AT)), d)
    h2 = row[OUTER] * row[OUTER] - dot(a, a)
    if not h2 > 0.0:
        return math.inf
    t = m - math.sqrt(h2)
    return t if t > 0.0 and p[2] + t * d[2] > 0.0 else math.inf


@kernel
def leave_glass(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from the glass out through the outer sphere: as `Kind.cross`, light of this surface alone."""
    n = row[WALL]
    t, q, normal = to_shell(p, d, row, OUTER_AT, FAR)
    if not q[2] > 0.0:
        return MISSED_PLANE, p, d, 0.0, 0.0
    if is_mount(q, row):
        return BLOCKED, q, d, n * t, 0.0
    e, c1, c2 = refract(d, scale(-1.0, normal), n)
    if c2 == 0.0:
        return TIR, q, e, n * t, 0.0
    return RECOVERED, q, e, n * t, transmittance(c1, c2, 1.0 / n)


@kernel
def cross_dome(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from outside into the dome, or through its glass alone, as `Kind.cross`."""
    n, filled = row[WALL], row[FILLED]
    t, q, normal = to_shell(p, d, row, OUTER_AT, NEAR)
    if is_mount(q, row):
        return BLOCKED, q, d, t, 0.0
    e, c1, c2 = refract(d, normal, 1.0 / n)
    if c2 == 0.0:
        return TIR, q, e, t, 0.0
    surface = transmittance(c1, c2, n)
    path, fate = t, RECOVERED
    if passes_inside(q, e, row):
        t, q, normal = to_shell(q, e, row, INNER_AT, NEAR)
        path += n * t
        if not q[2] > 0.0:
            return MISSED_PLANE, q, e, path, 0.0
        if is_mount(q, row):
            return BLOCKED, q, e, path, 0.0
        e, c1, c2 = refract(e, normal, n / filled)
        if c2 > 0.0:
            return ENTERED, q, e, path, surface * transmittance(c1, c2, filled / n)
        fate = OFF_INSIDE
    lost, q, e, more, out = leave_glass(q, e, row)
    return lost if lost != RECOVERED else fate, q, e, path + more, surface * out


@kernel
def leave_dome(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from inside out of the dome, as `Kind.leave`; paths are / n of what is around."""
    n, filled = row[WALL], row[FILLED]
    t, q, normal = to_shell(p, d, row, INNER_AT, FAR)
    if not q[2] > 0.0:
        return RECOVERED, p, d, 0.0, 1.0
    path = filled * t
    if is_mount(q, row):
        return BLOCKED, q, d, path, 0.0
    e, c1, c2 = refract(d, scale(-1.0, normal), filled / n)
    if c2 == 0.0:
        return TIR, q, e, path, 0.0
    light = transmittance(c1, c2, n / filled)
    lost, q, e, more, out = leave_glass(q, e, row)
    return ENTERED if lost == RECOVERED else lost, q, e, path + more, light * out


@kernel
def shell_rates(
    ray: tuple[Vector, Vector], f: Vector, u: Vector, row: Array, rate: Array, at: int, side: float,
    bend: tuple[float, float],
) -> tuple[Vector, Vector, Vector, Vector]:  # fmt: skip
    """Point and direction behind one sphere, on its near or far side, and their derivatives.

    `ray` is start and direction, `bend` the ratio of indices and its rate.
    """
    (p, d), (ratio, ratio_rate), radius = ray, bend, OUTER if at == OUTER_AT else INNER
    t, q, normal = to_shell(p, d, row, at, side)
    f, r = sphere_point_rates(d, t, normal, row[radius], f, u, vector_at(rate, at), rate[radius])
    normal, r = scale(-side, normal), scale(-side, r)
    e, c1, c2 = refract(d, normal, ratio)
    return q, e, f, refract_rates(d, normal, ratio, c1, c2, u, r, ratio_rate)


@kernel
def dome_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind, on the way that the ray took, as `Kind.rates`."""
    n, filled, n_rate, filled_rate = row[WALL], row[FILLED], rate[WALL], rate[FILLED]
    if way == OUT:
        bend = filled / n, (filled_rate - filled / n * n_rate) / n
        p, d, f, u = shell_rates((p, d), f, u, row, rate, INNER_AT, FAR, bend)
    else:
        p, d, f, u = shell_rates((p, d), f, u, row, rate, OUTER_AT, NEAR, (1.0 / n, -n_rate / (n * n)))
        if way != THROUGH:
            bend = n / filled, (n_rate - n / filled * filled_rate) / filled
            p, d, f, u = shell_rates((p, d), f, u, row, rate, INNER_AT, NEAR, bend)
            if way == IN:
                return f, u
    _, _, f, u = shell_rates((p, d), f, u, row, rate, OUTER_AT, FAR, (n, n_rate))
    return f, u
