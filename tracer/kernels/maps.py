"""Many rays: lists of pixels, whole rows of the sensor."""

from tracer.kernels._jit import Array, kernel
from tracer.kernels.camera import pixel_ray
from tracer.kernels.march import march


@kernel
def trace_pixels(
    camera: Array,
    spheres: Array,
    rods: Array,
    pixels: Array,
    first: int,
    last: int,
    status: Array,
    point: Array,
    direction: Array,
    path: Array,
    passed: Array,
    key: Array,
    events: Array,
) -> None:
    """Trace pixels[first:last] (N, 2) and write everything that is known about each ray."""
    for i in range(first, last):
        dx, dy, dz = pixel_ray(pixels[i, 0], pixels[i, 1], camera)
        (
            status[i],
            point[i, 0],
            point[i, 1],
            direction[i, 0],
            direction[i, 1],
            direction[i, 2],
            path[i],
            passed[i],
            key[i],
            events[i],
        ) = march(camera[0], camera[1], camera[2], dx, dy, dz, spheres, rods)


@kernel
def trace_rows(
    camera: Array, spheres: Array, rods: Array, first: int, last: int, point: Array, status: Array, key: Array
) -> None:
    """Trace the pixels of rows first..last-1: plane points (H, W, 2), status and branch key (H, W)."""
    for row in range(first, last):
        for column in range(point.shape[1]):
            dx, dy, dz = pixel_ray(float(column), float(row), camera)
            s, x, y, _, _, _, _, _, k, _ = march(camera[0], camera[1], camera[2], dx, dy, dz, spheres, rods)
            point[row, column, 0], point[row, column, 1] = x, y
            status[row, column] = s
            key[row, column] = k
