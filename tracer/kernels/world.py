"""Bodies of a scene as kernels take them, and the search for the one that a ray meets next.

Spheres come first: they have a table of their own, cells to look them up, and numbers
from 0 up.  All other kinds of bodies stand in ``others``, one table a kind, and are asked one by one; their
numbers go down from FIRST_OTHER, kind by kind.

Which kinds a scene has is known by the TYPE of ``others``: kernels are compiled for the kinds in use.  A scene of
spheres has an empty table of rods, so that it shares them with one whose balls stand on rods.  A kind is a
NamedTuple class of one array ``rows`` (N, ...), with its functions in KINDS (see `Kind`, and
``docs/add-a-body.md``).

Of many spheres the next one is found by walking through a grid of cells (`next_in_bed`).  Space is cut into equal
cubes; each lists the spheres whose box, grown by GROW cells, reaches into it.  A ray walks from cell to cell and
asks the spheres listed there by the very test of ``next_sphere``: what it finds has the same bits.  When may it
stop?  A sphere B that comes before the best one A has its foot point, which lies inside B, at m_B < m_A: in a cell
that the walk enters before m_A.  So the walk goes on until it enters a cell beyond m_A, and finds the nearest for
certain.  Growing the boxes makes the rounding of the walk harmless: it adds candidates, and no tolerance enters
the decision whether a sphere is hit.

``frame`` (7,): lowest corner of the grid, side of a cell, numbers of cells along x, y, z; ``begin`` (cells + 1,)
and ``items`` int32: the spheres of cell c are items[begin[c]:begin[c + 1]].
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ground.jit import OVERLOADED, Array, kernel, kernel_inlined, overload
from tracer.kernels.ball import next_shaped
from tracer.kernels.branches import FIRST_OTHER, NOTHING
from tracer.kernels.rooms import ONE_ROOM, Rooms
from tracer.kernels.sphere import OPAQUE, RADIUS
from tracer.kernels.vectors import Vector, dot, move, subtract, vector_at

GROW = 1e-6  # cells; the walk is off by a few 1e-16 of the distance walked
RECOVERED, BLOCKED, TIR, MISSED_PLANE, TOO_MANY_EVENTS, IN_GLASS = range(6)  # RayStatus, as plain integers
ENTERED, OFF_INSIDE = 6, 7  # of a ray at a body: in another room now; behind it, totally reflected by its inside
EDGE = 8  # RayStatus: met an edge between flat faces
FATES = 16  # a body with faces returns  fate + FATES * faces  (``tracer.kernels.block``)
Crossed = tuple[
    int, Vector, Vector, float, float
]  # status, point, direction, path, share of the light; see `Kind`
MOST_NUMBERS = 64  # of a row of another kind
STILL = np.zeros(MOST_NUMBERS)


@kernel
def enter_axis(p: float, d: float, low: float, high: float) -> tuple[float, float]:
    """Distances along p + t d at which one coordinate lies between low and high; (inf, -inf) for never."""
    if d == 0.0:
        return (-math.inf, math.inf) if low <= p <= high else (math.inf, -math.inf)
    a, b = (low - p) / d, (high - p) / d
    return min(a, b), max(a, b)


@kernel
def next_in_bed(
    p: Vector, d: Vector, last: int, spheres: Array, cells: tuple[Array, Array, Array], room: int, home: Array
) -> tuple[int, float]:
    """Number of the sphere met next, or NOTHING, and the distance to its foot point, as ``world.next_sphere``.

    `cells` are ``frame``, ``begin`` and ``items``; see the top of the file.
    """
    (px, py, pz), (dx, dy, dz), (frame, begin, items) = p, d, cells
    best, nearest = NOTHING, math.inf
    x0, y0, z0, side = frame[0], frame[1], frame[2], frame[3]
    nx, ny, nz = int(frame[4]), int(frame[5]), int(frame[6])
    ax, bx = enter_axis(px, dx, x0, x0 + nx * side)
    ay, by = enter_axis(py, dy, y0, y0 + ny * side)
    az, bz = enter_axis(pz, dz, z0, z0 + nz * side)
    t, end = max(0.0, max(ax, max(ay, az))), min(bx, min(by, bz))
    if t <= end:
        i = min(nx - 1, max(0, int((px + t * dx - x0) / side)))
        j = min(ny - 1, max(0, int((py + t * dy - y0) / side)))
        k = min(nz - 1, max(0, int((pz + t * dz - z0) / side)))
        si, sj, sk = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1, 1 if dz > 0.0 else -1
        tx = (x0 + (i + (1 if si > 0 else 0)) * side - px) / dx if dx != 0.0 else math.inf
        ty = (y0 + (j + (1 if sj > 0 else 0)) * side - py) / dy if dy != 0.0 else math.inf
        tz = (z0 + (k + (1 if sk > 0 else 0)) * side - pz) / dz if dz != 0.0 else math.inf
        while t <= nearest:
            cell = (k * ny + j) * nx + i
            for e in range(begin[cell], begin[cell + 1]):
                s = items[e]
                if s != last:
                    m = distance_to_sphere(p, d, nearest, spheres[s])
                    if m < nearest and (home.shape[0] == 0 or home[s] == room):
                        best, nearest = s, m
            if tx <= ty and tx <= tz:
                t, i = tx, i + si
                tx += side / abs(dx)
                if i < 0 or i >= nx:
                    break
            elif ty <= tz:
                t, j = ty, j + sj
                ty += side / abs(dy)
                if j < 0 or j >= ny:
                    break
            else:
                t, k = tz, k + sk
                tz += side / abs(dz)
                if k < 0 or k >= nz:
                    break
    return best, nearest


@kernel_inlined
def distance_to_sphere(p: Vector, d: Vector, nearest: float, sphere: Array) -> float:
    """Distance to the foot point in a sphere that is ahead and before `nearest`, else inf."""
    w = subtract(p, vector_at(sphere, 0))
    m = -dot(w, d)
    if 0.0 < m < nearest:
        a = move(w, m, d)
        if dot(a, a) < sphere[RADIUS] * sphere[RADIUS]:
            return m
    return math.inf


class World(NamedTuple):
    """Bodies of a scene.

    Parameters
    ----------
    spheres : (N, 6 or more) float64
        See ``Scene.sphere_table``.
    frame, begin, items : (7,) float64, (C,) int32, (I,) int32
        Grid of cells, see ``tracer.kernels.world``; no items: every sphere is asked.
    others : tuple of NamedTuple
        Tables of the other kinds in use.
    rooms : Rooms
        Which of them stand where, if there are walls.
    still : (MOST_NUMBERS,) float64
        Rates of a row that does not change: zeros.
    shapes : tuple of (N, SHAPE_NUMBERS) float64
        Which spheres are out of round (``tracer.kernels.ball``); empty where none is.
    is_crossed : bool
        Whether spheres reach through the investigation plane, where rays then end.
    """

    spheres: Array
    frame: Array
    begin: Array
    items: Array
    others: tuple[Any, ...] = ()
    rooms: Rooms = ONE_ROOM
    still: Array = STILL
    shapes: tuple[Any, ...] = ()
    is_crossed: bool = False


Tables = tuple[Array, World]  # of a scene: camera and bodies


class Kind(NamedTuple):
    """Kernels that trace rays through one kind of body; `row` is one row of the kind's table.

    Parameters
    ----------
    meets : (p, d, row) -> float
        Distance along the half-line p + t d to any point in the body, inf for a miss.
    cross : (p, d, row) -> (status, p', d', path, light), optional
        The ray behind the body, from a point that lies before all that comes later: RECOVERED if there is one,
        OFF_INSIDE, ENTERED if it is in the room inside, else BLOCKED, TIR or MISSED_PLANE; optical path / n of the
        room it came from, from p to p', share of the light that passes.  None: opaque.
    rates : (p, d, f, u, row, rate, way) -> (f', u'), optional
        Derivatives of p' and d' when p changes by f, d by u and the row by its rate, on a way THROUGH, IN, OUT,
        OFF.
    leave : like cross, optional
        The ray that meets nothing more in the room inside: ENTERED outside, RECOVERED if the investigation plane
        comes first, else BLOCKED, TIR or MISSED_PLANE.  Path / n of the room outside.  None: no ray comes out.
    numbers : tuple of str, optional
        Names of the row's numbers, all of them, if landing points are asked how they depend on these
        (``tracer.kernels.landing``); the three parts of a vector are called ``..x``, ``..y``, ``..z``.
    """

    meets: Callable[..., float]
    cross: Callable[..., Crossed] | None = None
    rates: Callable[..., tuple[Vector, Vector]] | None = None
    leave: Callable[..., Crossed] | None = None
    numbers: tuple[str, ...] = ()


KINDS: dict[type, Kind] = {}


@kernel
def next_sphere(p: Vector, d: Vector, last: int, spheres: Array, room: int, home: Array) -> tuple[int, float]:
    """Number of the sphere in a room met next, or NOTHING, and the distance to its foot point."""
    best, nearest = NOTHING, math.inf
    for i in range(spheres.shape[0]):
        if i != last:
            m = distance_to_sphere(p, d, nearest, spheres[i])
            if m < nearest and (home.shape[0] == 0 or home[i] == room):
                best, nearest = i, m
    return best, nearest


@kernel_inlined
def next_body(p: Vector, d: Vector, last: int, room: int, world: World) -> int:
    """Number of the body in a room met next, or NOTHING; the half-line starts at p and `last` is excluded."""
    home = world.rooms.home
    if len(world.shapes) > 0:
        best, nearest = next_shaped(p, d, last, world.spheres, world.shapes, room, home)
    elif world.items.shape[0] > 0:
        best, nearest = next_in_bed(p, d, last, world.spheres, (world.frame, world.begin, world.items), room, home)
    else:
        best, nearest = next_sphere(p, d, last, world.spheres, room, home)
    if len(world.others) > 0:
        of_others = home[world.spheres.shape[0] :] if home.shape[0] > 0 else home
        best = meet_others(p, d, last, (best, nearest), FIRST_OTHER, world.others, room, of_others)
    return best


@kernel_inlined
def is_stopped(p: Vector, d: Vector, body: int, world: World) -> bool:
    """Return whether a ray from p along d ends at the body that it meets."""
    if len(world.others) > 0 and body < NOTHING:
        return cross_other(p, d, body, world.others)[0] == BLOCKED
    return bool(world.spheres[body, OPAQUE] != 0.0)


def meet_others(
    p: Vector, d: Vector, last: int, best: tuple[int, float], number: int, others: tuple[Any, ...], room: int,
    home: Array,
) -> int:  # fmt: skip
    """Number of the body met first, of others and `best` (number, distance); `number` is the first other's."""
    for table in others:
        for row in table.rows:
            if number != last and (len(home) == 0 or home[FIRST_OTHER - number] == room):
                t = KINDS[type(table)].meets(p, d, row)
                if t < best[1]:
                    best = number, t
            number -= 1
    return best[0]


