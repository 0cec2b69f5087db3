"""A ray and a window: a plane plate of glass between two media, as wide as any ray reaches.

Row (10,): middle of the face towards the camera, its unit normal towards the camera, thickness [mm], n of the
glass and of what lies behind, both / n of what lies before, radius [mm] of the opening in the opaque wall.
Whoever has come through stands in the room behind the window and does not come back: a ray that meets the wall
from behind, before the investigation plane, is lost.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.refraction import on_plane_rates, refracted, refracted_rates
from tracer.kernels.sphere import transmittance
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, RECOVERED, TIR

THICKNESS, GLASS, BEHIND, OPENING = 6, 7, 8, 9


@kernel
def is_open(x: float, y: float, z: float, row: Array) -> bool:
    """Whether a point of a face is in the opening."""
    wx, wy, wz = x - row[0], y - row[1], z - row[2]
    along = wx * row[3] + wy * row[4] + wz * row[5]
    return bool(wx * wx + wy * wy + wz * wz - along * along < row[OPENING] * row[OPENING])


@kernel
def meets_window(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to the front face; inf if the ray comes from behind or meets the investigation plane first."""
    slope = dx * row[3] + dy * row[4] + dz * row[5]
    if not slope < 0.0:
        return math.inf
    t = -((px - row[0]) * row[3] + (py - row[1]) * row[4] + (pz - row[2]) * row[5]) / slope
    return t if t > 0.0 and pz + t * dz > 0.0 else math.inf


@kernel
def cross_window(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """Through both faces, as `Kind.cross`."""
    nx, ny, nz, n = row[3], row[4], row[5], row[GLASS]
    t = -((px - row[0]) * nx + (py - row[1]) * ny + (pz - row[2]) * nz) / (dx * nx + dy * ny + dz * nz)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    if not is_open(qx, qy, qz, row):
        return BLOCKED, qx, qy, qz, dx, dy, dz, t, 0.0
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t, 0.0
    light = transmittance(c1, c2, n)
    s = row[THICKNESS] / c2
    qx, qy, qz = qx + s * ex, qy + s * ey, qz + s * ez
    if not qz > 0.0:
        return MISSED_PLANE, qx, qy, qz, ex, ey, ez, t, 0.0
    if not is_open(qx, qy, qz, row):
        return BLOCKED, qx, qy, qz, ex, ey, ez, t, 0.0
    ex, ey, ez, c2, c3 = refracted(ex, ey, ez, nx, ny, nz, n / row[BEHIND])
    if c3 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t + n * s, 0.0
    return ENTERED, qx, qy, qz, ex, ey, ez, t + n * s, light * transmittance(c2, c3, row[BEHIND] / n)


@kernel
def leave_window(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """RECOVERED unless the back of the wall comes first, as `Kind.leave`."""
    slope = dx * row[3] + dy * row[4] + dz * row[5]
    if slope > 0.0:
        above = (px - row[0]) * row[3] + (py - row[1]) * row[4] + (pz - row[2]) * row[5] + row[THICKNESS]
        if pz - above / slope * dz > 0.0:
            return MISSED_PLANE, px, py, pz, dx, dy, dz, 0.0, 0.0
    return RECOVERED, px, py, pz, dx, dy, dz, 0.0, 1.0


@kernel
def window_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array, way: int,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind, as `Kind.rates`."""
    nx, ny, nz, n, behind = row[3], row[4], row[5], row[GLASS], row[BEHIND]
    rx, ry, rz = rate[3], rate[4], rate[5]
    t = -((px - row[0]) * nx + (py - row[1]) * ny + (pz - row[2]) * nz) / (dx * nx + dy * ny + dz * nz)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    lever = (qx - row[0]) * rx + (qy - row[1]) * ry + (qz - row[2]) * rz
    shift = nx * rate[0] + ny * rate[1] + nz * rate[2] - lever
    fx, fy, fz = on_plane_rates(dx, dy, dz, t, nx, ny, nz, fx, fy, fz, ux, uy, uz, shift)
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    ux, uy, uz = refracted_rates(
        dx, dy, dz, nx, ny, nz, 1.0 / n, c1, c2, ux, uy, uz, rx, ry, rz, -rate[GLASS] / (n * n)
    )
    s = row[THICKNESS] / c2
    # the back face: q' . n = (q0 - thickness n) . n, of which q0 moves with the front face
    wx, wy, wz = qx + s * ex - row[0], qy + s * ey - row[1], qz + s * ez - row[2]
    lever = wx * rx + wy * ry + wz * rz
    shift = nx * rate[0] + ny * rate[1] + nz * rate[2] - lever - rate[THICKNESS]
    fx, fy, fz = on_plane_rates(ex, ey, ez, s, nx, ny, nz, fx, fy, fz, ux, uy, uz, shift)
    _, _, _, c2, c3 = refracted(ex, ey, ez, nx, ny, nz, n / behind)
    e_rate = (rate[GLASS] - n / behind * rate[BEHIND]) / behind
    ux, uy, uz = refracted_rates(ex, ey, ez, nx, ny, nz, n / behind, c2, c3, ux, uy, uz, rx, ry, rz, e_rate)
    return fx, fy, fz, ux, uy, uz
