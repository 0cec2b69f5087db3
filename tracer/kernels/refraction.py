"""One surface: where a ray meets it, how it is bent there, and the derivatives of both.

Spheres need nothing of this (``tracer.kernels.sphere``).  Windows and tubes, which have another medium on each
side, are made of single surfaces.  With the unit normal N against the ray, the ratio e = n before / n behind and
the cosines c1 = -N . d before and c2 = sqrt(1 - e^2 (1 - c1^2)) behind,

    d' = e d + k N,     k = e c1 - c2 = (e^2 - 1) / (e c1 + c2).

The second form of k has no cancellation at e = 1, where the surface bends by exactly nothing.  The light is
reflected totally where the square under the root is not positive; nothing else decides it.

A cylinder of radius R about the axis s + l k is met at m -+ h by a line p + t d: across the axis, with
e = d - (d . k) k, the foot point a = w + m e, m = -(w . e) / e^2, lies b = |a| from the axis, and
h^2 = (R^2 - b^2) / e^2.

Derivatives follow from the surface itself.  If p changes by f, d by u and the surface by its own rates, the point
q = p + t d changes by f + t u + t' d, and N . q' = (how fast the surface moves along N) gives t'.
"""

import math

from ground.jit import kernel


@kernel
def refracted(
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, e: float
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Direction behind a surface of normal n against the ray, c1 and c2; c2 = 0: all light is reflected."""
    c1 = -(nx * dx + ny * dy + nz * dz)
    square = 1.0 - e * e * (1.0 - c1 * c1)
    if not square > 0.0:
        return dx + 2.0 * c1 * nx, dy + 2.0 * c1 * ny, dz + 2.0 * c1 * nz, c1, 0.0
    c2 = math.sqrt(square)
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    return e * dx + k * nx, e * dy + k * ny, e * dz + k * nz, c1, c2


@kernel
def refracted_rates(
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, e: float, c1: float, c2: float,
    ux: float, uy: float, uz: float, rx: float, ry: float, rz: float, e_rate: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Derivative of `refracted`'s direction when d changes by u, the normal by r and e by its rate."""
    c1_rate = -(rx * dx + ry * dy + rz * dz + nx * ux + ny * uy + nz * uz)
    if c2 == 0.0:
        return (
            ux + 2.0 * (c1_rate * nx + c1 * rx),
            uy + 2.0 * (c1_rate * ny + c1 * ry),
            uz + 2.0 * (c1_rate * nz + c1 * rz),
        )
    c2_rate = (e * e * c1 * c1_rate - e * e_rate * (1.0 - c1 * c1)) / c2
    k = (e - 1.0) * (e + 1.0) / (e * c1 + c2)
    k_rate = e_rate * c1 + e * c1_rate - c2_rate
    return (
        e_rate * dx + e * ux + k_rate * nx + k * rx,
        e_rate * dy + e * uy + k_rate * ny + k * ry,
        e_rate * dz + e * uz + k_rate * nz + k * rz,
    )


@kernel
def across(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    sx: float, sy: float, sz: float, kx: float, ky: float, kz: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Distance m to the point nearest an axis, its square distance b^2, e^2 and where along the axis it lies."""
    wx, wy, wz = px - sx, py - sy, pz - sz
    w, d = wx * kx + wy * ky + wz * kz, dx * kx + dy * ky + dz * kz
    wx, wy, wz = wx - w * kx, wy - w * ky, wz - w * kz
    ex, ey, ez = dx - d * kx, dy - d * ky, dz - d * kz
    e2 = ex * ex + ey * ey + ez * ez
    if e2 == 0.0:
        return 0.0, wx * wx + wy * wy + wz * wz, 0.0, w
    m = -(wx * ex + wy * ey + wz * ez) / e2
    ax, ay, az = wx + m * ex, wy + m * ey, wz + m * ez
    # Once more: from far away the first subtraction leaves a part along e of the size of its rounding.
    more = -(ax * ex + ay * ey + az * ez) / e2
    ax, ay, az = ax + more * ex, ay + more * ey, az + more * ez
    return m + more, ax * ax + ay * ay + az * az, e2, w + (m + more) * d


@kernel
def outward(
    qx: float, qy: float, qz: float, sx: float, sy: float, sz: float, kx: float, ky: float, kz: float,
    radius: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Outward normal of a cylinder at its point q."""
    wx, wy, wz = qx - sx, qy - sy, qz - sz
    w = wx * kx + wy * ky + wz * kz
    return (wx - w * kx) / radius, (wy - w * ky) / radius, (wz - w * kz) / radius


@kernel
def on_plane_rates(
    dx: float, dy: float, dz: float, t: float, nx: float, ny: float, nz: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float, shift: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Derivative of q = p + t d on a plane of normal n that moves by `shift` along n there."""
    fx, fy, fz = fx + t * ux, fy + t * uy, fz + t * uz
    k = (shift - (nx * fx + ny * fy + nz * fz)) / (nx * dx + ny * dy + nz * dz)
    return fx + k * dx, fy + k * dy, fz + k * dz


@kernel
def on_cylinder_rates(
    qx: float, qy: float, qz: float, dx: float, dy: float, dz: float, t: float,
    nx: float, ny: float, nz: float, sx: float, sy: float, sz: float, kx: float, ky: float, kz: float,
    radius: float, fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    s_x: float, s_y: float, s_z: float, k_x: float, k_y: float, k_z: float, radius_rate: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Derivatives of q = p + t d on a cylinder and of its outward normal n there.

    p changes by f, d by u, the point s of the axis by s_, its direction k by k_, the radius by its rate.
    """
    along = (qx - sx) * kx + (qy - sy) * ky + (qz - sz) * kz
    shift = radius_rate + nx * (s_x + along * k_x) + ny * (s_y + along * k_y) + nz * (s_z + along * k_z)
    gx, gy, gz = on_plane_rates(dx, dy, dz, t, nx, ny, nz, fx, fy, fz, ux, uy, uz, shift)
    rx, ry, rz = gx - s_x, gy - s_y, gz - s_z
    turned = (qx - sx) * k_x + (qy - sy) * k_y + (qz - sz) * k_z
    r = rx * kx + ry * ky + rz * kz + turned
    rx, ry, rz = rx - r * kx - along * k_x, ry - r * ky - along * k_y, rz - r * kz - along * k_z
    return (
        gx, gy, gz,
        (rx - radius_rate * nx) / radius, (ry - radius_rate * ny) / radius, (rz - radius_rate * nz) / radius,
    )  # fmt: skip


@kernel
def on_sphere_rates(
    dx: float, dy: float, dz: float, t: float, nx: float, ny: float, nz: float, radius: float,
    fx: float, fy: float, fz: float, ux: float, uy: float, uz: float,
    c_x: float, c_y: float, c_z: float, radius_rate: float,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Derivatives of q = p + t d on a sphere and of its outward normal n there; its centre changes by c_."""
    shift = radius_rate + nx * c_x + ny * c_y + nz * c_z
    gx, gy, gz = on_plane_rates(dx, dy, dz, t, nx, ny, nz, fx, fy, fz, ux, uy, uz, shift)
    return (
        gx, gy, gz,
        (gx - c_x - radius_rate * nx) / radius,
        (gy - c_y - radius_rate * ny) / radius,
        (gz - c_z - radius_rate * nz) / radius,
    )  # fmt: skip
