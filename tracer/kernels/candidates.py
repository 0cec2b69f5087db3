"""Lists of the spheres that a ray can meet next: too long at times, never too short.

A ray that leaves ball i is taken from a point inside it.  Its direction falls into one of BINS cells of a cube
around the ball, within a cone about the cell's axis u of half angle alpha.  Depth and side measured from the
ball's centre along and across u, the ray is no more than  r + tan(alpha) (t + r)  aside at depth t >= -r, r the
ball's radius.  It can meet ball j of radius R, whose centre lies at depth t and p aside, only if

    p <= r + tan(alpha) (t + r) + R / cos(alpha)        and        t + R >= -r ,

because of the points of ball j, those at depth t + x, sqrt(R^2 - x^2) + x tan(alpha) is R / cos(alpha) at most.
It meets it no nearer than  |j - i| - r - R.  The list of (ball, cell) holds the balls that pass this test, by that
distance: a search ends where the next one stands farther than what was found.  Beds are local: lists hold the
balls within a `horizon`, and a ray that finds nothing before it is looked for in the cells of the whole bed
(``kernels.world``).

The rays of a tile begin together: a ball around their starts, of radius 0 at the pinhole, takes the place of the
ball that was left, and the box of their directions that of the cell.

Lists are made when they are first asked for, by each thread for itself, and forgotten all together when the memory
is full.  Bounds are widened by far more than rounding, which costs candidates, never a hit.

Rays of a tile that ask the same list ask it together (``tracer.kernels.bundle``); where they are many it is first
narrowed by the same test to those that this group can meet.
"""

import math
from typing import NamedTuple

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.vectors import Vector, add, divide, dot, scale, subtract, vector_at

CLUSTER = 8
BALL_X, BALL_Y, BALL_Z, BALL_R = 0, 1, 2, 3  # rows of ``balls`` (.., N)
SPLIT = 4  # cells of a side of the cube each way
BINS = 6 * SPLIT * SPLIT
WIDER, ROUNDED = 1.0 + 1e-9, 1e-12
ORIGIN = (0.0, 0.0, 0.0)
Cone = tuple[Vector, float, float]  # axis u, tangent and 1 / cosine of the half angle alpha
NON_NEGATIVE = (1 << 62) - 1  # says that a number is not negative: nothing is counted from the end


class Lists(NamedTuple):
    """Candidate lists of one thread.

    Parameters
    ----------
    begin : (N * BINS + 1,) int32
        Where each list begins, the last one that of the tile; -1: not made yet.
    size : (N * BINS + 1,) int32
        Balls of each list.
    ball, least : (room,) int32, (room,) float64
        Memory of all lists: numbers of balls and the nearest distance at which each may be met [mm].
    used : (1,) int64
        How much of it is in use.
    """

    begin: Array
    size: Array
    ball: Array
    least: Array
    used: Array


class Neighbours(NamedTuple):
    """Balls near each ball: items[begin[i] : begin[i + 1]] int32 of ball i, within its `horizon` (N,) [mm]."""

    begin: Array
    items: Array
    horizon: float


@kernel_inlined
def cell_of(dx: float, dy: float, dz: float) -> int:
    """Cell of the cube that a direction points to."""
    x, y, z = abs(dx), abs(dy), abs(dz)
    by_z, by_y = (z >= x) & (z >= y), y >= x
    most = z if by_z else (y if by_y else x)
    main = dz if by_z else (dy if by_y else dx)
    a = dx if by_z else (dz if by_y else dy)
    b = dy if by_z else (dx if by_y else dz)
    face = (4 if by_z else (2 if by_y else 0)) + (1 if main < 0.0 else 0)
    scale = 0.5 * SPLIT / most
    column = min(SPLIT - 1, int(a * scale + 0.5 * SPLIT))
    row = min(SPLIT - 1, int(b * scale + 0.5 * SPLIT))
    return (face * SPLIT + row) * SPLIT + column


