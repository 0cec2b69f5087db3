"""A ray and a dome: a shell of glass between two spheres, with another medium, and bodies or the camera, inside.

Row (14,): centres of the outer and of the inner sphere, their radii [mm], n of the glass and of what fills the
dome, both / n of what is around, and the axis and the cosine of the half angle of the part that is glass: the rest
is its mount, opaque.  The spheres need not be concentric: a wall that is thicker on one side is a wedge.

Ways are those of a tube (``tracer.kernels.tube``): from outside IN, beside the inside THROUGH, totally reflected
by it OFF; from inside OUT.  The investigation plane may cut a dome: what reaches it first ends there, seen if it
is inside, lost (MISSED_PLANE) in the glass.

A point of a surface is taken from the foot point a of the ray on the sphere's centre, q = c + a -+ h d with
h^2 = R^2 - a^2, and its normal is (q - c) / R.  Which surface comes next is known from where the ray is.
"""

import math

from ground.jit import Array, kernel
from tracer.kernels.refraction import on_sphere_rates, refracted, refracted_rates
from tracer.kernels.rooms import IN, OUT, THROUGH
from tracer.kernels.sphere import foot, transmittance
from tracer.kernels.world import BLOCKED, ENTERED, MISSED_PLANE, OFF_INSIDE, RECOVERED, TIR

OUTER_AT, INNER_AT, OUTER, INNER, WALL, FILLED, AXIS, OPENING = 0, 3, 6, 7, 8, 9, 10, 13
NEAR, FAR = -1.0, 1.0


@kernel
def to_shell(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array, at: int, which: int, side: float
) -> tuple[float, float, float, float, float, float, float]:
    """Distance to the near or far side of one sphere, which the ray meets: t, point and outward normal there."""
    radius = row[which]
    m, ax, ay, az = foot(px - row[at], py - row[at + 1], pz - row[at + 2], dx, dy, dz)
    h = side * math.sqrt(max(0.0, radius * radius - (ax * ax + ay * ay + az * az)))
    ax, ay, az = ax + h * dx, ay + h * dy, az + h * dz
    return m + h, row[at] + ax, row[at + 1] + ay, row[at + 2] + az, ax / radius, ay / radius, az / radius


@kernel
def is_mount(x: float, y: float, z: float, row: Array) -> bool:
    """Whether a point of the shell belongs to the mount."""
    wx, wy, wz = x - row[0], y - row[1], z - row[2]
    along = wx * row[AXIS] + wy * row[AXIS + 1] + wz * row[AXIS + 2]
    return bool(along < row[OPENING] * math.sqrt(wx * wx + wy * wy + wz * wz))


