"""Light that rays of a sheet leave in boxes of its plane: as much as their power times their length there."""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from sim.renderer.kernels.rays import NOTHING, STOP, pass_body
from sim.renderer.kernels.surfaces import World

EMITTED, PASSED, STOPPED = range(3)  # powers: of all, of what left all bodies, of what ended at an opaque one
MOST_PIECES = 64
Boxes = tuple[float, float, float, float, float, float, float]


@kernel_inlined
def clip(at: float, slope: float, size: float, low: float, high: float) -> tuple[float, float]:
    """Return the part of low..high where at + t slope lies in 0..size."""
    if slope == 0.0:
        return (low, high) if 0.0 <= at <= size else (0.0, -1.0)
    one, two = -at / slope, (size - at) / slope
    return max(low, min(one, two)), min(high, max(one, two))


@kernel
def leave_light(rays: Array, world: World, boxes: Boxes, sums: Array, powers: Array) -> None:
    """Follow rays through all bodies.

    `boxes`: left and upper edge and side of square boxes about the plane z = middle + slope_x x + slope_y y, how
    far from it light counts, middle and slopes.  `rays` (N, 8): origin, unit direction, power, and a number in
    [0, 1) that shifts the places at which its light is left, half a box apart.  Adds to `sums` (3, rows, columns):
    light and its first two moments by height over the plane; to `powers` (3,).
    """
    left, top, side, reach, middle, slope_x, slope_y = boxes
    _, rows, columns = sums.shape
    step = 0.5 * side
    for k in range(rays.shape[0]):
        o, d = (rays[k, 0], rays[k, 1], rays[k, 2]), (rays[k, 3], rays[k, 4], rays[k, 5])
        power, last, in_glass = rays[k, 6], -1, False
        powers[EMITTED] += power
        for _ in range(MOST_PIECES):
            beyond, onward, rest, last, goes_in, t, body = pass_body(o, d, power, last, in_glass, np.inf, world)
            if not in_glass:
                height = o[2] - middle - slope_x * o[0] - slope_y * o[1]
                rise = d[2] - slope_x * d[0] - slope_y * d[1]
                low, high = clip(o[0] - left, d[0], side * columns, 0.0, t)
                low, high = clip(top - o[1], -d[1], side * rows, low, high)
                low, high = clip(height + reach, rise, 2.0 * reach, low, high)
                at = low + rays[k, 7] * step
                while at < high:
                    column = min(max(int((o[0] + at * d[0] - left) / side), 0), columns - 1)
                    row = min(max(int((top - o[1] - at * d[1]) / side), 0), rows - 1)
                    z = height + at * rise
                    sums[0, row, column] += power * step
                    sums[1, row, column] += power * step * z
                    sums[2, row, column] += power * step * z * z
                    at += step
            if body == NOTHING:
                powers[PASSED] += power
            elif body == STOP:
                powers[STOPPED] += power
            if body == NOTHING or rest <= 0.0:
                break
            o, d, power, in_glass = beyond, onward, rest, goes_in
