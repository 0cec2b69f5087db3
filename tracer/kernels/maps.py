"""Many rays: lists of rays, whole rows of the sensor."""

import math

from tracer.kernels._jit import Array, kernel
from tracer.kernels.camera import pixel_ray
from tracer.kernels.march import RECOVERED, march


@kernel
def trace_rays(
    origins: Array,
    directions: Array,
    spheres: Array,
    rods: Array,
    frame: Array,
    begin: Array,
    items: Array,
    first: int,
    last: int,
    trail: Array,
    rays: Array,
) -> None:
    """Trace rays first..last-1 from origins (N, 3) along unit directions (N, 3) into records (trace.RAY).

    ``frame``, ``begin``, ``items``: grid of cells as in ``tracer.kernels.bed``; no items: every sphere is asked.
    """
    for i in range(first, last):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        status, x, y, _, dx, dy, dz, path, passed, key, events = march(
            px, py, pz, dx, dy, dz, spheres, rods, frame, begin, items, trail
        )
        good = status == RECOVERED
        rays[i].status = status
        rays[i].x_mm = x if good else math.nan
        rays[i].y_mm = y if good else math.nan
        rays[i].direction[0], rays[i].direction[1], rays[i].direction[2] = dx, dy, dz
        rays[i].path_mm = path if good else math.nan
        rays[i].transmittance = passed if good else 0.0
        rays[i].key = key
        rays[i].events = events


@kernel
def trace_trails(
    origins: Array,
    directions: Array,
    spheres: Array,
    rods: Array,
    frame: Array,
    begin: Array,
    items: Array,
    trails: Array,
) -> None:
    """Record in trails (N, MAX_EVENTS) int32 the numbers of the spheres that each ray crosses."""
    for i in range(origins.shape[0]):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        march(px, py, pz, dx, dy, dz, spheres, rods, frame, begin, items, trails[i])


@kernel
def trace_rows(
    camera: Array,
    spheres: Array,
    rods: Array,
    frame: Array,
    begin: Array,
    items: Array,
    first: int,
    last: int,
    trail: Array,
    point: Array,
    status: Array,
    key: Array,
) -> None:
    """Trace the pixels of rows first..last-1: plane points (H, W, 2), status and branch key (H, W)."""
    for row in range(first, last):
        for column in range(point.shape[1]):
            dx, dy, dz = pixel_ray(float(column), float(row), camera)
            s, x, y, _, _, _, _, _, _, k, _ = march(
                camera[0], camera[1], camera[2], dx, dy, dz, spheres, rods, frame, begin, items, trail
            )
            good = s == RECOVERED
            point[row, column, 0] = x if good else math.nan
            point[row, column, 1] = y if good else math.nan
            status[row, column] = s
            key[row, column] = k
