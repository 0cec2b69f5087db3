"""One ray and one body of the renderer: textbook optics, written apart from the tracer on purpose.

A ray is a point o and a unit direction d.  Against a sphere of centre c and radius R the quadratic

    t^2 + b t + q = 0,   b = 2 d.(o - c),   q = |o - c|^2 - R^2

has the entry (-b - sqrt(b^2 - 4q))/2 and the exit (-b + sqrt(b^2 - 4q))/2.  A body is ahead if b < 0 and
the roots are real: for an origin outside this is the same as two positive roots, and at a contact, where
rounding may put the origin inside by 1e-15 mm, it still finds the neighbour without any epsilon.  The body
just left is excluded.  With the unit normal N against the ray, Snell's law for eta = n1/n2 reads

    d' = eta d + (eta cos_i - cos_t) N,   cos_i = -d.N,   cos_t^2 = 1 - eta^2 (1 - cos_i^2)

and Fresnel's transmittance of unpolarised light is 1 - (r_s^2 + r_p^2)/2 (Born and Wolf, ch. 1.5).
Only refracted rays are followed; what is reflected is lost, unless at a core everything is.

Vectors are three scalars each: numba keeps them in registers.  What stands in the world is one `World`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.jit import kernel

Float64 = NDArray[np.float64]

BLOCKED = 0.0
SOLID = 6  # numbers of a sphere before those of its cores


class World(NamedTuple):
    """Camera, bodies and sheet as arrays.

    Rows of `spheres`: centre, radius, n / n around, opaque, then cores, see `through_cores`, or what makes a ball
    uneven, see `sim.renderer.kernels.uneven`; of `walls` see `sim.renderer.kernels.walls`; of `bounds`: balls
    around bodies, x, y, z, radius; of `plane`: origin, x axis, y axis, normal.  `camera` see `camera_ray`.
    """

    camera: Float64
    spheres: Float64
    rods: Float64
    walls: Float64
    bounds: Float64
    plane: Float64


@kernel
def snell(
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float
) -> tuple[float, float, float, float]:
    """Refracted direction and transmittance at normal N (against the ray), eta = n1/n2; T = 0 beyond the limit."""
    cos_i = -(dx * nx + dy * ny + dz * nz)
    cos_t2 = 1.0 - eta * eta * (1.0 - cos_i * cos_i)
    if cos_t2 <= 0.0:
        return dx, dy, dz, BLOCKED
    cos_t = np.sqrt(cos_t2)
    along = eta * cos_i - cos_t
    # Amplitudes with n1 = eta, n2 = 1.
    rs = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    rp = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    transmitted = 1.0 - 0.5 * (rs * rs + rp * rp)
    return eta * dx + along * nx, eta * dy + along * ny, eta * dz + along * nz, transmitted


@kernel
def entry_sphere(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, centre: Float64, radius: float
) -> float:
    """Path length to the entry into a sphere ahead, infinity if missed or behind; `centre` begins with x, y, z."""
    x, y, z = ox - centre[0], oy - centre[1], oz - centre[2]
    b = 2.0 * (dx * x + dy * y + dz * z)
    discriminant = b * b - 4.0 * (x * x + y * y + z * z - radius * radius)
    if b >= 0.0 or discriminant <= 0.0:
        return float(np.inf)
    return float(0.5 * (-b - np.sqrt(discriminant)))


@kernel
def entry_rod(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, rod: Float64) -> float:
    """Path length to a rod ahead (cylinder with ball ends; row of the rod table), infinity if it is missed."""
    sx, sy, sz, ex, ey, ez, radius = rod[0], rod[1], rod[2], rod[3], rod[4], rod[5], rod[6]
    nearest = min(
        entry_sphere(ox, oy, oz, dx, dy, dz, rod, radius),
        entry_sphere(ox, oy, oz, dx, dy, dz, rod[3:], radius),
    )
    ax, ay, az = ex - sx, ey - sy, ez - sz
    length = np.sqrt(ax * ax + ay * ay + az * az)
    if length == 0.0:
        return float(nearest)
    ax, ay, az = ax / length, ay / length, az / length
    x, y, z = ox - sx, oy - sy, oz - sz
    d_along, o_along = dx * ax + dy * ay + dz * az, x * ax + y * ay + z * az
    px, py, pz = dx - d_along * ax, dy - d_along * ay, dz - d_along * az
    qx, qy, qz = x - o_along * ax, y - o_along * ay, z - o_along * az
    a = px * px + py * py + pz * pz
    b = 2.0 * (px * qx + py * qy + pz * qz)
    discriminant = b * b - 4.0 * a * (qx * qx + qy * qy + qz * qz - radius * radius)
    if b < 0.0 and discriminant > 0.0 and a > 0.0:
        t = (-b - np.sqrt(discriminant)) / (2.0 * a)
        if 0.0 <= o_along + t * d_along <= length:
            nearest = min(nearest, t)
    return float(nearest)


@kernel
def far_side(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, centre: Float64, radius: float
) -> tuple[float, float, float]:
    """Point at which a ray that is in a sphere leaves it: the far root."""
    x, y, z = ox - centre[0], oy - centre[1], oz - centre[2]
    b = 2.0 * (dx * x + dy * y + dz * z)
    discriminant = b * b - 4.0 * (x * x + y * y + z * z - radius * radius)
    t = 0.5 * (-b + np.sqrt(max(discriminant, 0.0)))
    return ox + t * dx, oy + t * dy, oz + t * dz


@kernel
def through_cores(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, s: Float64
) -> tuple[float, float, float, float, float, float, float]:
    """Follow a ray inside a sphere, surface by surface, until it is in the outermost layer and meets no core more.

    Row `s` goes on behind SOLID numbers with radius and n / n_ambient of each core, inwards; radius 0: no more.
    Returns point, direction and transmittance.  Total reflection at a core loses nothing.
    """
    transmittance, deep, n = 1.0, SOLID, s[4]  # `deep`: place of the next core in the row
    for _ in range(2 * s.shape[0]):
        t = np.inf
        if deep < s.shape[0] and s[deep] > 0.0:
            t = entry_sphere(ox, oy, oz, dx, dy, dz, s, s[deep])
        inwards = t < np.inf
        if not inwards and deep == SOLID:
            return ox, oy, oz, dx, dy, dz, transmittance
        if inwards:
            place, side, other = deep, 1.0, s[deep + 1]
            ox, oy, oz = ox + t * dx, oy + t * dy, oz + t * dz
        else:
            place, side = deep - 2, -1.0
            other = s[place - 1] if place > SOLID else s[4]
            ox, oy, oz = far_side(ox, oy, oz, dx, dy, dz, s, s[place])
        radius = side * s[place]
        nx, ny, nz = (ox - s[0]) / radius, (oy - s[1]) / radius, (oz - s[2]) / radius
        ex, ey, ez, part = snell(dx, dy, dz, nx, ny, nz, n / other)
        if part > BLOCKED:
            dx, dy, dz, n = ex, ey, ez, other
            transmittance *= part
            deep += 2 if inwards else -2
        else:
            along = 2.0 * (dx * nx + dy * ny + dz * nz)
            dx, dy, dz = dx - along * nx, dy - along * ny, dz - along * nz
    return ox, oy, oz, dx, dy, dz, BLOCKED
