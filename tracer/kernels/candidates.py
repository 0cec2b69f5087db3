"""Which spheres a ray can meet next, in short lists that are too long at times, never too short.

A ray that leaves ball i is taken from a point inside it.  Its direction falls into one of BINS cells of a cube
around the ball, within a cone about the cell's axis u of half angle alpha.  Depth and side measured from the
ball's centre along and across u, the ray is no more than  r + tan(alpha) (t + r)  aside at depth t >= -r, r the
ball's radius.  It can meet ball j of radius R, whose centre lies at depth t and p aside, only if

    p <= r + tan(alpha) (t + r) + R / cos(alpha)        and        t + R >= -r ,

because of the points of ball j, those at depth t + x, sqrt(R^2 - x^2) + x tan(alpha) is R / cos(alpha) at most.
It meets it no nearer than  |j - i| - r - R.  The list of (ball, cell) holds who passes this test, by that
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

CLUSTER = 8
BALL_X, BALL_Y, BALL_Z, BALL_R = 0, 1, 2, 3  # rows of ``balls`` (.., N)
SPLIT = 4  # cells of a side of the cube each way
BINS = 6 * SPLIT * SPLIT
WIDER, ROUNDED = 1.0 + 1e-9, 1e-12
INDEX = (1 << 62) - 1  # says that a number is not negative: nothing is counted from the end


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
def cone_of(cell: int) -> tuple[float, float, float, float]:
    """Axis u of a cell of the cube and the tangent of the half angle of the cone around it."""
    face, row, column = cell // (SPLIT * SPLIT), cell // SPLIT % SPLIT, cell % SPLIT
    a, b = (2.0 * column + 1.0) / SPLIT - 1.0, (2.0 * row + 1.0) / SPLIT - 1.0
    sign = -1.0 if face % 2 else 1.0
    length, least = math.sqrt(1.0 + a * a + b * b), 1.0
    for corner in range(4):
        c, d = a + (1.0 if corner & 1 else -1.0) / SPLIT, b + (1.0 if corner & 2 else -1.0) / SPLIT
        least = min(least, (1.0 + a * c + b * d) / (length * math.sqrt(1.0 + c * c + d * d)))
    tangent = math.sqrt(1.0 - least * least) / least * WIDER + ROUNDED
    sign, a, b = sign / length, a / length, b / length
    if face >= 4:
        return a, b, sign, tangent
    if face >= 2:
        return b, sign, a, tangent
    return sign, a, b, tangent


@kernel_inlined
def in_cone(
    wx: float, wy: float, wz: float, radius: float, ux: float, uy: float, uz: float, tangent: float, wide: float,
    start: float,
) -> bool:  # fmt: skip
    """Whether a ball w from a ball of radius `start` may be met from there in a cone; `wide` is 1 / cos(alpha)."""
    depth, square = wx * ux + wy * uy + wz * uz, wx * wx + wy * wy + wz * wz
    bound = (start + tangent * (depth + start) + radius * wide) * WIDER + ROUNDED * abs(depth)
    ahead = depth + (radius + start) * WIDER + ROUNDED * abs(depth) >= 0.0
    return ahead & (bound > 0.0) & (square - depth * depth <= bound * bound + ROUNDED * square)


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
    """Make the list of those whom a ray may meet that leaves a ball in a cell's direction."""
    ux, uy, uz, tangent = cone_of(cell)
    wide, start, count = math.sqrt(1.0 + tangent * tangent), balls[BALL_R, ball] * WIDER, 0
    cx, cy, cz = balls[BALL_X, ball], balls[BALL_Y, ball], balls[BALL_Z, ball]
    at = ball * BINS + cell
    first = begin_list(at, near.begin[ball + 1] - near.begin[ball], lists)
    for e in range(near.begin[ball], near.begin[ball + 1]):
        k = near.items[e]
        wx, wy, wz, radius = balls[BALL_X, k] - cx, balls[BALL_Y, k] - cy, balls[BALL_Z, k] - cz, balls[BALL_R, k]
        if in_cone(wx, wy, wz, radius, ux, uy, uz, tangent, wide, start):
            apart = math.sqrt(wx * wx + wy * wy + wz * wz)
            count = insert(k, apart * (1.0 - ROUNDED) - (start + radius) * WIDER, first, count, lists)
    lists.size[at] = count
    lists.used[0] = first + count


