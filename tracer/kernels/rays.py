"""Rays one by one to the investigation plane: where each lands, with its light or with derivatives by the pixel.

From body to body a ray goes by `trace_ray`, without any epsilon.  Bodies are convex and disjoint (contact at
most).  Three facts replace every tolerance:

* A ray that has left a body cannot meet it again on the same straight line, so the body just left is
  excluded by number, not by a minimum distance.  Any distance sends some rays near a contact astray.
* The chords that disjoint convex bodies cut from a line are disjoint, so their order is the order of any
  points inside them: foot points decide which body comes first; no entry point is computed.
  A ray that leaves a sphere is taken from its foot point in that sphere, which lies before every later chord.
* Bodies that lie in front of the plane are all met before it.  The plane is asked last, by the caller, and only
  whether the ray goes down; a sphere that touches the plane needs no special care.  Spheres that reach through it
  are asked on which side they are entered and left (``tracer.kernels.crossed``).

A sphere is chosen by b^2 < R^2 with the foot point at hand, and b^2 is then taken from a foot point corrected
once more (`foot`).  Where that one says b >= R the ray is a tangent to rounding, and PASSES.  At 50 digits a third
of such rays miss, the others bring less than 1e-12 of their light through, and none is totally reflected.

What is kept at each body is chosen by a kernel  record(kept, crossing, world) -> kept  that `trace_ray`
is compiled with, so that there is one loop in the source and one for each recorder in the machine code.  What a
recorder does not ask for is not calculated.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ground.jit import Array, kernel, kernel_composed, kernel_inlined
from tracer.kernels.ball import BENT, BESIDE, cross_shaped, is_shaped, shape_rates
from tracer.kernels.branches import DIRECT, FIRST_OTHER, NOTHING, next_key, other_event
from tracer.kernels.camera import eye_of, pixel_ray, pixel_ray_tangents
from tracer.kernels.crossed import CONTACT_TOL_MM, ends_before, leaves_behind
from tracer.kernels.rooms import IN, OFF, OUT, OUTERMOST, THROUGH
from tracer.kernels.sphere import (
    OPAQUE,
    RADIUS,
    REFRACTIVE_INDEX,
    SOLID,
    Turn,
    angles,
    foot,
    foot_tangent,
    rotate,
    rotate_tangent,
    through,
    through_rates,
    transmittance,
    way_through,
    with_cores,
    with_cores_rates,
)
from tracer.kernels.vectors import Vector, add, dot, subtract, vector_at
from tracer.kernels.world import (
    BLOCKED,
    EDGE,
    ENTERED,
    FATES,
    IN_GLASS,
    MISSED_PLANE,
    OFF_INSIDE,
    RECOVERED,
    TIR,
    TOO_MANY_EVENTS,
    World,
    cross_other,
    leave_other,
    next_body,
    rates_other,
)

MAX_EVENTS = 64  # bodies crossed by one ray; a bed of a thousand spheres stays below 20
PASSED, TURNED, REFLECTED, OTHER, SHAPED = range(5)
Tangents = tuple[Vector, Vector, Vector, Vector, float]  # dp/du, dp/dv, dd/du, dd/dv, transmittance
Light = tuple[float, float, Array]
PlaneRay = tuple[int, Vector, Vector, float, float, int, int]
ORIGIN = (0.0, 0.0, 0.0)


@kernel
def trace_rays(origins: Array, directions: Array, world: World, first: int, last: int, rays: Array) -> None:
    """Trace rays first..last-1 from origins (N, 3) along unit directions (N, 3) into records (trace.RAY)."""
    for i in range(first, last):
        status, q, d, path, passed, key, events = trace_to_plane(
            vector_at(origins[i], 0), vector_at(directions[i], 0), world, world.items[:0]
        )
        good = status == RECOVERED
        rays[i].status = status
        rays[i].x_mm = q[0] if good else math.nan
        rays[i].y_mm = q[1] if good else math.nan
        rays[i].direction[0], rays[i].direction[1], rays[i].direction[2] = d
        rays[i].path_mm = path if good else math.nan
        rays[i].transmittance = passed if good else 0.0
        rays[i].key = key
        rays[i].events = events


@kernel
def trace_trails(origins: Array, directions: Array, world: World, trails: Array) -> None:
    """Record in trails (N, MAX_EVENTS) int32 the events of each ray."""
    for i in range(origins.shape[0]):
        trace_to_plane(vector_at(origins[i], 0), vector_at(directions[i], 0), world, trails[i])


@kernel
def trace_rows(
    camera: Array, world: World, first: int, last: int, point: Array, status: Array, key: Array
) -> None:
    """Trace the pixels of rows first..last-1: plane points (H, W, 2), status and branch key (H, W)."""
    for row in range(first, last):
        for column in range(point.shape[1]):
            d = pixel_ray(float(column), float(row), camera)
            s, q, _, _, _, k, _ = trace_to_plane(eye_of(camera), d, world, world.items[:0])
            good = s == RECOVERED
            point[row, column, 0] = q[0] if good else math.nan
            point[row, column, 1] = q[1] if good else math.nan
            status[row, column] = s
            key[row, column] = k


class Crossing(NamedTuple):
    """A ray at one body.

    Parameters
    ----------
    kind : int
        TURNED by a sphere; PASSED: a tangent by rounding; REFLECTED: totally, its last event; OTHER: no sphere;
        SHAPED: through a ball out of round.
    place, event, body, way : int
        How many bodies came before; event, number and way of this one (``tracer.kernels.branches``).
    w, d : three floats each
        Where the ray comes from, relative to the centre (OTHER: in the world), and its direction.
    m, a, b2 : float, three floats, float
        Distance to the foot point, the foot point relative to the centre, its square.
    cos_i, cos_t, solid : float, float, two floats
        At the surface, and cosine and q of the turn without cores.
    turn : two floats
        Cosine and q of the turn.
    path, light : float
        Optical path / n_ambient to the next straight piece, and share of the light that passes, cores left out.
    more, share : float
        Optical path that the cores add, and the share of the light that they pass.
    """

    kind: int
    place: int
    event: int
    body: int
    way: int
    w: Vector
    d: Vector
    m: float
    a: Vector
    b2: float
    cos_i: float
    cos_t: float
    solid: Turn
    turn: Turn
    path: float
    light: float
    more: float
    share: float


@kernel_composed
def unbent_crossing(
    ids: tuple[int, int, int, int, int], w: Vector, d: Vector, m: float, a: Vector, b2: float, path: float,
    light: float,
) -> Crossing:  # fmt: skip
    """`Crossing` of a ray that no sphere turns; `ids` are kind, place, event, body, way."""
    kind, place, event, body, way = ids
    return Crossing(
        kind, place, event, body, way, w, d, m, a, b2, 0.0, 0.0, (1.0, 0.0), (1.0, 0.0), path, light, 0.0, 1.0
    )


@kernel_composed
def trace_ray(
    p: Vector, d: Vector, world: World, record: Callable[..., Any], kept: Any,  # noqa: ANN401
) -> tuple[Any, ...]:  # fmt: skip
    """Take a ray from p along d through the bodies.

    Returns status (RECOVERED: behind all bodies, wherever it goes, or at the plane), point and direction of the
    last straight piece, key, events, what was kept, and n / n_ambient of the room in which the ray ends.
    """
    key, events, last = DIRECT, 0, NOTHING
    spheres, rooms = world.spheres, world.rooms
    cored = spheres.shape[1] > SOLID
    room, index = OUTERMOST, 1.0
    if len(world.others) > 0 and rooms.home.shape[0] > 0:
        room = rooms.first
        index = rooms.n[room]
    while True:
        body = next_body(p, d, last, room, world)
        if world.is_crossed and body > NOTHING and ends_before(p, d, body, world):
            return RECOVERED, p, d, key, events, kept, index
        if body == NOTHING and (len(world.others) == 0 or room == OUTERMOST):
            return RECOVERED, p, d, key, events, kept, index
        if len(world.others) > 0 and body <= NOTHING:
            # a body that is no sphere; in an inner room NOTHING is its wall, through which the ray leaves
            leaves = body == NOTHING
            if leaves:
                body = rooms.wall[room]
                fate, q, e, path, light = leave_other(p, d, body, world.others)
                if fate == RECOVERED:  # the plane comes first
                    return RECOVERED, p, d, key, events, kept, index
                room = rooms.home[spheres.shape[0] + FIRST_OTHER - body]
                index = rooms.n[room]  # before the path is weighed: `leave` gives it / n of the room outside
            else:
                fate, q, e, path, light = cross_other(p, d, body, world.others)
            fate, faces = fate % FATES, fate // FATES
            if fate in (BLOCKED, MISSED_PLANE, IN_GLASS, EDGE):
                return fate, p, d, key, events, kept, index
            if events == MAX_EVENTS:
                return TOO_MANY_EVENTS, p, d, key, events, kept, index
            way = OUT if leaves else IN if fate == ENTERED else OFF if fate == OFF_INSIDE else THROUGH
            event = other_event(body, way, faces, spheres)
            if way in (THROUGH, OFF) or faces > 0:  # going in and out of a round room is no part of a branch
                key = next_key(key, event)
            ids = OTHER, events, event, body, way
            kept = record(kept, unbent_crossing(ids, p, d, 0.0, ORIGIN, 0.0, path * index, light), world)
            events += 1
            if fate == TIR:
                return TIR, p, d, key, events, kept, index
            p, d, last = q, e, body
            if way == IN:
                room, last = rooms.inside[FIRST_OTHER - body], NOTHING
                index = rooms.n[room]
            continue
        ball = spheres[body]
        if ball[OPAQUE] != 0.0:
            return BLOCKED, p, d, key, events, kept, index
        if events == MAX_EVENTS:
            return TOO_MANY_EVENTS, p, d, key, events, kept, index
        centre, radius, n = vector_at(ball, 0), ball[RADIUS], ball[REFRACTIVE_INDEX]
        w = subtract(p, centre)
        if len(world.shapes) > 0 and is_shaped(world.shapes, body):
            fate, q, e, path, light = cross_shaped(p, d, body, spheres, world.shapes)
            key = next_key(key, body)
            kind = SHAPED if fate == BENT else PASSED if fate == BESIDE else REFLECTED
            ids = kind, events, body, body, 0
            foot_point = subtract(q, centre)
            kept = record(
                kept, unbent_crossing(ids, w, d, -dot(w, d), foot_point, 0.0, path * index, light), world
            )
            events += 1
            if kind == REFLECTED:
                return TIR, p, d, key, events, kept, index
            p, d, last = q, e, body
            if world.is_crossed and kind == SHAPED and q[2] < -CONTACT_TOL_MM:
                return IN_GLASS, p, d, key, events, kept, index
            continue
        m, a = foot(w, d)
        b2 = dot(a, a)
        way = way_through(b2, ball) if cored else 0
        event = body + way * spheres.shape[0]
        key = next_key(key, event)
        total = b2 >= n * n * radius * radius  # b < R is asked first: a tangent passes, whatever n is
        if b2 < radius * radius and not total:
            cos_i, cos_t = angles(b2, radius, n)
            surface = transmittance(cos_i, cos_t, n)
            path = (m + 2.0 * radius * (n * cos_t - cos_i)) * index
            solid = through(b2, radius, n, cos_i, cos_t)
            turn, more, share = solid, 0.0, 1.0
            if way > 0:
                turn, more, share = with_cores(b2, ball, way, solid)
                more *= index
            crossing = Crossing(
                TURNED, events, event, body, way, w, d, m, a, b2, cos_i, cos_t, solid, turn, path,
                surface * surface, more, share,
            )  # fmt: skip
            kept = record(kept, crossing, world)
            a, d = rotate(a, d, b2, turn)
            if world.is_crossed and leaves_behind(a, d, centre[2], radius):
                return IN_GLASS, add(centre, a), d, key, events + 1, kept, index
        else:
            kind = REFLECTED if b2 < radius * radius else PASSED
            ids = kind, events, event, body, way
            kept = record(kept, unbent_crossing(ids, w, d, m, a, b2, m * index, 1.0), world)
            if kind == REFLECTED:
                return TIR, p, d, key, events + 1, kept, index
        events += 1
        p, last = add(centre, a), body


@kernel_composed
def keep_light(kept: Light, crossing: Crossing, world: World) -> Light:
    """Record optical path / n_ambient, transmittance, and as many events as there is room for."""
    path, passed, trail = kept
    if crossing.place < trail.shape[0]:
        trail[crossing.place] = crossing.event
    return path + crossing.path + crossing.more, passed * crossing.light * crossing.share, trail


@kernel_inlined
def trace_to_plane(p: Vector, d: Vector, world: World, trail: Array) -> PlaneRay:
    """Trace one ray from p along d; its first events are kept in ``trail`` (0 to MAX_EVENTS,) int32.

    Returns status, point, direction, optical path / n_ambient, transmittance, key, events.  The point is the plane
    point of a recovered ray, else the foot point of its last straight piece.
    """
    status, p, d, key, events, kept, index = trace_ray(p, d, world, keep_light, (0.0, 1.0, trail))
    path, passed, _ = kept
    if status != RECOVERED:
        return status, p, d, path, 0.0, key, events
    if not d[2] < 0.0:
        return MISSED_PLANE, p, d, path, passed, key, events
    t = -p[2] / d[2]
    return RECOVERED, (p[0] + t * d[0], p[1] + t * d[1], 0.0), d, path + t * index, passed, key, events


@kernel_inlined
def hit_plane_rates(t: float, d: Vector, f: Vector, u: Vector) -> tuple[float, float]:
    """Derivatives of the plane point x, y of a ray p + t d there, when p changes by f and d by u."""
    t_rate = -(f[2] + t * u[2]) / d[2]
    return f[0] + t_rate * d[0] + t * u[0], f[1] + t_rate * d[1] + t * u[1]


@kernel_composed
def keep_tangents(kept: Tangents, c: Crossing, world: World) -> Tangents:
    """Record the derivatives (f, g) of the foot point and (u, v) of the direction, and the transmittance.

    They go through the same turns as the ray itself.
    """
    f, g, u, v, passed = kept
    f, u = carry_tangent(f, u, c, world)
    g, v = carry_tangent(g, v, c, world)
    return f, g, u, v, passed * c.light * c.share


@kernel_composed
def carry_tangent(f: Vector, u: Vector, c: Crossing, world: World) -> tuple[Vector, Vector]:
    """Derivatives of point and direction behind a crossing, when they change by f and u before it."""
    if len(world.others) > 0 and c.kind == OTHER:
        return rates_other(c.w, c.d, f, u, c.body, world.others, world.still, c.way)
    ball = world.spheres[c.body]
    if len(world.shapes) > 0 and c.kind == SHAPED:
        return shape_rates(add(c.w, vector_at(ball, 0)), c.d, f, u, c.body, world.spheres, world.shapes)
    f = foot_tangent(c.w, c.d, c.m, f, u)
    if c.kind != TURNED:
        return f, u
    b2_rate = 2.0 * dot(c.a, f)
    rates = through_rates(c.b2, ball[RADIUS], ball[REFRACTIVE_INDEX], c.cos_i, c.cos_t, b2_rate, 0.0, 0.0)
    if c.way > 0:
        rates = with_cores_rates(c.b2, ball, c.way, c.solid, rates, b2_rate, 0.0)
    return rotate_tangent(c.a, c.d, c.b2, c.turn, f, u, b2_rate, rates)


@kernel
def trace_pixel_tangents(u: float, v: float, camera: Array, world: World) -> tuple[float, ...]:
    """Trace the ray of acquired pixel (u, v) with its derivatives by u and v.

    Returns status, x, y, dx/du, dx/dv, dy/du, dy/dv, transmittance, key, events.
    """
    d, by_u, by_v = pixel_ray_tangents(u, v, camera)
    begin = (ORIGIN, ORIGIN, by_u, by_v, 1.0)
    status, p, d, key, events, kept, _ = trace_ray(eye_of(camera), d, world, keep_tangents, begin)
    if status == RECOVERED and not d[2] < 0.0:
        status = MISSED_PLANE
    if status != RECOVERED:
        nan = math.nan
        return status, nan, nan, nan, nan, nan, nan, 0.0, key, events
    f, g, by_u, by_v, passed = kept
    t = -p[2] / d[2]
    xu, yu = hit_plane_rates(t, d, f, by_u)
    xv, yv = hit_plane_rates(t, d, g, by_v)
    return RECOVERED, p[0] + t * d[0], p[1] + t * d[1], xu, xv, yu, yv, passed, key, events
