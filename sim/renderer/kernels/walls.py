"""Walls of the renderer: windows, tubes, domes and blocks; every surface a quadratic or a plane between two media.

A ray goes to the nearest surface a hair ahead of it; which way it crosses says which of the two media is beyond.
What is around a wall, or around a ball, is asked of a point of it: a tube behind a window stands in the window's
liquid. (The tracer knows rooms, and which surface comes next; nothing here is shared with it.)

The faces of a block are cut into triangles about their middles, met as Moeller and Trumbore (1997) do: with the
edges a and b from the corner s, o + t d = s + v a + w b has the solution t, v, w by three determinants.  The third
side of each triangle is an edge of the block, which is ground: light that comes within its width is lost.
"""

import numpy as np

from ground.jit import kernel
from sim.renderer.kernels.surfaces import Float64

HAIR_MM = 1e-7
ROUNDING = 1e-12  # of a triangle's side
FACE, INSIDE, LOST, FACET = range(4)
WINDOW, TUBE, DOME, TRIANGLE = 0.0, 1.0, 2.0, 3.0
# Row of a wall: kind, point, direction, thickness, length or half angle [rad], radii, n around, of the glass and
# beyond, point of the inside.  Of a triangle, whose normal looks outwards: corner, its two sides (POINT, AXIS,
# DEPTH), then GROUND, the share of it beside the edge, and IS_INNER, 1 on the inside of a block.
KIND, POINT, AXIS, DEPTH, RADIUS, INNER, AROUND, GLASS, BEYOND, INSIDE_AT, NUMBERS = (
    0, 1, 4, 7, 8, 9, 10, 11, 12, 13, 16,
)  # fmt: skip
GROUND, IS_INNER = 13, 14


@kernel
def meet_triangle(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, w: Float64
) -> tuple[float, float, float, float, float]:
    """Distance to a triangle (inf for a miss), its unit normal, and the share of its height above the edge."""
    ax, ay, az, bx, by, bz = w[AXIS], w[AXIS + 1], w[AXIS + 2], w[DEPTH], w[DEPTH + 1], w[DEPTH + 2]
    sx, sy, sz = ox - w[POINT], oy - w[POINT + 1], oz - w[POINT + 2]
    hx, hy, hz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
    det = ax * hx + ay * hy + az * hz
    if det == 0.0:
        return np.inf, 0.0, 0.0, 0.0, 0.0
    v = (sx * hx + sy * hy + sz * hz) / det
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    u = (dx * qx + dy * qy + dz * qz) / det
    # two triangles share a side: what falls between them by rounding belongs to both
    if v < -ROUNDING or u < -ROUNDING or v + u > 1.0:
        return np.inf, 0.0, 0.0, 0.0, 0.0
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return (bx * qx + by * qy + bz * qz) / det, nx / length, ny / length, nz / length, 1.0 - v - u


