"""Pixels of a map of spheres alone that an opaque rod may change, anew by `march`; others stay as they are."""

import math

from ground.jit import Array, kernel
from tracer.kernels.branches import UNKNOWN
from tracer.kernels.camera import EYE_X, EYE_Y, EYE_Z, pixel_ray
from tracer.kernels.march import march
from tracer.kernels.world import RECOVERED, World


@kernel
def march_doubted(
    camera: Array, world: World, shadows: Array, sides: Array, keys: Array, first: int, last: int,
    plane: Array, status: Array, branch: Array,
) -> None:  # fmt: skip
    """Trace the pixels of rows first..last-1 anew whose way to the plane point (H, W, 2) a rod may cross.

    ``shadows`` (K, 6): of each rod start x, y of its shadow, its axis x, y, 1 / length^2, width^2.  ``sides``
    (B, K, 3): of each branch and rod a, b, c, where points with a x + b y >= c are seen past it.  ``keys`` (B,) of
    the branches; another one is UNKNOWN in ``branch`` (H, W).
    """
    for row in range(first, last):
        for column in range(branch.shape[1]):
            number, x, y = branch[row, column], plane[row, column, 0], plane[row, column, 1]
            clear = number < keys.shape[0]
            for k in range(shadows.shape[0]):
                if number == 0:
                    dx, dy, ax, ay = x - shadows[k, 0], y - shadows[k, 1], shadows[k, 2], shadows[k, 3]
                    along = min(max((dx * ax + dy * ay) * shadows[k, 4], 0.0), 1.0)
                    dx, dy = dx - along * ax, dy - along * ay
                    clear = clear and dx * dx + dy * dy >= shadows[k, 5]
                elif clear:
                    clear = sides[number, k, 0] * x + sides[number, k, 1] * y >= sides[number, k, 2]
            if clear:
                continue
            dx, dy, dz = pixel_ray(float(column), float(row), camera)
            s, x, y, _, _, _, _, _, _, key, _ = march(
                camera[EYE_X], camera[EYE_Y], camera[EYE_Z], dx, dy, dz, world
            )
            plane[row, column, 0] = x if s == RECOVERED else math.nan
            plane[row, column, 1] = y if s == RECOVERED else math.nan
            status[row, column] = s
            branch[row, column] = UNKNOWN
            for number in range(keys.shape[0]):
                if keys[number] == key:
                    branch[row, column] = number