@kernel
def passes_inside(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> bool:
    """Whether a ray in the glass goes on a line through the inner sphere."""
    _, ax, ay, az = foot(px - row[3], py - row[4], pz - row[5], dx, dy, dz)
    return bool(ax * ax + ay * ay + az * az < row[INNER] * row[INNER])


@kernel
def meets_dome(px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array) -> float:
    """Distance to where the ray goes in; inf if it does not, or meets the investigation plane first."""
    m, ax, ay, az = foot(px - row[0], py - row[1], pz - row[2], dx, dy, dz)
    h2 = row[OUTER] * row[OUTER] - (ax * ax + ay * ay + az * az)
    if not h2 > 0.0:
        return math.inf
    t = m - math.sqrt(h2)
    return t if t > 0.0 and pz + t * dz > 0.0 else math.inf


@kernel
def out_of_glass(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From a point of the glass out through the outer sphere: as `Kind.cross`, light of this surface alone."""
    n = row[WALL]
    t, qx, qy, qz, nx, ny, nz = to_shell(px, py, pz, dx, dy, dz, row, OUTER_AT, OUTER, FAR)
    if not qz > 0.0:
        return MISSED_PLANE, px, py, pz, dx, dy, dz, 0.0, 0.0
    if is_mount(qx, qy, qz, row):
        return BLOCKED, qx, qy, qz, dx, dy, dz, n * t, 0.0
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, -nx, -ny, -nz, n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, n * t, 0.0
    return RECOVERED, qx, qy, qz, ex, ey, ez, n * t, transmittance(c1, c2, 1.0 / n)


@kernel
def cross_dome(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From outside into the dome, or through its glass alone, as `Kind.cross`."""
    n, filled = row[WALL], row[FILLED]
    t, qx, qy, qz, nx, ny, nz = to_shell(px, py, pz, dx, dy, dz, row, OUTER_AT, OUTER, NEAR)
    if is_mount(qx, qy, qz, row):
        return BLOCKED, qx, qy, qz, dx, dy, dz, t, 0.0
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, 1.0 / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, t, 0.0
    surface = transmittance(c1, c2, n)
    path, fate = t, RECOVERED
    if passes_inside(qx, qy, qz, ex, ey, ez, row):
        t, qx, qy, qz, nx, ny, nz = to_shell(qx, qy, qz, ex, ey, ez, row, INNER_AT, INNER, NEAR)
        path += n * t
        if not qz > 0.0:
            return MISSED_PLANE, qx, qy, qz, ex, ey, ez, path, 0.0
        if is_mount(qx, qy, qz, row):
            return BLOCKED, qx, qy, qz, ex, ey, ez, path, 0.0
        ex, ey, ez, c1, c2 = refracted(ex, ey, ez, nx, ny, nz, n / filled)
        if c2 > 0.0:
            return ENTERED, qx, qy, qz, ex, ey, ez, path, surface * transmittance(c1, c2, filled / n)
        fate = OFF_INSIDE
    lost, qx, qy, qz, ex, ey, ez, more, out = out_of_glass(qx, qy, qz, ex, ey, ez, row)
    return lost if lost != RECOVERED else fate, qx, qy, qz, ex, ey, ez, path + more, surface * out


@kernel
def leave_dome(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, row: Array
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """From inside out of the dome, as `Kind.leave`; paths are / n of what is around."""
    n, filled = row[WALL], row[FILLED]
    t, qx, qy, qz, nx, ny, nz = to_shell(px, py, pz, dx, dy, dz, row, INNER_AT, INNER, FAR)
    if not qz > 0.0:
        return RECOVERED, px, py, pz, dx, dy, dz, 0.0, 1.0
    path = filled * t
    if is_mount(qx, qy, qz, row):
        return BLOCKED, qx, qy, qz, dx, dy, dz, path, 0.0
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, -nx, -ny, -nz, filled / n)
    if c2 == 0.0:
        return TIR, qx, qy, qz, ex, ey, ez, path, 0.0
    light = transmittance(c1, c2, n / filled)
    lost, qx, qy, qz, ex, ey, ez, more, out = out_of_glass(qx, qy, qz, ex, ey, ez, row)
    return ENTERED if lost == RECOVERED else lost, qx, qy, qz, ex, ey, ez, path + more, light * out


@kernel
def shell_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    row: Array, rate: Array, at: int, which: int, side: float, e: float, e_rate: float,
) -> tuple[float, ...]:  # fmt: skip
    """Point and direction behind one sphere, on its near or far side, and their derivatives."""
    t, qx, qy, qz, nx, ny, nz = to_shell(px, py, pz, dx, dy, dz, row, at, which, side)
    fx, fy, fz, rx, ry, rz = on_sphere_rates(
        dx, dy, dz, t, nx, ny, nz, row[which], fx, fy, fz, ux, uy, uz, rate[at], rate[at + 1], rate[at + 2],
        rate[which],
    )  # fmt: skip
    nx, ny, nz, rx, ry, rz = -side * nx, -side * ny, -side * nz, -side * rx, -side * ry, -side * rz
    ex, ey, ez, c1, c2 = refracted(dx, dy, dz, nx, ny, nz, e)
    ux, uy, uz = refracted_rates(dx, dy, dz, nx, ny, nz, e, c1, c2, ux, uy, uz, rx, ry, rz, e_rate)
    return qx, qy, qz, ex, ey, ez, fx, fy, fz, ux, uy, uz


@kernel
def dome_rates(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, row: Array, rate: Array, way: int,
) -> tuple[float, ...]:  # fmt: skip
    """Derivatives of point and direction behind, on the way that the ray took, as `Kind.rates`."""
    n, filled, n_rate, filled_rate = row[WALL], row[FILLED], rate[WALL], rate[FILLED]
    if way == OUT:
        e, e_rate = filled / n, (filled_rate - filled / n * n_rate) / n
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = shell_rates(
            px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate, INNER_AT, INNER, FAR, e, e_rate
        )
    else:
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = shell_rates(
            px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate, OUTER_AT, OUTER, NEAR,
            1.0 / n, -n_rate / (n * n),
        )  # fmt: skip
        if way != THROUGH:
            e, e_rate = n / filled, (n_rate - n / filled * filled_rate) / filled
            px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz = shell_rates(
                px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate, INNER_AT, INNER, NEAR, e, e_rate
            )
            if way == IN:
                return fx, fy, fz, ux, uy, uz
    _, _, _, _, _, _, fx, fy, fz, ux, uy, uz = shell_rates(
        px, py, pz, dx, dy, dz, fx, fy, fz, ux, uy, uz, row, rate, OUTER_AT, OUTER, FAR, n, n_rate
    )
    return fx, fy, fz, ux, uy, uz
