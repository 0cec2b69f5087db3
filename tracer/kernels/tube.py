"""A ray and a tube: a cylindrical wall of glass with another medium, and bodies, inside.

Row (11,): where the axis begins, its unit direction, length, outer and inner radius [mm], n of the wall and of
what fills the tube, both / n of what is around.  The ends are open.  Through them a ray comes and goes unbent
where inside and outside are of one medium; the surface of a liquid there has no shape that a file states, so such
a ray is lost, as is one that leaves the wall through its end faces.

From outside a ray goes   in          through the wall into the tube (or its open end), on way IN
                          beside      through the wall alone, on way 0
                          off         through the wall, totally reflected by the inside, on way OFF
and from inside           out         on way OUT.

The investigation plane may cut a tube.  What reaches it first ends there: seen in the tube if it is inside, lost
(MISSED_PLANE) in the wall, where nothing flows.  Each surface is a cylinder of ``tracer.kernels.refraction``; the
one that comes next is known from where the ray is, so no root is chosen by a tolerance.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.refraction import (
    Cylinder,
    cylinder_normal,
    cylinder_point_rates,
    nearest_to_axis,
    plane_point_rates,
    refract,
    refract_rates,
)
from tracer.kernels.rooms import IN, OUT, THROUGH
from tracer.kernels.sphere import transmittance
from tracer.kernels.vectors import Vector, dot, move, scale, subtract, vector_at
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, OFF_INSIDE, RECOVERED, TIR, Crossed

START, AXIS, LENGTH, OUTER, INNER, WALL, FILLED = 0, 3, 6, 7, 8, 9, 10


@kernel_inlined
def cylinder_at(row: Array, which: int) -> Cylinder:
    """Axis and radius of one surface of a tube, OUTER or INNER, or the rates of these."""
    return vector_at(row, START), vector_at(row, AXIS), row[which]


@kernel
def find_ends(p: Vector, d: Vector, row: Array) -> tuple[float, float, bool]:
    """Distances at which a line enters and leaves the closed tube, and whether it enters by the round side."""
    axis, radius = vector_at(row, AXIS), row[OUTER]
    m, b2, e2, at = nearest_to_axis(p, d, vector_at(row, START), axis)
    if not b2 < radius * radius:
        return math.inf, -math.inf, True
    near, far = -math.inf, math.inf
    if e2 > 0.0:
        h = math.sqrt((radius * radius - b2) / e2)
        near, far = m - h, m + h
    slope = dot(d, axis)
    if slope == 0.0:
        return (near, far, True) if 0.0 < at < row[LENGTH] else (math.inf, -math.inf, True)
    one, two = m - at / slope, m + (row[LENGTH] - at) / slope
    first, last = min(one, two), max(one, two)
    return max(near, first), min(far, last), near >= first


@kernel
def meets_tube(p: Vector, d: Vector, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not, or meets the investigation plane first."""
    first, last, _ = find_ends(p, d, row)
    return first if 0.0 < first < last and p[2] + first * d[2] > 0.0 else math.inf


@kernel
def to_ends(p: Vector, d: Vector, row: Array) -> float:
    """Distance to where a ray from between the planes of the two ends passes one of them."""
    axis = vector_at(row, AXIS)
    along, slope = dot(subtract(p, vector_at(row, START)), axis), dot(d, axis)
    if slope == 0.0:
        return math.inf
    return float(max(-along / slope, (row[LENGTH] - along) / slope))


@kernel
def fate_in_wall(p: Vector, d: Vector, t: float, row: Array) -> int:
    """Status of a ray in the wall before it has gone the distance t: RECOVERED if nothing stops it."""
    end = to_ends(p, d, row)
    plane = -p[2] / d[2] if d[2] < 0.0 else math.inf
    if t < min(end, plane):
        return RECOVERED
    return BLOCKED if end < plane else MISSED_PLANE


@kernel
def to_round_side(p: Vector, d: Vector, row: Array, which: int, side: float) -> float:
    """Distance to where a ray meets one surface of a tube, on the near (-1) or far (1) side."""
    m, b2, e2, _ = nearest_to_axis(p, d, vector_at(row, START), vector_at(row, AXIS))
    return m + side * math.sqrt(max(0.0, row[which] * row[which] - b2) / e2)


