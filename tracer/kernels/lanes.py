"""The tables of a bundle of rays (``tracer.kernels.bundle``): columns in one array each, and what holds them.

``balls`` (BALL_ROWS, N): rows as named below; neighbours in space stand side by side.  ``rays`` (RAY_NUMBERS,)
float64 and ``marks`` (MARK_NUMBERS,) int64 are the lanes, ``ends`` (END_NUMBERS,) float64, ``fates``
(FATE_NUMBERS,) int64 and ``trail`` (MAX_EVENTS * LANES,) int32, event by event, what became of the rays, in the
places of the tile.  ``box`` (12 + 2 LANES,) is that of `box_of`.
``grouped`` (GROUP_NUMBERS,) float64 and ``group_marks`` (GROUP_MARKS,) int64 are the lanes in groups; ``group_of``
(N * BINS + 1,) int32 says which group asks a list, and is -1 between two rounds.
"""

from typing import NamedTuple

from ground.jit import Array
from tracer.kernels.candidates import Lists, Neighbours
from tracer.kernels.packets import DX, DY, DZ, LANES, PX, PY, PZ, STEP

BALL_R2, BALL_IR2, BALL_KT, BALL_NU, BALL_GK, BALL_IR, BALL_OPAQUE = range(4, 11)
BALL_ROWS = 11  # centre x, y, z, R, R^2, 1/R^2, 1/(n R)^2, 1/n, (n^2 - 1)/n^2, 1/R, opaque
CX, CY, CZ, R2, IR2, KT, NU, GK, IR = (k * STEP for k in range(6, 15))  # of the ball that turns a ray
RAY_NUMBERS = 15 * STEP
LAST, PICK, PLACE, KEY, LOST, CELL = (k * STEP for k in range(6))
MARK_NUMBERS = 6 * STEP
GROUPED = LANES * 8 + 40  # each group begins a whole vector
GX, GY, GZ, GU, GV, GW, NEAR = (k * GROUPED for k in range(7))
GROUP_NUMBERS = 7 * GROUPED
FOUND, LANE, BEGIN, LIST, MEMBER = (k * GROUPED for k in range(5))
GROUP_MARKS = 5 * GROUPED
END_PX, END_PY, END_PZ, END_DX, END_DY, END_DZ = PX, PY, PZ, DX, DY, DZ
END_NUMBERS = 6 * STEP
FATE, EVENTS, HASH = (k * STEP for k in range(3))
FATE_NUMBERS = 3 * STEP


class Bed(NamedTuple):
    """Spheres of a scene for bundles: numbers in ``balls``, neighbours, clusters and the cells of the bed.

    ``spheres`` (N, 6) as ``Scene.sphere_table`` in the order of ``balls``; ``frame``, ``begin``, ``items`` their
    cells, see ``tracer.kernels.world``; ``home`` (0,).  ``alike``: all are of one radius and one index; ``clear``:
    none is opaque; ``is_crossed``: some reach through the investigation plane, where rays end.
    """

    balls: Array
    near: Neighbours
    clusters: Array
    spheres: Array
    frame: Array
    begin: Array
    items: Array
    home: Array
    alike: bool
    clear: bool
    is_crossed: bool


class Bundle(NamedTuple):
    """Memory of one thread; see the top of the file."""

    rays: Array
    marks: Array
    ends: Array
    fates: Array
    trail: Array
    box: Array
    grouped: Array
    group_marks: Array
    group_of: Array
    lists: Lists