def cross_other(p: Vector, d: Vector, number: int, others: tuple[Any, ...]) -> Crossed:
    """Take a ray through another body, as `Kind.cross`; `number` counts from FIRST_OTHER down."""
    for table in others:
        if FIRST_OTHER - number < len(table.rows):
            cross = KINDS[type(table)].cross or stop_ray
            return cross(p, d, table.rows[FIRST_OTHER - number])
        number += len(table.rows)
    return stop_ray(p, d)


def leave_other(p: Vector, d: Vector, number: int, others: tuple[Any, ...]) -> Crossed:
    """Take a ray out of the room in another body, as `Kind.leave`."""
    for table in others:
        if FIRST_OTHER - number < len(table.rows):
            leave = KINDS[type(table)].leave or stay_inside
            return leave(p, d, table.rows[FIRST_OTHER - number])
        number += len(table.rows)
    return stay_inside(p, d)


def meets_other(p: Vector, d: Vector, number: int, others: tuple[Any, ...]) -> float:
    """Distance along the half-line p + t d to another body, as `Kind.meets`."""
    for table in others:
        if FIRST_OTHER - number < len(table.rows):
            return KINDS[type(table)].meets(p, d, table.rows[FIRST_OTHER - number])
        number += len(table.rows)
    return math.inf


