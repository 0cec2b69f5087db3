"""Distances between convex shapes, at rest and on a straight way, by closed forms and searches along one line.

The distance between two convex shapes of which one is shifted along a straight line is a convex function of the
shift, and so is the least value of a jointly convex function over one of its variables. So what has no closed
form here is searched along one line at a time by golden section, which finds the least value of a convex
function wherever it is. Points are tuples of mm. `daq.bench.keep_out` solves the same questions by bounded least
squares; nothing is shared with it.
"""

import math
from collections.abc import Callable

Point = tuple[float, float, float]

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
SECTIONS = 40  # the interval shrinks to 4e-9 of itself


def least(function: Callable[[float], float]) -> float:
    """Least value of a convex function on [0, 1]."""
    low, high = 0.0, 1.0
    left, right = high - GOLDEN, low + GOLDEN
    at_left, at_right = function(left), function(right)
    best = min(function(low), function(high), at_left, at_right)
    for _ in range(SECTIONS):
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - GOLDEN * (high - low)
            at_left = function(left)
            best = min(best, at_left)
        else:
            low, left, at_left = left, right, at_right
            right = low + GOLDEN * (high - low)
            at_right = function(right)
            best = min(best, at_right)
    return best


def along(begin: Point, end: Point, part: float) -> Point:
    """Point between two others."""
    x0, y0, z0 = begin
    x1, y1, z1 = end
    return (x0 + part * (x1 - x0), y0 + part * (y1 - y0), z0 + part * (z1 - z0))


def minus(one: Point, other: Point) -> Point:
    """Difference of two points."""
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def plus(one: Point, other: Point) -> Point:
    """Sum of two points."""
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


def point_to_segment(point: Point, begin: Point, end: Point) -> float:
    """Distance of a point from a segment (which may be a point)."""
    way, to = minus(end, begin), minus(point, begin)
    length2 = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
    part = 0.0
    if length2 > 0.0:
        part = min(max((to[0] * way[0] + to[1] * way[1] + to[2] * way[2]) / length2, 0.0), 1.0)
    return math.dist(point, along(begin, end, part))


def point_to_box(point: Point, low: Point, high: Point) -> float:
    """Distance of a point from a box whose edges run along x, y, z; 0 inside."""
    return math.hypot(
        max(low[0] - point[0], 0.0, point[0] - high[0]),
        max(low[1] - point[1], 0.0, point[1] - high[1]),
        max(low[2] - point[2], 0.0, point[2] - high[2]),
    )


def segment_to_segment(begin: Point, end: Point, other_begin: Point, other_end: Point) -> float:
    """Distance of two segments (which may be points): a search along the first, closed across the second."""
    if begin == end:
        return point_to_segment(begin, other_begin, other_end)
    if other_begin == other_end:
        return point_to_segment(other_begin, begin, end)
    return least(lambda part: point_to_segment(along(begin, end, part), other_begin, other_end))


def segment_to_box(begin: Point, end: Point, low: Point, high: Point) -> float:
    """Distance of a segment (which may be a point) from a box; 0 if it enters it."""
    if begin == end:
        return point_to_box(begin, low, high)
    return least(lambda part: point_to_box(along(begin, end, part), low, high))