@kernel
def cone_of(cell: int) -> Cone:
    """Cone around a cell of the cube."""
    face, row, column = cell // (SPLIT * SPLIT), cell // SPLIT % SPLIT, cell % SPLIT
    a, b = (2.0 * column + 1.0) / SPLIT - 1.0, (2.0 * row + 1.0) / SPLIT - 1.0
    sign = -1.0 if face % 2 else 1.0
    length, least = math.sqrt(1.0 + a * a + b * b), 1.0
    for corner in range(4):
        c, d = a + (1.0 if corner & 1 else -1.0) / SPLIT, b + (1.0 if corner & 2 else -1.0) / SPLIT
        least = min(least, (1.0 + a * c + b * d) / (length * math.sqrt(1.0 + c * c + d * d)))
    tangent = math.sqrt(1.0 - least * least) / least * WIDER + ROUNDED
    sign, a, b = sign / length, a / length, b / length
    axis = (a, b, sign) if face >= 4 else (b, sign, a) if face >= 2 else (sign, a, b)
    return axis, tangent, math.sqrt(1.0 + tangent * tangent)


@kernel_inlined
def may_meet(w: Vector, radius: float, start: float, cone: Cone) -> bool:
    """Return whether a ball w from a ball of radius `start` may be met from there in a cone."""
    u, tangent, wide = cone
    depth, square = dot(w, u), dot(w, w)
    bound = (start + tangent * (depth + start) + radius * wide) * WIDER + ROUNDED * abs(depth)
    ahead = depth + (radius + start) * WIDER + ROUNDED * abs(depth) >= 0.0
    return ahead & (bound > 0.0) & (square - depth * depth <= bound * bound + ROUNDED * square)


@kernel_inlined
def from_ball(k: int, balls: Array, x: Vector) -> tuple[Vector, float]:
    """Centre of ball k, seen from x, and its radius."""
    return (balls[BALL_X, k] - x[0], balls[BALL_Y, k] - x[1], balls[BALL_Z, k] - x[2]), balls[BALL_R, k]


@kernel_inlined
def insert_near(k: int, w: Vector, reach: float, first: int, count: int, lists: Lists) -> int:
    """Insert ball k, w away, by the nearest distance at which it may be met; `reach`: both radii."""
    return insert(k, math.sqrt(dot(w, w)) * (1.0 - ROUNDED) - reach * WIDER, first, count, lists)


@kernel_inlined
def insert(k: int, least: float, first: int, count: int, lists: Lists) -> int:
    """Insert ball k into the list that is being made, by its nearest distance."""
    place = first + count
    while place > first and lists.least[place - 1] > least:
        lists.least[place], lists.ball[place] = lists.least[place - 1], lists.ball[place - 1]
        place -= 1
    lists.least[place], lists.ball[place] = least, k
    return count + 1


@kernel
def begin_list(at: int, most: int, lists: Lists) -> int:
    """Begin list `at` of up to `most` balls; all others are forgotten if there is no room.  Where it begins."""
    if lists.used[0] + most > lists.ball.shape[0]:
        for k in range(lists.begin.shape[0]):
            lists.begin[k] = -1
        lists.used[0] = 0
    lists.begin[at] = lists.used[0]
    return int(lists.used[0])


@kernel
def list_from_ball(ball: int, cell: int, balls: Array, near: Neighbours, lists: Lists) -> None:
    """Make the list of the balls that a ray may meet that leaves a ball in a cell's direction."""
    cone, (x, start), count = cone_of(cell), from_ball(ball, balls, ORIGIN), 0
    start *= WIDER
    at = ball * BINS + cell
    first = begin_list(at, near.begin[ball + 1] - near.begin[ball], lists)
    for e in range(near.begin[ball], near.begin[ball + 1]):
        k = near.items[e]
        w, radius = from_ball(k, balls, x)
        if may_meet(w, radius, start, cone):
            count = insert_near(k, w, start + radius, first, count, lists)
    lists.size[at] = count
    lists.used[0] = first + count


