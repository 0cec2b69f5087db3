"""Rays one by one to the investigation plane: where each lands, with its light or with derivatives by the pixel.

From body to body a ray goes by `walk`, without any epsilon.  Bodies are convex and disjoint (contact at most).
Three facts replace every tolerance:

* A ray that has left a body cannot meet it again on the same straight line, so the body just left is
  excluded by number, not by a minimum distance.  Any distance sends some rays near a contact astray.
* The chords that disjoint convex bodies cut from a line are disjoint, so their order is the order of any
  points inside them: foot points decide which body comes first; no entry point is computed.
  A ray that leaves a sphere is taken from its foot point in that sphere, which lies before every later chord.
* All bodies lie in front of the plane, so every hit comes before the plane.  The plane is asked last, by the
  caller, and only whether the ray goes down; a sphere that touches the plane needs no special care.

A sphere is chosen by b^2 < R^2 with the foot point at hand, and b^2 is then taken from a foot point corrected
once more (`foot`).  Where that one says b >= R the ray is a tangent to rounding, and PASSES.  At 50 digits a third
of such rays miss, the others bring less than 1e-12 of their light through, and none is totally reflected.

What is kept at each body is the recorder's affair: a kernel  record(kept, crossing, world) -> kept  that the walk
is compiled with, so that there is one walk in the source and one loop of its own for each recorder in the machine
code. What a recorder does not ask for is not calculated.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from ground.jit import Array, kernel, kernel_composed, kernel_inlined
from tracer.kernels.ball import BENT, BESIDE, cross_shaped, is_shaped, shaped_rates
from tracer.kernels.branches import DIRECT, FIRST_OTHER, NOTHING, next_key, other_event
from tracer.kernels.camera import EYE_X, EYE_Y, EYE_Z, pixel_ray, pixel_ray_tangents
from tracer.kernels.rooms import IN, OFF, OUT, OUTERMOST, THROUGH
from tracer.kernels.sphere import (
    CENTRE_X,
    CENTRE_Y,
    CENTRE_Z,
    INDEX,
    OPAQUE,
    RADIUS,
    SOLID,
    angles,
    foot,
    foot_tangent,
    through,
    through_rates,
    transmittance,
    turned,
    turned_tangent,
    way_through,
    with_cores,
    with_cores_rates,
)
from tracer.kernels.world import (
    BLOCKED,
    ENTERED,
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
Tangents = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]


@kernel
def trace_rays(origins: Array, directions: Array, world: World, first: int, last: int, rays: Array) -> None:
    """Trace rays first..last-1 from origins (N, 3) along unit directions (N, 3) into records (trace.RAY)."""
    for i in range(first, last):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        status, x, y, _, dx, dy, dz, path, passed, key, events = march(px, py, pz, dx, dy, dz, world)
        good = status == RECOVERED
        rays[i].status = status
        rays[i].x_mm = x if good else math.nan
        rays[i].y_mm = y if good else math.nan
        rays[i].direction[0], rays[i].direction[1], rays[i].direction[2] = dx, dy, dz
        rays[i].path_mm = path if good else math.nan
        rays[i].transmittance = passed if good else 0.0
        rays[i].key = key
        rays[i].events = events


@kernel
def trace_trails(origins: Array, directions: Array, world: World, trails: Array) -> None:
    """Record in trails (N, MAX_EVENTS) int32 the events of each ray."""
    for i in range(origins.shape[0]):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        walk(px, py, pz, dx, dy, dz, world, keep_trail, trails[i])


@kernel
def trace_rows(
    camera: Array, world: World, first: int, last: int, point: Array, status: Array, key: Array
) -> None:
    """Trace the pixels of rows first..last-1: plane points (H, W, 2), status and branch key (H, W)."""
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    for row in range(first, last):
        for column in range(point.shape[1]):
            dx, dy, dz = pixel_ray(float(column), float(row), camera)
            s, x, y, _, _, _, _, _, _, k, _ = march(ox, oy, oz, dx, dy, dz, world)
            good = s == RECOVERED
            point[row, column, 0] = x if good else math.nan
            point[row, column, 1] = y if good else math.nan
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
    wx, wy, wz, dx, dy, dz : float
        Where the ray comes from, relative to the centre (OTHER: in the world), and its direction.
    m, ax, ay, az, b2 : float
        Distance to the foot point, the foot point relative to the centre, its square.
    cos_i, cos_t, solid, solid_q : float
        At the surface, and cosine and q of the turn without cores.
    cosine, q : float
        The turn.
    path, light : float
        Optical path / n_ambient to the next straight piece, and share of the light that passes, cores left out.
    more, share : float
        What the cores add to the one, and leave of the other.
    """

    kind: int
    place: int
    event: int
    body: int
    way: int
    wx: float
    wy: float
    wz: float
    dx: float
    dy: float
    dz: float
    m: float
    ax: float
    ay: float
    az: float
    b2: float
    cos_i: float
    cos_t: float
    solid: float
    solid_q: float
    cosine: float
    q: float
    path: float
    light: float
    more: float
    share: float