@kernel_inlined
def cone_of_box(box: Array) -> tuple[float, float, float, float, float, float, float, float]:
    """Middle of some starts, radius of a ball around them, axis and tangent of a cone around their directions.

    ``box`` (12,): lowest and highest start x, y, z, lowest and highest direction x, y, z.  The tangent is infinite
    where directions are too far apart.
    """
    x, y, z = 0.5 * (box[0] + box[3]), 0.5 * (box[1] + box[4]), 0.5 * (box[2] + box[5])
    hx, hy, hz = 0.5 * (box[3] - box[0]), 0.5 * (box[4] - box[1]), 0.5 * (box[5] - box[2])
    start = math.sqrt(hx * hx + hy * hy + hz * hz) * WIDER
    ux, uy, uz = 0.5 * (box[6] + box[9]), 0.5 * (box[7] + box[10]), 0.5 * (box[8] + box[11])
    hx, hy, hz = 0.5 * (box[9] - box[6]), 0.5 * (box[10] - box[7]), 0.5 * (box[11] - box[8])
    length, aside = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(hx * hx + hy * hy + hz * hz) * WIDER
    if not aside < 0.9 * length:
        return x, y, z, start, 0.0, 0.0, 0.0, math.inf
    tangent = aside / (length - aside) * WIDER + ROUNDED
    return x, y, z, start, ux / length, uy / length, uz / length, tangent


@kernel
def list_from_box(box: Array, balls: Array, clusters: Array, lists: Lists) -> int:
    """Make the list of a tile from its ``box`` (12,); how many balls it has.

    ``clusters`` (4, C): x, y, z, R of spheres around CLUSTER balls each.
    """
    x, y, z, start, ux, uy, uz, tangent = cone_of_box(box)
    every = not tangent < math.inf
    wide, count, at = math.sqrt(1.0 + tangent * tangent), 0, lists.begin.shape[0] - 1
    first = begin_list(at, balls.shape[1], lists)  # forgotten as soon as the next list is made
    for c in range(clusters.shape[1]):
        wx, wy, wz = clusters[BALL_X, c] - x, clusters[BALL_Y, c] - y, clusters[BALL_Z, c] - z
        if not (every or in_cone(wx, wy, wz, clusters[BALL_R, c], ux, uy, uz, tangent, wide, start)):
            continue
        for k in range(CLUSTER * c, min(CLUSTER * (c + 1), balls.shape[1])):
            wx, wy, wz, radius = balls[BALL_X, k] - x, balls[BALL_Y, k] - y, balls[BALL_Z, k] - z, balls[BALL_R, k]
            if every or in_cone(wx, wy, wz, radius, ux, uy, uz, tangent, wide, start):
                apart = math.sqrt(wx * wx + wy * wy + wz * wz)
                count = insert(k, apart * (1.0 - ROUNDED) - (start + radius) * WIDER, first, count, lists)
    lists.size[at] = count
    return count


@kernel
def narrow_list(first: int, last: int, box: Array, balls: Array, lists: Lists) -> tuple[int, int]:
    """Copy those of a list whom the rays of a box (12,) may meet behind all lists; where they begin and end."""
    x, y, z, start, ux, uy, uz, tangent = cone_of_box(box)
    begin, count = lists.used[0], 0
    if not tangent < math.inf or begin + last - first > lists.ball.shape[0]:
        return first, last
    wide = math.sqrt(1.0 + tangent * tangent)
    for e in range(first, last):
        k = lists.ball[e]
        wx, wy, wz, radius = balls[BALL_X, k] - x, balls[BALL_Y, k] - y, balls[BALL_Z, k] - z, balls[BALL_R, k]
        if in_cone(wx, wy, wz, radius, ux, uy, uz, tangent, wide, start):
            apart = math.sqrt(wx * wx + wy * wy + wz * wz)
            count = insert(k, apart * (1.0 - ROUNDED) - (start + radius) * WIDER, begin, count, lists)
    return begin, begin + count


@kernel
def count_neighbours(balls: Array, clusters: Array, horizon: float, begin: Array, items: Array) -> int:
    """Balls within the horizon of each: numbers to items if it has room; begin (N + 1,); how many in all."""
    total = 0
    for i in range(balls.shape[1]):
        begin[i] = total
        x, y, z, r = balls[BALL_X, i], balls[BALL_Y, i], balls[BALL_Z, i], balls[BALL_R, i]
        for c in range(clusters.shape[1]):
            wx, wy, wz = clusters[BALL_X, c] - x, clusters[BALL_Y, c] - y, clusters[BALL_Z, c] - z
            reach = (horizon + r + clusters[BALL_R, c]) * WIDER
            if not wx * wx + wy * wy + wz * wz <= reach * reach:
                continue
            for k in range(CLUSTER * c, min(CLUSTER * (c + 1), balls.shape[1])):
                wx, wy, wz = balls[BALL_X, k] - x, balls[BALL_Y, k] - y, balls[BALL_Z, k] - z
                reach = (horizon + r + balls[BALL_R, k]) * WIDER
                if k != i and wx * wx + wy * wy + wz * wz <= reach * reach:
                    if total < items.shape[0]:
                        items[total] = k
                    total += 1
    begin[balls.shape[1]] = total
    return total