@kernel_inlined
def cone_of_box(box: Array) -> tuple[Vector, float, Cone]:
    """Middle of some starts, radius of a ball around them, and a cone around their directions.

    ``box`` (12,): lowest and highest start x, y, z, lowest and highest direction x, y, z.  The tangent is infinite
    where directions are too far apart.
    """
    x, h = middle_of(box, 0)
    start = math.sqrt(dot(h, h)) * WIDER
    u, h = middle_of(box, 6)
    length, aside = math.sqrt(dot(u, u)), math.sqrt(dot(h, h)) * WIDER
    if not aside < 0.9 * length:
        return x, start, (ORIGIN, math.inf, math.inf)
    tangent = aside / (length - aside) * WIDER + ROUNDED
    return x, start, (divide(u, length), tangent, math.sqrt(1.0 + tangent * tangent))


@kernel_inlined
def middle_of(box: Array, at: int) -> tuple[Vector, Vector]:
    """Middle and half the size of a box whose lowest and highest numbers begin at a place."""
    low, high = vector_at(box, at), vector_at(box, at + 3)
    return scale(0.5, add(low, high)), scale(0.5, subtract(high, low))


@kernel
def list_from_box(box: Array, balls: Array, clusters: Array, lists: Lists) -> int:
    """Make the list of a tile from its ``box`` (12,); how many balls it has.

    ``clusters`` (4, C): x, y, z, R of spheres around CLUSTER balls each.
    """
    x, start, cone = cone_of_box(box)
    every, count, at = not cone[1] < math.inf, 0, lists.begin.shape[0] - 1
    first = begin_list(at, balls.shape[1], lists)  # forgotten as soon as the next list is made
    for c in range(clusters.shape[1]):
        w, radius = from_ball(c, clusters, x)
        if not (every or may_meet(w, radius, start, cone)):
            continue
        for k in range(CLUSTER * c, min(CLUSTER * (c + 1), balls.shape[1])):
            w, radius = from_ball(k, balls, x)
            if every or may_meet(w, radius, start, cone):
                count = insert_near(k, w, start + radius, first, count, lists)
    lists.size[at] = count
    return count


@kernel
def narrow_list(first: int, last: int, box: Array, balls: Array, lists: Lists) -> tuple[int, int]:
    """Copy those of a list that the rays of a box (12,) may meet behind all lists; where they begin and end."""
    x, start, cone = cone_of_box(box)
    begin, count = lists.used[0], 0
    if not cone[1] < math.inf or begin + last - first > lists.ball.shape[0]:
        return first, last
    for e in range(first, last):
        k = lists.ball[e]
        w, radius = from_ball(k, balls, x)
        if may_meet(w, radius, start, cone):
            count = insert_near(k, w, start + radius, begin, count, lists)
    return begin, begin + count


@kernel
def count_neighbours(balls: Array, clusters: Array, horizon: float, begin: Array, items: Array) -> int:
    """Balls within the horizon of each: numbers to items if it has room; begin (N + 1,); how many in all."""
    total = 0
    for i in range(balls.shape[1]):
        begin[i] = total
        x, r = from_ball(i, balls, ORIGIN)
        for c in range(clusters.shape[1]):
            w, radius = from_ball(c, clusters, x)
            reach = (horizon + r + radius) * WIDER
            if not dot(w, w) <= reach * reach:
                continue
            for k in range(CLUSTER * c, min(CLUSTER * (c + 1), balls.shape[1])):
                w, radius = from_ball(k, balls, x)
                reach = (horizon + r + radius) * WIDER
                if k != i and dot(w, w) <= reach * reach:
                    if total < items.shape[0]:
                        items[total] = k
                    total += 1
    begin[balls.shape[1]] = total
    return total