@kernel_composed
def walk(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    world: World, record: Callable[..., Any], kept: Any,  # noqa: ANN401
) -> tuple[Any, ...]:  # fmt: skip
    """Take a ray from p along d through the bodies.

    Returns status (RECOVERED: behind all bodies, wherever it goes), point and direction of the last straight
    piece, key, events, what was kept, and n / n_ambient of the room in which the ray ends.
    """
    key, events, last = DIRECT, 0, NOTHING
    spheres, rooms = world.spheres, world.rooms
    cored = spheres.shape[1] > SOLID
    room, index = OUTERMOST, 1.0
    if len(world.others) > 0 and rooms.home.shape[0] > 0:
        room = rooms.first
        index = rooms.n[room]
    while True:
        body = next_body(px, py, pz, dx, dy, dz, last, room, world)
        if body == NOTHING and (len(world.others) == 0 or room == OUTERMOST):
            return RECOVERED, px, py, pz, dx, dy, dz, key, events, kept, index
        if len(world.others) > 0 and body <= NOTHING:
            leaves = body == NOTHING
            if leaves:
                body = rooms.wall[room]
                fate, qx, qy, qz, ex, ey, ez, path, light = leave_other(px, py, pz, dx, dy, dz, body, world.others)
                if fate == RECOVERED:  # the plane comes first
                    return RECOVERED, px, py, pz, dx, dy, dz, key, events, kept, index
                room = rooms.home[spheres.shape[0] + FIRST_OTHER - body]
                index = rooms.n[room]
            else:
                fate, qx, qy, qz, ex, ey, ez, path, light = cross_other(px, py, pz, dx, dy, dz, body, world.others)
            if fate in (BLOCKED, MISSED_PLANE):
                return fate, px, py, pz, dx, dy, dz, key, events, kept, index
            if events == MAX_EVENTS:
                return TOO_MANY_EVENTS, px, py, pz, dx, dy, dz, key, events, kept, index
            way = OUT if leaves else IN if fate == ENTERED else OFF if fate == OFF_INSIDE else THROUGH
            event = other_event(body, way, spheres)
            if way in (THROUGH, OFF):
                key = next_key(key, event)
            crossing = Crossing(
                OTHER, events, event, body, way, px, py, pz, dx, dy, dz,
                0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, path * index, light, 0.0, 1.0,
            )  # fmt: skip
            kept = record(kept, crossing, world)
            events += 1
            if fate == TIR:
                return TIR, px, py, pz, dx, dy, dz, key, events, kept, index
            px, py, pz, dx, dy, dz = qx, qy, qz, ex, ey, ez
            last = body
            if way == IN:
                room, last = rooms.inside[FIRST_OTHER - body], NOTHING
                index = rooms.n[room]
            continue
        if spheres[body, OPAQUE] != 0.0:
            return BLOCKED, px, py, pz, dx, dy, dz, key, events, kept, index
        if events == MAX_EVENTS:
            return TOO_MANY_EVENTS, px, py, pz, dx, dy, dz, key, events, kept, index
        cx, cy, cz = spheres[body, CENTRE_X], spheres[body, CENTRE_Y], spheres[body, CENTRE_Z]
        radius, n = spheres[body, RADIUS], spheres[body, INDEX]
        wx, wy, wz = px - cx, py - cy, pz - cz
        if len(world.shapes) > 0 and is_shaped(world.shapes, body):
            fate, qx, qy, qz, ex, ey, ez, path, light = cross_shaped(
                px, py, pz, dx, dy, dz, body, spheres, world.shapes
            )
            key = next_key(key, body)
            kind = SHAPED if fate == BENT else PASSED if fate == BESIDE else REFLECTED
            m = -(wx * dx + wy * dy + wz * dz)
            crossing = Crossing(
                kind, events, body, body, 0, wx, wy, wz, dx, dy, dz, m, qx - cx, qy - cy, qz - cz, 0.0,
                0.0, 0.0, 1.0, 0.0, 1.0, 0.0, path * index, light, 0.0, 1.0,
            )  # fmt: skip
            kept = record(kept, crossing, world)
            events += 1
            if kind == REFLECTED:
                return TIR, px, py, pz, dx, dy, dz, key, events, kept, index
            px, py, pz, dx, dy, dz = qx, qy, qz, ex, ey, ez
            last = body
            continue
        m, ax, ay, az = foot(wx, wy, wz, dx, dy, dz)
        b2 = ax * ax + ay * ay + az * az
        way = way_through(b2, spheres[body]) if cored else 0
        event = body + way * spheres.shape[0]
        key = next_key(key, event)
        if not b2 < radius * radius:
            crossing = Crossing(
                PASSED, events, event, body, way, wx, wy, wz, dx, dy, dz, m, ax, ay, az, b2,
                0.0, 0.0, 1.0, 0.0, 1.0, 0.0, m * index, 1.0, 0.0, 1.0,
            )  # fmt: skip
            kept = record(kept, crossing, world)
        elif b2 >= n * n * radius * radius:
            crossing = Crossing(
                REFLECTED, events, event, body, way, wx, wy, wz, dx, dy, dz, m, ax, ay, az, b2,
                0.0, 0.0, 1.0, 0.0, 1.0, 0.0, m * index, 1.0, 0.0, 1.0,
            )  # fmt: skip
            kept = record(kept, crossing, world)
            return TIR, px, py, pz, dx, dy, dz, key, events + 1, kept, index
        else:
            cos_i, cos_t = angles(b2, radius, n)
            surface = transmittance(cos_i, cos_t, n)
            path = (m + 2.0 * radius * (n * cos_t - cos_i)) * index
            solid, solid_q = through(b2, radius, n, cos_i, cos_t)
            cosine, q, more, share = solid, solid_q, 0.0, 1.0
            if way > 0:
                cosine, q, more, share = with_cores(b2, spheres[body], way, solid, solid_q)
                more *= index
            crossing = Crossing(
                TURNED, events, event, body, way, wx, wy, wz, dx, dy, dz, m, ax, ay, az, b2,
                cos_i, cos_t, solid, solid_q, cosine, q, path, surface * surface, more, share,
            )  # fmt: skip
            kept = record(kept, crossing, world)
            ax, ay, az, dx, dy, dz = turned(ax, ay, az, dx, dy, dz, b2, cosine, q)
        events += 1
        px, py, pz = cx + ax, cy + ay, cz + az
        last = body


