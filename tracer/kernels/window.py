"""A ray and a window: a plane plate of glass between two media, as wide as any ray reaches.

Row (10,): middle of the face towards the camera, its unit normal towards the camera, thickness [mm], n of the
glass and of what lies behind, both / n of what lies before, radius [mm] of the opening in the opaque wall.
A ray that has come through is in the room behind the window and does not come back: one that meets the wall from
behind, before the investigation plane, is lost.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.refraction import plane_point_rates, refract, refract_rates
from tracer.kernels.sphere import transmittance
from tracer.kernels.vectors import Vector, dot, move, subtract, vector_at
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, RECOVERED, TIR, Crossed

NORMAL, THICKNESS, GLASS, BEHIND, OPENING = 3, 6, 7, 8, 9


@kernel
def is_open(q: Vector, row: Array) -> bool:
    """Return whether a point of a face is in the opening."""
    w = subtract(q, vector_at(row, 0))
    along = dot(w, vector_at(row, NORMAL))
    return bool(dot(w, w) - along * along < row[OPENING] * row[OPENING])


@kernel
def meets_window(p: Vector, d: Vector, row: Array) -> float:
    """Distance to the front face; inf if the ray comes from behind or meets the investigation plane first."""
    normal = vector_at(row, NORMAL)
    slope = dot(d, normal)
    if not slope < 0.0:
        return math.inf
    t = -dot(subtract(p, vector_at(row, 0)), normal) / slope
    return t if t > 0.0 and p[2] + t * d[2] > 0.0 else math.inf


@kernel
def cross_window(p: Vector, d: Vector, row: Array) -> Crossed:
    """Take a ray through both faces, as `Kind.cross`."""
    normal, n = vector_at(row, NORMAL), row[GLASS]
    t = -dot(subtract(p, vector_at(row, 0)), normal) / dot(d, normal)
    q = move(p, t, d)
    if not is_open(q, row):
        return BLOCKED, q, d, t, 0.0
    e, c1, c2 = refract(d, normal, 1.0 / n)
    if c2 == 0.0:
        return TIR, q, e, t, 0.0
    light = transmittance(c1, c2, n)
    s = row[THICKNESS] / c2
    q = move(q, s, e)
    if not q[2] > 0.0:
        return MISSED_PLANE, q, e, t, 0.0
    if not is_open(q, row):
        return BLOCKED, q, e, t, 0.0
    e, c2, c3 = refract(e, normal, n / row[BEHIND])
    if c3 == 0.0:
        return TIR, q, e, t + n * s, 0.0
    return ENTERED, q, e, t + n * s, light * transmittance(c2, c3, row[BEHIND] / n)


@kernel
def leave_window(p: Vector, d: Vector, row: Array) -> Crossed:
    """RECOVERED unless the back of the wall comes first, as `Kind.leave`."""
    normal = vector_at(row, NORMAL)
    slope = dot(d, normal)
    if slope > 0.0:
        above = dot(subtract(p, vector_at(row, 0)), normal) + row[THICKNESS]
        if p[2] - above / slope * d[2] > 0.0:
            return MISSED_PLANE, p, d, 0.0, 0.0
    return RECOVERED, p, d, 0.0, 1.0


@kernel
def window_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind, as `Kind.rates`."""
    start, normal, n, behind = vector_at(row, 0), vector_at(row, NORMAL), row[GLASS], row[BEHIND]
    r, lift = vector_at(rate, NORMAL), dot(normal, vector_at(rate, 0))
    t = -dot(subtract(p, start), normal) / dot(d, normal)
    q = move(p, t, d)
    f = plane_point_rates(d, t, normal, f, u, lift - dot(subtract(q, start), r))
    e, c1, c2 = refract(d, normal, 1.0 / n)
    u = refract_rates(d, normal, 1.0 / n, c1, c2, u, r, -rate[GLASS] / (n * n))
    s = row[THICKNESS] / c2
    # the back face: q' . n = (q0 - thickness n) . n, of which q0 moves with the front face
    lever = dot(subtract(move(q, s, e), start), r)
    f = plane_point_rates(e, s, normal, f, u, lift - lever - rate[THICKNESS])
    _, c2, c3 = refract(e, normal, n / behind)
    e_rate = (rate[GLASS] - n / behind * rate[BEHIND]) / behind
    return f, refract_rates(e, normal, n / behind, c2, c3, u, r, e_rate)
