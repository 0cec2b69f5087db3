"""The loop of a grid of dots, flat or with grooves, whose rows are staggered by half a pitch."""

import numpy as np

from ground.jit import kernel
from sim.renderer.kernels.rays import Float32, Int64
from sim.renderer.kernels.surfaces import Float64


@kernel
def dots_in_rows(
    points: Float64,
    below: Float64,
    sizes: Float64,
    large: Float64,
    lines: Float64,
    groove: Int64,
    shades: Float32,
    out: Float32,
) -> None:
    """Reflectance of staggered rows of dots, as rays meet them.

    points (N, 2) and below (N, 2): where rays cross the face, and where they would cross the ground of the grooves
    [mm]; sizes (3,): half a pitch, which is the distance of rows as well, and the radii of usual and large dots;
    large (M, 2) places of the large ones and lines (2, 2), before and beyond which there are none, in half pitches
    and rows.  groove (2,): whether every second row is one, and whether that of the origin is.  shades (3,) of
    dots, ground and walls.
    """
    half = sizes[0]
    for index in range(points.shape[0]):
        x, y = points[index, 0] / half, points[index, 1] / half
        row = np.round(y)
        if groove[0] and (row + groove[1]) % 2 != 0:  # over a groove: on to its ground
            x, y = below[index, 0] / half, below[index, 1] / half
            if np.round(y) != row:
                out[index] = shades[2]
                continue
        odd = row - 2.0 * np.floor(0.5 * row)
        column = 2.0 * np.round(0.5 * (x - odd)) + odd
        radius = sizes[1]
        for k in range(large.shape[0]):
            if large[k, 0] == column and large[k, 1] == row:
                radius = sizes[2]
        there = lines[0, 0] < column < lines[1, 0] and lines[0, 1] < row < lines[1, 1]
        inside = np.hypot(x - column, y - row) * half < radius
        out[index] = shades[0] if there and inside else shades[1]
