"""One ray from body to body, without any epsilon: the walk of every scalar tracer, which takes what it records.

Bodies are convex and disjoint (contact at most).  Three facts replace every tolerance:

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

from collections.abc import Callable
from typing import Any, NamedTuple

from ground.jit import Array, kernel_composed
from tracer.kernels.ball import BENT, BESIDE
from tracer.kernels.branches import DIRECT, FIRST_OTHER, NOTHING, next_key, other_event
from tracer.kernels.rooms import IN, OFF, OUT, OUTERMOST, THROUGH
from tracer.kernels.shaped import cross_shaped, is_shaped
from tracer.kernels.shell import way_through, with_cores
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
    through,
    transmittance,
    turned,
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
)

MAX_EVENTS = 64  # bodies crossed by one ray; a bed of a thousand spheres stays below 20
PASSED, TURNED, REFLECTED, OTHER, SHAPED = range(5)


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