@kernel_composed
def keep_light(kept: tuple[float, float], crossing: Crossing, world: World) -> tuple[float, float]:
    """Record optical path / n_ambient and transmittance."""
    return kept[0] + crossing.path + crossing.more, kept[1] * crossing.light * crossing.share


@kernel_composed
def keep_trail(kept: Array, crossing: Crossing, world: World) -> Array:
    """Record events in an array (MAX_EVENTS,) int32."""
    kept[crossing.place] = crossing.event
    return kept


@kernel_inlined
def march(px: float, py: float, pz: float, dx: float, dy: float, dz: float, world: World) -> tuple[float, ...]:
    """Trace one ray from p along d.

    Returns status, point x, y, z, direction, optical path / n_ambient, transmittance, key, events.  The point
    is the plane point of a recovered ray, else the foot point of its last straight piece.
    """
    status, px, py, pz, dx, dy, dz, key, events, kept, index = walk(
        px, py, pz, dx, dy, dz, world, keep_light, (0.0, 1.0)
    )
    path, passed = kept
    if status != RECOVERED:
        return status, px, py, pz, dx, dy, dz, path, 0.0, key, events
    if not dz < 0.0:
        return MISSED_PLANE, px, py, pz, dx, dy, dz, path, passed, key, events
    t = -pz / dz
    return RECOVERED, px + t * dx, py + t * dy, 0.0, dx, dy, dz, path + t * index, passed, key, events


@kernel
def land(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    ux: float, uy: float, uz: float, vx: float, vy: float, vz: float,
) -> tuple[float, ...]:  # fmt: skip
    """Plane point x, y of the ray p + t d and dx/du, dx/dv, dy/du, dy/dv, from dp = (f, g), dd = (u, v)."""
    t = -pz / dz
    tu = -(fz + t * uz) / dz
    tv = -(gz + t * vz) / dz
    return (
        px + t * dx,
        py + t * dy,
        fx + tu * dx + t * ux,
        gx + tv * dx + t * vx,
        fy + tu * dy + t * uy,
        gy + tv * dy + t * vy,
    )