@kernel
def next_wall(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, walls: Float64
) -> tuple[float, float, float, float, float, float, bool, int]:
    """Nearest surface ahead: distance (inf for none), normal against the ray, n before and behind it.

    Then whether the ray is in glass behind it, and which surface it is: FACE, INSIDE of a tube, FACET of a block,
    or none (LOST).
    """
    best, nx, ny, nz, before, behind, in_glass, which = np.inf, 0.0, 0.0, 0.0, 1.0, 1.0, False, FACE
    for index in range(walls.shape[0]):
        w = walls[index]
        if w[KIND] == TRIANGLE:
            t, mx, my, mz, height = meet_triangle(ox, oy, oz, dx, dy, dz, w)
            if HAIR_MM < t < best:
                best, which = t, LOST if height < w[GROUND] else FACET
                inward = mx * dx + my * dy + mz * dz < 0.0
                out = 1.0 if inward else -1.0
                nx, ny, nz = out * mx, out * my, out * mz
                in_glass = inward == (w[IS_INNER] == 0.0)
                other = w[BEYOND] if w[IS_INNER] != 0.0 else w[AROUND]
                before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
            continue
        kx, ky, kz = w[AXIS], w[AXIS + 1], w[AXIS + 2]
        px, py, pz = ox - w[POINT], oy - w[POINT + 1], oz - w[POINT + 2]
        at, slope = px * kx + py * ky + pz * kz, dx * kx + dy * ky + dz * kz
        fx, fy, fz = px - at * kx, py - at * ky, pz - at * kz
        ex, ey, ez = dx - slope * kx, dy - slope * ky, dz - slope * kz
        if w[KIND] == WINDOW:
            for face in range(2):
                t = -(at + face * w[DEPTH]) / slope if slope != 0.0 else np.inf
                if HAIR_MM < t < best:
                    x, y, z = fx + t * ex, fy + t * ey, fz + t * ez
                    best, which = t, LOST if x * x + y * y + z * z >= w[RADIUS] * w[RADIUS] else FACE
                    side = -1.0 if slope > 0.0 else 1.0
                    nx, ny, nz = side * kx, side * ky, side * kz
                    in_glass = (face == 0) == (slope < 0.0)
                    other = w[AROUND] if face == 0 else w[BEYOND]
                    before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
            continue
        if w[KIND] == DOME:
            for surface in range(2):
                place, radius = (POINT, w[RADIUS]) if surface == 0 else (INSIDE_AT, w[INNER])
                gx, gy, gz = ox - w[place], oy - w[place + 1], oz - w[place + 2]
                b = 2.0 * (gx * dx + gy * dy + gz * dz)
                root = b * b - 4.0 * (gx * gx + gy * gy + gz * gz - radius * radius)
                if root <= 0.0:
                    continue
                for sign in (-1.0, 1.0):
                    t = 0.5 * (-b + sign * np.sqrt(root))
                    if HAIR_MM < t < best:
                        x, y, z = px + t * dx, py + t * dy, pz + t * dz
                        turn = np.arccos(min(1.0, (x * kx + y * ky + z * kz) / np.sqrt(x * x + y * y + z * z)))
                        best, which = t, LOST if turn > w[DEPTH] else (INSIDE if surface == 1 else FACE)
                        inward = sign < 0.0
                        out = 1.0 if inward else -1.0
                        nx = out * (gx + t * dx) / radius
                        ny = out * (gy + t * dy) / radius
                        nz = out * (gz + t * dz) / radius
                        in_glass = inward == (surface == 0)
                        other = w[AROUND] if surface == 0 else w[BEYOND]
                        before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
            continue
        a, b = ex * ex + ey * ey + ez * ez, 2.0 * (ex * fx + ey * fy + ez * fz)
        for surface in range(2):
            radius = w[RADIUS] if surface == 0 else w[INNER]
            root = b * b - 4.0 * a * (fx * fx + fy * fy + fz * fz - radius * radius)
            if a == 0.0 or root <= 0.0:
                continue
            for sign in (-1.0, 1.0):
                t = 0.5 * (-b + sign * np.sqrt(root)) / a
                if HAIR_MM < t < best and 0.0 < at + t * slope < w[DEPTH]:
                    best, which = t, INSIDE if surface == 1 else FACE
                    inward = sign < 0.0
                    out = 1.0 if inward else -1.0
                    nx, ny, nz = (
                        out * (fx + t * ex) / radius,
                        out * (fy + t * ey) / radius,
                        out * (fz + t * ez) / radius,
                    )
                    in_glass = inward == (surface == 0)
                    other = w[AROUND] if surface == 0 else w[BEYOND]
                    before, behind = (other, w[GLASS]) if in_glass else (w[GLASS], other)
        if slope != 0.0:
            for end in (0.0, w[DEPTH]):
                t = (end - at) / slope
                x, y, z = fx + t * ex, fy + t * ey, fz + t * ez
                off2 = x * x + y * y + z * z
                wall = w[INNER] * w[INNER] <= off2 < w[RADIUS] * w[RADIUS]
                liquid = off2 < w[INNER] * w[INNER] and w[AROUND] != w[BEYOND]
                if HAIR_MM < t < best and (wall or liquid):
                    best, which = t, LOST
    return best, nx, ny, nz, before, behind, in_glass, which