def place_of_other(number: int, others: tuple[Any, ...], before: int) -> tuple[int, int]:
    """Place of the numbers of another body among those of all, and how many they are; `before` come first."""
    for table in others:
        width = len(KINDS[type(table)].numbers)
        if FIRST_OTHER - number < len(table.rows):
            return before + width * (FIRST_OTHER - number), width
        number += len(table.rows)
        before += width * len(table.rows)
    return before, 0


def rates_other(
    p: Vector, d: Vector, f: Vector, u: Vector, number: int, others: tuple[Any, ...], rate: Array, way: int
) -> tuple[Vector, Vector]:
    """Derivatives of a ray behind another body, as `Kind.rates`."""
    for table in others:
        if FIRST_OTHER - number < len(table.rows):
            rates, row = KINDS[type(table)].rates or opaque_rates, table.rows[FIRST_OTHER - number]
            return rates(p, d, f, u, row, rate, way)
        number += len(table.rows)
    return f, u


@kernel
def stop_ray(p: Vector, d: Vector, row: Array | None = None) -> Crossed:
    """Stop a ray: `Kind.cross` of an opaque body."""
    return BLOCKED, p, d, 0.0, 0.0


@kernel
def stay_inside(p: Vector, d: Vector, row: Array | None = None) -> Crossed:
    """Let a ray end in its room: `Kind.leave` of what no ray comes out of."""
    return RECOVERED, p, d, 0.0, 1.0