@kernel_composed
def keep_tangents(kept: Tangents, c: Crossing, world: World) -> Tangents:
    """Record the derivatives (f, g) of the foot point and (u, v) of the direction, and the transmittance.

    They go through the same turns as the ray itself.
    """
    fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed = kept
    passed = passed * c.light * c.share
    if len(world.others) > 0 and c.kind == OTHER:
        fx, fy, fz, ux, uy, uz = rates_other(
            c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, fx, fy, fz, ux, uy, uz, c.body, world.others, world.still, c.way
        )
        gx, gy, gz, vx, vy, vz = rates_other(
            c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, gx, gy, gz, vx, vy, vz, c.body, world.others, world.still, c.way
        )
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    if len(world.shapes) > 0 and c.kind == SHAPED:
        ball, shapes = world.spheres[c.body], world.shapes
        px, py, pz = c.wx + ball[CENTRE_X], c.wy + ball[CENTRE_Y], c.wz + ball[CENTRE_Z]
        fx, fy, fz, ux, uy, uz = shaped_rates(
            px, py, pz, c.dx, c.dy, c.dz, fx, fy, fz, ux, uy, uz, c.body, world.spheres, shapes
        )
        gx, gy, gz, vx, vy, vz = shaped_rates(
            px, py, pz, c.dx, c.dy, c.dz, gx, gy, gz, vx, vy, vz, c.body, world.spheres, shapes
        )
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    fx, fy, fz = foot_tangent(c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, c.m, fx, fy, fz, ux, uy, uz)
    gx, gy, gz = foot_tangent(c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, c.m, gx, gy, gz, vx, vy, vz)
    if c.kind != TURNED:
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    ball = world.spheres[c.body]
    f_rate, g_rate = 2.0 * (c.ax * fx + c.ay * fy + c.az * fz), 2.0 * (c.ax * gx + c.ay * gy + c.az * gz)
    cosine_f, q_f = through_rates(c.b2, ball[RADIUS], ball[INDEX], c.cos_i, c.cos_t, f_rate, 0.0, 0.0)
    cosine_g, q_g = through_rates(c.b2, ball[RADIUS], ball[INDEX], c.cos_i, c.cos_t, g_rate, 0.0, 0.0)
    if c.way > 0:
        cosine_f, q_f = with_cores_rates(c.b2, ball, c.way, c.solid, c.solid_q, cosine_f, q_f, f_rate, 0.0)
        cosine_g, q_g = with_cores_rates(c.b2, ball, c.way, c.solid, c.solid_q, cosine_g, q_g, g_rate, 0.0)
    fx, fy, fz, ux, uy, uz = turned_tangent(
        c.ax, c.ay, c.az, c.dx, c.dy, c.dz, c.b2, c.cosine, c.q, fx, fy, fz, ux, uy, uz, f_rate, cosine_f, q_f
    )
    gx, gy, gz, vx, vy, vz = turned_tangent(
        c.ax, c.ay, c.az, c.dx, c.dy, c.dz, c.b2, c.cosine, c.q, gx, gy, gz, vx, vy, vz, g_rate, cosine_g, q_g
    )
    return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed


@kernel
def march_pixel_tangents(u: float, v: float, camera: Array, world: World) -> tuple[float, ...]:
    """Trace the ray of acquired pixel (u, v) with its derivatives by u and v.

    Returns status, x, y, dx/du, dx/dv, dy/du, dy/dv, transmittance, key, events.
    """
    dx, dy, dz, ux, uy, uz, vx, vy, vz = pixel_ray_tangents(u, v, camera)
    begin = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ux, uy, uz, vx, vy, vz, 1.0)
    status, px, py, pz, dx, dy, dz, key, events, kept, _ = walk(
        camera[EYE_X], camera[EYE_Y], camera[EYE_Z], dx, dy, dz, world, keep_tangents, begin
    )
    if status == RECOVERED and not dz < 0.0:
        status = MISSED_PLANE
    if status != RECOVERED:
        nan = math.nan
        return status, nan, nan, nan, nan, nan, nan, 0.0, key, events
    fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed = kept
    x, y, xu, xv, yu, yv = land(px, py, pz, dx, dy, dz, fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz)
    return RECOVERED, x, y, xu, xv, yu, yv, passed, key, events
