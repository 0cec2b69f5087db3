"""Branches as kernels write them: events, keys, trips and numbers; for their meaning see the strategies.

event    one body crossed, on one way: sphere + way * (number of spheres), which is the number of the sphere itself
         on way 0; other bodies follow all ways through all spheres, with four ways each
         (``tracer.kernels.rooms``), and FACE_EVENTS times the faces crossed, of a body with flat faces. Going in
         and out of a room is an event like any other for those who follow a ray back, but no part of a branch
         where there are no faces: every ray behind a window has come through it
key      43-bit hash of a sequence of events, DIRECT for none: of any length, made event by event
trip     the sequence itself where it is short and its bodies few (``tracer.kernels.chain``): their numbers + 1,
         BITS each, the latest lowest
number   of a trip whose bodies come in order: bit k for body k
"""

from ground.jit import Array, kernel
from tracer.kernels.rooms import WAYS
from tracer.kernels.sphere import CENTRE_Z, SOLID

NOTHING, FIRST_OTHER = -1, -2  # bodies: a sphere's number, nothing, or another body's, downwards
DIRECT = 1  # branch key of the direct view
KEY_MASK = (1 << 43) - 1  # with the factor below the product stays inside 63 bits
BITS, ALL_BITS = 4, 15
MOST_EVENTS = 15  # what 60 bits of a trip hold; longer ones are left to `trace_ray`
FACE_EVENTS = 1 << 14  # more than bodies have ways; five faces of eight fit into 31 bits then
UNKNOWN = 1 << 15  # branch number of a ray that met spheres in another order: `trace_ray` names it


@kernel
def next_key(key: int, event: int) -> int:
    """Branch key after an event."""
    return (key * 1000003 + event + 2) & KEY_MASK


@kernel
def other_event(body: int, way: int, faces: int, spheres: Array) -> int:
    """Event of crossing a body that is no sphere."""
    before = spheres.shape[0] * (spheres.shape[1] - SOLID + 1)
    return int(before + WAYS * (FIRST_OTHER - body) + way + FACE_EVENTS * faces)


@kernel
def body_of(event: int, spheres: Array) -> tuple[int, int]:
    """Body of an event, and the way through it."""
    other = event - spheres.shape[0] * (spheres.shape[1] - SOLID + 1)
    if other >= 0:
        other %= FACE_EVENTS
        return FIRST_OTHER - other // WAYS, other % WAYS
    return event % spheres.shape[0], event // spheres.shape[0]


@kernel
def branch_number(trip: int, paired: bool, balls: Array) -> int:
    """Number of a trip, bit k for body k, if its bodies come in order; else UNKNOWN.

    `paired`: two of the same height have no order, because the mirror image would have the other.
    """
    if trip < 0:
        return UNKNOWN
    number, later = 0, ALL_BITS + 1
    while trip > 0:
        body = trip & ALL_BITS
        if body >= later or (paired and number and balls[body - 1, CENTRE_Z] == balls[later - 1, CENTRE_Z]):
            return UNKNOWN
        number |= 1 << (body - 1)
        later = body
        trip >>= BITS
    return number
