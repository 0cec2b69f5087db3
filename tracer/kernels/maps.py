"""Many rays: lists of rays, whole rows of the sensor."""

import math

from ground.jit import Array, kernel
from tracer.kernels.camera import EYE_X, EYE_Y, EYE_Z, pixel_ray
from tracer.kernels.march import march
from tracer.kernels.walk import keep_trail, walk
from tracer.kernels.world import RECOVERED, World, unowned_world


@kernel
def trace_rays(origins: Array, directions: Array, world: World, first: int, last: int, rays: Array) -> None:
    """Trace rays first..last-1 from origins (N, 3) along unit directions (N, 3) into records (trace.RAY)."""
    world = unowned_world(world)
    for i in range(first, last):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        status, x, y, _, dx, dy, dz, path, passed, key, events = march(px, py, pz, dx, dy, dz, world)
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
def trace_trails(origins: Array, directions: Array, world: World, trails: Array) -> None:
    """Record in trails (N, MAX_EVENTS) int32 the events of each ray."""
    for i in range(origins.shape[0]):
        px, py, pz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        walk(px, py, pz, dx, dy, dz, world, keep_trail, trails[i])


@kernel
def trace_rows(
    camera: Array, world: World, first: int, last: int, point: Array, status: Array, key: Array
) -> None:
    """Trace the pixels of rows first..last-1: plane points (H, W, 2), status and branch key (H, W)."""
    world = unowned_world(world)
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    for row in range(first, last):
        for column in range(point.shape[1]):
            dx, dy, dz = pixel_ray(float(column), float(row), camera)
            s, x, y, _, _, _, _, _, _, k, _ = march(ox, oy, oz, dx, dy, dz, world)
            good = s == RECOVERED
            point[row, column, 0] = x if good else math.nan
            point[row, column, 1] = y if good else math.nan
            status[row, column] = s
            key[row, column] = k
