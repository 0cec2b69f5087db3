"""Media belong to rooms: what is before a window, behind it, in a tube.

A body with two sides (window, tube) parts the world.  A ray stands in one room at a time and meets only what
stands there with it; what has another room inside takes it there (ENTERED).  Where it meets nothing more it
leaves by the wall of its room, unless the investigation plane comes first, or ends if it is in the outermost.

So all that ``tracer.kernels.rays`` says of convex bodies holds room by room: in a room they are disjoint, a room
is convex itself, and its wall comes after everything in it.  Indices of a body are relative to the medium of the
room in which it stands.

Rooms are numbered from 0, the outermost.  All arrays are empty where there is only that one.
"""

from typing import NamedTuple

import numpy as np

from ground.jit import Array

OUTERMOST = 0
THROUGH, IN, OUT, OFF = range(4)  # ways through a body that is no sphere
WAYS = 4


class Rooms(NamedTuple):
    """Rooms of a world of N spheres and M other bodies.

    Parameters
    ----------
    home : (N + M,) int32
        Room in which each body stands, spheres first.
    inside : (M,) int32
        Room inside each other body, -1 for none.
    wall : (R,) int32
        Number of the body around each room, NOTHING for the outermost.
    n : (R,) float64
        n / n_ambient of the medium in each room.
    first : int
        Room of the camera, where rays begin.
    """

    home: Array
    inside: Array
    wall: Array
    n: Array
    first: int


ONE_ROOM = Rooms(np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0), OUTERMOST)
