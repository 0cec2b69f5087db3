"""A ray and a mesh: glass of any convex shape, known by cubic patches (``tracer.kernels.patches``).

A ray goes in once and out once.  Where one of both is not found, at a rim within rounding, it is lost.  What is
totally reflected from inside is lost too: unlike in a ball it may be anywhere on such a body, and what comes out
at last has met several faces.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.patches import BALL, CENTRE, ENTERS, INDEX, LEAVES, normal_at, normal_rates, where_met
from tracer.kernels.refraction import on_plane_rates, refracted, refracted_rates
from tracer.kernels.sphere import foot, transmittance
from tracer.kernels.world import BLOCKED, RECOVERED, TIR


@kernel
def meets_mesh(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not."""
    m, ax, ay, az = foot(px - row[CENTRE], py - row[CENTRE + 1], pz - row[CENTRE + 2], dx, dy, dz)
    if not ax * ax + ay * ay + az * az < row[BALL] * row[BALL] or m < -row[BALL]:
        return math.inf
    t = where_met(px, py, pz, dx, dy, dz, row, ENTERS)[0]
    return t if t > 0.0 else math.inf


@kernel
def cross_mesh(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """Through both faces, as `Kind.cross`."""
    n = row[INDEX]
    t, patch, a, b = where_met(px, py, pz, dx, dy, dz, row, ENTERS)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = normal_at(row, patch, a, b)
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t, 0.0
    light = transmittance(c1, c2, n)
    s, patch, a, b = where_met(qx, qy, qz, ex, ey, ez, row, LEAVES)
    if patch < 0:
        return BLOCKED, qx, qy, qz, ex, ey, ez, t, 0.0
    qx, qy, qz = qx + s * ex, qy + s * ey, qz + s * ez
    nx, ny, nz = normal_at(row, patch, a, b)
    ex, ey, ez, c1, c2 = refracted(ex, ey, ez, -nx, -ny, -nz, n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t + n * s, 0.0
    return RECOVERED, qx, qy, qz, ex, ey, ez, t + n * s, light * transmittance(c1, c2, 1.0 / n)


@kernel
def mesh_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array, way: int,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind, as `Kind.rates`; of the row only n may change."""
    n, n_rate = row[INDEX], rate[INDEX]
    t, patch, a, b = where_met(px, py, pz, dx, dy, dz, row, ENTERS)
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    nx, ny, nz = normal_at(row, patch, a, b)
    fx, fy, fz = on_plane_rates(dx, dy, dz, t, nx, ny, nz, fx, fy, fz, ux, uy, uz, 0.0)
    nx, ny, nz, rx, ry, rz = normal_rates(row, patch, a, b, fx, fy, fz)
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    ux, uy, uz = refracted_rates(
        dx, dy, dz, nx, ny, nz, 1.0 / n, c1, c2, ux, uy, uz, rx, ry, rz, -n_rate / (n * n)
    )
    s, patch, a, b = where_met(qx, qy, qz, ex, ey, ez, row, LEAVES)
    nx, ny, nz = normal_at(row, patch, a, b)
    fx, fy, fz = on_plane_rates(ex, ey, ez, s, nx, ny, nz, fx, fy, fz, ux, uy, uz, 0.0)
    nx, ny, nz, rx, ry, rz = normal_rates(row, patch, a, b, fx, fy, fz)
    _, _, _, c1, c2 = refracted(ex, ey, ez, -nx, -ny, -nz, n)
    ux, uy, uz = refracted_rates(ex, ey, ez, -nx, -ny, -nz, n, c1, c2, ux, uy, uz, -rx, -ry, -rz, n_rate)
    return fx, fy, fz, ux, uy, uz
