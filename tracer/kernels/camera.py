"""Pixels to rays.

The camera arrives as one array (20,): the pinhole; its own axes in the world, which are the rows of the rotation
(right, down, ahead); focal_px; principal pixel; lens terms (acquired -> ideal, equations in ``tracer.camera``).
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.vectors import Vector, dot, move, scale, vector_at

EYE_X, EYE_Y, EYE_Z = 0, 1, 2
RIGHT_X, RIGHT_Y, RIGHT_Z, DOWN_X, DOWN_Y, DOWN_Z, AHEAD_X, AHEAD_Y, AHEAD_Z = range(3, 12)
FOCAL, CENTRE_U, CENTRE_V = 12, 13, 14
K1, K2, K3, P1, P2 = range(15, 20)


@kernel_inlined
def axes_of(camera: Array) -> tuple[float, ...]:
    """The camera's axes in the world: right x, y, z, down x, y, z, ahead x, y, z."""
    right = camera[RIGHT_X], camera[RIGHT_Y], camera[RIGHT_Z]
    down = camera[DOWN_X], camera[DOWN_Y], camera[DOWN_Z]
    return (*right, *down, camera[AHEAD_X], camera[AHEAD_Y], camera[AHEAD_Z])


@kernel_inlined
def lens_of(camera: Array) -> tuple[float, ...]:
    """Terms of the lens: k1, k2, k3, p1, p2."""
    return camera[K1], camera[K2], camera[K3], camera[P1], camera[P2]


@kernel_inlined
def undistort(
    x: float, y: float, k1: float, k2: float, k3: float, p1: float, p2: float
) -> tuple[float, float, float, float]:
    """Ideal image coordinates of acquired ones, the radial factor and its derivative by r^2."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    a = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    b = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return a, b, radial, slope


@kernel
def ideal_xy(u: float, v: float, camera: Array) -> tuple[float, ...]:
    """Ideal image coordinates x, y in units of the focal length, and their derivatives by u and v."""
    focal = camera[FOCAL]
    x, y = (u - camera[CENTRE_U]) / focal, (v - camera[CENTRE_V]) / focal
    k1, k2, k3, p1, p2 = lens_of(camera)
    if k1 == 0.0 and k2 == 0.0 and k3 == 0.0 and p1 == 0.0 and p2 == 0.0:
        return x, y, 1.0 / focal, 0.0, 0.0, 1.0 / focal
    ideal_x, ideal_y, radial, slope = undistort(x, y, k1, k2, k3, p1, p2)
    xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return ideal_x, ideal_y, xx / focal, xy / focal, xy / focal, yy / focal


@kernel
def ideal_row(row: int, camera: Array, x: Array, y: Array) -> None:
    """Ideal image coordinates x, y (W,) of all pixels of a row, in units of the focal length."""
    focal, centre, level = camera[FOCAL], camera[CENTRE_U], (row - camera[CENTRE_V]) / camera[FOCAL]
    k1, k2, k3, p1, p2 = lens_of(camera)
    for i in range(x.shape[0]):
        a, b, _, _ = undistort((i - centre) / focal, level, k1, k2, k3, p1, p2)
        x[i], y[i] = a, b


@kernel_inlined
def eye_of(camera: Array) -> Vector:
    """Place of the pinhole."""
    return vector_at(camera, EYE_X)


@kernel
def to_world(x: float, y: float, z: float, camera: Array) -> Vector:
    """World components of a camera vector."""
    return (
        camera[RIGHT_X] * x + camera[DOWN_X] * y + camera[AHEAD_X] * z,
        camera[RIGHT_Y] * x + camera[DOWN_Y] * y + camera[AHEAD_Y] * z,
        camera[RIGHT_Z] * x + camera[DOWN_Z] * y + camera[AHEAD_Z] * z,
    )


@kernel
def pixel_ray(u: float, v: float, camera: Array) -> Vector:
    """Unit direction of the ray through acquired pixel (u, v)."""
    x, y, _, _, _, _ = ideal_xy(u, v, camera)
    norm = 1.0 / math.sqrt(x * x + y * y + 1.0)
    return to_world(x * norm, y * norm, norm, camera)


@kernel
def unit_tangent(d: Vector, norm: float, e: Vector) -> Vector:
    """Derivative of v/|v| when v = d / norm changes by e: the part of e across d, scaled."""
    return scale(norm, move(e, -dot(d, e), d))


@kernel
def pixel_ray_tangents(u: float, v: float, camera: Array) -> tuple[Vector, Vector, Vector]:
    """Unit direction through (u, v) and its derivatives by u and by v."""
    x, y, xu, xv, yu, yv = ideal_xy(u, v, camera)
    norm = 1.0 / math.sqrt(x * x + y * y + 1.0)
    d = to_world(x * norm, y * norm, norm, camera)
    by_u = unit_tangent(d, norm, to_world(xu, yu, 0.0, camera))
    return d, by_u, unit_tangent(d, norm, to_world(xv, yv, 0.0, camera))
