"""Reflections of balls into the camera: of the sheet, and of the optics that the sheet comes from."""

import numpy as np

from ground.jit import Array, kernel
from sim.renderer.kernels.rays import camera_ray
from sim.renderer.kernels.surfaces import entry_sphere, snell


@kernel
def trace_reflections(
    first: int, last: int, camera: Array, spheres: Array, sheet_z: float, source: Array, blur: float, out: Array
) -> None:
    """Set rows first..last of `out` (H, W, 2): sheet and source as seen in the first ball of a pixel.

    The sheet is thin and clear: it shines with 1/cos of the angle at which it is looked through, at most tenfold.
    `source`: x, y, z and half length of a line along y, blurred by `blur` rad.
    """
    for row in range(first, last):
        for column in range(out.shape[1]):
            out[row, column, 0] = out[row, column, 1] = 0.0
            ox, oy, oz, dx, dy, dz = camera_ray(float(column), float(row), 0.0, 0.0, camera)
            nearest, body = np.inf, -1
            for index in range(spheres.shape[0]):
                s = spheres[index]
                t = entry_sphere(ox, oy, oz, dx, dy, dz, s, s[3])
                if t < nearest:
                    nearest, body = t, index
            if body < 0 or spheres[body, 5] != 0.0:
                continue
            s = spheres[body]
            x, y, z = ox + nearest * dx, oy + nearest * dy, oz + nearest * dz
            nx, ny, nz = (x - s[0]) / s[3], (y - s[1]) / s[3], (z - s[2]) / s[3]
            _, _, _, part = snell(dx, dy, dz, nx, ny, nz, 1.0 / s[4])
            along = 2.0 * (dx * nx + dy * ny + dz * nz)
            rx, ry, rz = dx - along * nx, dy - along * ny, dz - along * nz
            blocked = False
            for index in range(spheres.shape[0]):
                if index != body:
                    b = spheres[index]
                    if entry_sphere(x, y, z, rx, ry, rz, b, b[3]) < np.inf:
                        blocked = True
            if blocked:
                continue
            if (sheet_z - z) * rz > 0.0:
                out[row, column, 0] = (1.0 - part) * min(1.0 / abs(rz), 10.0)
            sx, sz = source[0] - x, source[2] - z
            sy = min(max(y, source[1] - source[3]), source[1] + source[3]) - y
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            off2 = 2.0 * max(1.0 - (sx * rx + sy * ry + sz * rz) / length, 0.0)
            out[row, column, 1] = (1.0 - part) * np.exp(-0.5 * off2 / (blur * blur))
