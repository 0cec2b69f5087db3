"""Pixels of a map of spheres alone that an opaque rod may change, traced again; others stay as they are."""

import math

from ground.jit import Array, kernel
from tracer.kernels.branches import UNKNOWN
from tracer.kernels.camera import eye_of, pixel_ray
from tracer.kernels.rays import trace_to_plane
from tracer.kernels.world import RECOVERED, Tables


@kernel
def retrace_shadows(
    tables: Tables, shadows: Array, sides: Array, keys: Array, first: int, last: int,
    out: tuple[Array, Array, Array],
) -> None:  # fmt: skip
    """Trace the pixels of rows first..last-1 anew whose path to the plane point (H, W, 2) a rod may cross.

    ``shadows`` (K, 6): of each rod start x, y of its shadow, its axis x, y, 1 / length^2, width^2.  ``sides``
    (B, K, 3): of each branch and rod a, b, c, where points with a x + b y >= c are seen past it.  ``keys`` (B,) of
    the branches; another one is UNKNOWN.  `out`: plane points, status, branch numbers (H, W).
    """
    (camera, world), (plane, status, branch) = tables, out
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
            d = pixel_ray(float(column), float(row), camera)
            s, q, _, _, _, key, _ = trace_to_plane(eye_of(camera), d, world, world.items[:0])
            plane[row, column, 0] = q[0] if s == RECOVERED else math.nan
            plane[row, column, 1] = q[1] if s == RECOVERED else math.nan
            status[row, column] = s
            branch[row, column] = UNKNOWN
            for number in range(keys.shape[0]):
                if keys[number] == key:
                    branch[row, column] = number