@kernel
def leave_wall(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from the wall out through its round side: as `Kind.cross`, light of this surface alone.

    Through the side by which it came it leaves at the same angle: reflected by rounding only, at a tangent.
    """
    n = row[WALL]
    t = to_round_side(p, d, row, OUTER, 1.0)
    fate = fate_in_wall(p, d, t, row)
    if fate != RECOVERED:
        return fate, p, d, 0.0, 0.0
    q = move(p, t, d)
    e, c1, c2 = refract(d, cylinder_normal(q, vector_at(row, START), vector_at(row, AXIS), -row[OUTER]), n)
    if c2 == 0.0:
        return TIR, q, e, n * t, 0.0
    return RECOVERED, q, e, n * t, transmittance(c1, c2, 1.0 / n)


@kernel
def cross_tube(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from outside into the tube, or through its wall alone, as `Kind.cross`."""
    start, axis, n, filled = vector_at(row, START), vector_at(row, AXIS), row[WALL], row[FILLED]
    t, _, by_side = find_ends(p, d, row)
    q = move(p, t, d)
    if not by_side:
        _, b2, _, _ = nearest_to_axis(q, axis, start, axis)
        open_end = b2 < row[INNER] * row[INNER] and filled == 1.0
        return ENTERED if open_end else BLOCKED, q, d, t, 1.0
    e, c1, c2 = refract(d, cylinder_normal(q, start, axis, row[OUTER]), 1.0 / n)
    if c2 == 0.0:
        return TIR, q, e, t, 0.0
    surface = transmittance(c1, c2, n)
    path, fate, light = t, RECOVERED, surface * surface
    m, b2, e2, _ = nearest_to_axis(q, e, start, axis)
    if b2 < row[INNER] * row[INNER]:
        t = m - math.sqrt((row[INNER] * row[INNER] - b2) / e2)
        lost = fate_in_wall(q, e, t, row)
        if lost != RECOVERED:
            return lost, q, e, path, 0.0
        q, path = move(q, t, e), path + n * t
        e, c1, c2 = refract(e, cylinder_normal(q, start, axis, row[INNER]), n / filled)
        if c2 > 0.0:
            return ENTERED, q, e, path, surface * transmittance(c1, c2, filled / n)
        fate = OFF_INSIDE
    lost, q, e, more, _ = leave_wall(q, e, row)
    return lost if lost != RECOVERED else fate, q, e, path + more, light


@kernel
def leave_tube(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray from inside out of the tube, as `Kind.leave`; paths are / n of what is around."""
    start, axis, n, filled = vector_at(row, START), vector_at(row, AXIS), row[WALL], row[FILLED]
    m, b2, e2, _ = nearest_to_axis(p, d, start, axis)
    t = m + math.sqrt(max(0.0, row[INNER] * row[INNER] - b2) / e2) if e2 > 0.0 else math.inf
    end = to_ends(p, d, row)
    s = min(t, end)
    q, path = move(p, s, d), filled * s
    if not q[2] > 0.0:
        return RECOVERED, p, d, 0.0, 1.0
    if end < t:
        return ENTERED if filled == 1.0 else BLOCKED, q, d, path, 1.0
    e, c1, c2 = refract(d, cylinder_normal(q, start, axis, -row[INNER]), filled / n)
    if c2 == 0.0:
        return TIR, q, e, path, 0.0
    light = transmittance(c1, c2, n / filled)
    lost, q, e, more, surface = leave_wall(q, e, row)
    return ENTERED if lost == RECOVERED else lost, q, e, path + more, light * surface


@kernel
def surface_rates(
    ray: tuple[Vector, Vector, float], f: Vector, u: Vector, row: Array, rate: Array, which: int, side: float,
    bend: tuple[float, float],
) -> tuple[Vector, Vector, Vector, Vector]:  # fmt: skip
    """Point and direction behind one surface of a tube, OUTER or INNER, and their derivatives.

    `ray` is start, direction and distance to the surface, `bend` the ratio of indices and its rate; `side` is 1
    where the outward normal looks against the ray, else -1.
    """
    (p, d, t), (ratio, ratio_rate), cylinder = ray, bend, cylinder_at(row, which)
    q = move(p, t, d)
    normal = cylinder_normal(q, cylinder[0], cylinder[1], cylinder[2])
    f, r = cylinder_point_rates(q, d, t, normal, cylinder, f, u, cylinder_at(rate, which))
    normal, r = scale(side, normal), scale(side, r)
    e, c1, c2 = refract(d, normal, ratio)
    return q, e, f, refract_rates(d, normal, ratio, c1, c2, u, r, ratio_rate)


@kernel
def tube_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind, on the way that the ray took, as `Kind.rates`."""
    n, filled, n_rate = row[WALL], row[FILLED], rate[WALL]
    if way == OUT:
        t = to_round_side(p, d, row, INNER, 1.0)
        if to_ends(p, d, row) < t:  # through the open end
            return end_rates(p, d, f, u, row), u
        bend = filled / n, (rate[FILLED] - filled / n * n_rate) / n
        p, d, f, u = surface_rates((p, d, t), f, u, row, rate, INNER, -1.0, bend)
    else:
        t, _, by_side = find_ends(p, d, row)
        if not by_side:
            return end_rates(p, d, f, u, row), u
        p, d, f, u = surface_rates((p, d, t), f, u, row, rate, OUTER, 1.0, (1.0 / n, -n_rate / (n * n)))
        if way != THROUGH:
            t = to_round_side(p, d, row, INNER, -1.0)
            bend = n / filled, (n_rate - n / filled * rate[FILLED]) / filled
            p, d, f, u = surface_rates((p, d, t), f, u, row, rate, INNER, 1.0, bend)
            if way == IN:
                return f, u
    t = to_round_side(p, d, row, OUTER, 1.0)
    _, _, f, u = surface_rates((p, d, t), f, u, row, rate, OUTER, -1.0, (n, n_rate))
    return f, u


@kernel
def end_rates(p: Vector, d: Vector, f: Vector, u: Vector, row: Array) -> Vector:
    """Derivative of the point in an open end, where nothing is bent."""
    axis = vector_at(row, AXIS)
    along, slope = dot(subtract(p, vector_at(row, START)), axis), dot(d, axis)
    low = along < 0.0 or (slope < 0.0 and not along > row[LENGTH])
    t = ((0.0 if low else row[LENGTH]) - along) / slope
    return plane_point_rates(d, t, axis, f, u, 0.0)
