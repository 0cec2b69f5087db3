"""What became of a ray."""

from enum import IntEnum


class RayStatus(IntEnum):
    """Fate of a ray; coordinates are NaN unless it is RECOVERED."""

    RECOVERED = 0  # reached the investigation plane
    BLOCKED = 1  # stopped by an opaque body
    TIR = 2  # totally reflected at a body of lower index
    MISSED_PLANE = 3  # left the bodies level or away from the plane
    TOO_MANY_EVENTS = 4  # met more bodies than tracer.kernels.walk.MAX_EVENTS