@kernel
def miss(p: Vector, d: Vector, row: Array | None = None) -> float:
    """Distance to a body that there is not."""
    return math.inf


@kernel
def opaque_rates(
    p: Vector, d: Vector, f: Vector, u: Vector, row: Array, rate: Array, way: int
) -> tuple[Vector, Vector]:
    """`Kind.rates` of an opaque body, which are never asked for."""
    return f, u


def _kind(others: Any) -> Kind | None:  # noqa: ANN401
    """Functions of the first of some tables, given by their type; None for no tables."""
    return KINDS[others.types[0].instance_class] if len(others) else None


@overload(meet_others, jit_options=OVERLOADED)
def _meet_others(p, d, last, best, number, others, room, home):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    kind = _kind(others)
    if kind is None:
        return lambda p, d, last, best, number, others, room, home: best[0]
    meets = kind.meets

    def first_and_rest(p, d, last, best, number, others, room, home):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        rows = others[0].rows
        for i in range(rows.shape[0]):
            if number - i != last and (len(home) == 0 or home[FIRST_OTHER - number + i] == room):
                t = meets(p, d, rows[i])
                if t < best[1]:
                    best = number - i, t
        return meet_others(p, d, last, best, number - rows.shape[0], others[1:], room, home)

    return first_and_rest


def _crossing(others: Any, function: Any, otherwise: Any) -> Any:  # noqa: ANN401 - types of numba
    """Write `cross_other`, `leave_other` or `meets_other` for the types of some tables, by that of the first."""
    kind = _kind(others)
    if kind is None:
        return lambda p, d, number, others: otherwise(p, d)
    cross = getattr(kind, function.__name__.removesuffix("_other")) or otherwise

    def first_or_rest(p, d, number, others):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        rows = others[0].rows
        if FIRST_OTHER - number < rows.shape[0]:
            return cross(p, d, rows[FIRST_OTHER - number])
        return function(p, d, number + rows.shape[0], others[1:])

    return first_or_rest


@overload(cross_other, jit_options=OVERLOADED)
def _cross_other(p, d, number, others):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return _crossing(others, cross_other, stop_ray)


@overload(leave_other, jit_options=OVERLOADED)
def _leave_other(p, d, number, others):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return _crossing(others, leave_other, stay_inside)


@overload(meets_other, jit_options=OVERLOADED)
def _meets_other(p, d, number, others):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return _crossing(others, meets_other, miss)


@overload(place_of_other, jit_options=OVERLOADED)
def _place_of_other(number, others, before):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    kind = _kind(others)
    if kind is None:
        return lambda number, others, before: (before, 0)
    width = len(kind.numbers)

    def first_or_rest(number, others, before):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        rows = others[0].rows
        if FIRST_OTHER - number < rows.shape[0]:
            return before + width * (FIRST_OTHER - number), width
        return place_of_other(number + rows.shape[0], others[1:], before + width * rows.shape[0])

    return first_or_rest


@overload(rates_other, jit_options=OVERLOADED)
def _rates_other(p, d, f, u, number, others, rate, way):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    kind = _kind(others)
    if kind is None:
        return lambda p, d, f, u, number, others, rate, way: (f, u)
    rates = kind.rates or opaque_rates

    def first_or_rest(p, d, f, u, number, others, rate, way):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        rows = others[0].rows
        if FIRST_OTHER - number < rows.shape[0]:
            return rates(p, d, f, u, rows[FIRST_OTHER - number], rate, way)
        return rates_other(p, d, f, u, number + rows.shape[0], others[1:], rate, way)

    return first_or_rest
