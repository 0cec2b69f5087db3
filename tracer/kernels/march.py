"""One ray to the investigation plane: where it lands, with its light or with derivatives by the pixel."""

import math

from ground.jit import Array, kernel, kernel_composed, kernel_inlined
from tracer.kernels.camera import EYE_X, EYE_Y, EYE_Z, pixel_ray_tangents
from tracer.kernels.shaped import shaped_rates
from tracer.kernels.shell import with_cores_rates
from tracer.kernels.sphere import (
    CENTRE_X,
    CENTRE_Y,
    CENTRE_Z,
    INDEX,
    RADIUS,
    foot_tangent,
    through_rates,
    turned_tangent,
)
from tracer.kernels.walk import OTHER, SHAPED, TURNED, Crossing, keep_light, walk
from tracer.kernels.world import MISSED_PLANE, RECOVERED, World, rates_other

Tangents = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]


@kernel_inlined
def march(px: float, py: float, pz: float, dx: float, dy: float, dz: float, world: World) -> tuple[float, ...]:
    """Trace one ray from p along d.

    Returns status, point x, y, z, direction, optical path / n_ambient, transmittance, key, events.  The point
    is the plane point of a recovered ray, else the foot point of its last straight piece.
    """
    status, px, py, pz, dx, dy, dz, key, events, kept, index = walk(
        px, py, pz, dx, dy, dz, world, keep_light, (0.0, 1.0)
    )
    path, passed = kept
    if status != RECOVERED:
        return status, px, py, pz, dx, dy, dz, path, 0.0, key, events
    if not dz < 0.0:
        return MISSED_PLANE, px, py, pz, dx, dy, dz, path, passed, key, events
    t = -pz / dz
    return RECOVERED, px + t * dx, py + t * dy, 0.0, dx, dy, dz, path + t * index, passed, key, events


@kernel
def land(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float,
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    ux: float, uy: float, uz: float, vx: float, vy: float, vz: float,
) -> tuple[float, ...]:  # fmt: skip
    """Plane point x, y of the ray p + t d and dx/du, dx/dv, dy/du, dy/dv, from dp = (f, g), dd = (u, v)."""
    t = -pz / dz
    tu = -(fz + t * uz) / dz
    tv = -(gz + t * vz) / dz
    return (
        px + t * dx,
        py + t * dy,
        fx + tu * dx + t * ux,
        gx + tv * dx + t * vx,
        fy + tu * dy + t * uy,
        gy + tv * dy + t * vy,
    )


@kernel_composed
def keep_tangents(kept: Tangents, c: Crossing, world: World) -> Tangents:
    """Record the derivatives (f, g) of the foot point and (u, v) of the direction, and the transmittance.

    They go through the same turns as the ray itself.
    """
    fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed = kept
    passed = passed * c.light * c.share
    if len(world.others) > 0 and c.kind == OTHER:
        fx, fy, fz, ux, uy, uz = rates_other(
            c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, fx, fy, fz, ux, uy, uz, c.body, world.others, world.still, c.way
        )
        gx, gy, gz, vx, vy, vz = rates_other(
            c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, gx, gy, gz, vx, vy, vz, c.body, world.others, world.still, c.way
        )
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    if len(world.shapes) > 0 and c.kind == SHAPED:
        ball, shapes = world.spheres[c.body], world.shapes
        px, py, pz = c.wx + ball[CENTRE_X], c.wy + ball[CENTRE_Y], c.wz + ball[CENTRE_Z]
        fx, fy, fz, ux, uy, uz = shaped_rates(
            px, py, pz, c.dx, c.dy, c.dz, fx, fy, fz, ux, uy, uz, c.body, world.spheres, shapes
        )
        gx, gy, gz, vx, vy, vz = shaped_rates(
            px, py, pz, c.dx, c.dy, c.dz, gx, gy, gz, vx, vy, vz, c.body, world.spheres, shapes
        )
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    fx, fy, fz = foot_tangent(c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, c.m, fx, fy, fz, ux, uy, uz)
    gx, gy, gz = foot_tangent(c.wx, c.wy, c.wz, c.dx, c.dy, c.dz, c.m, gx, gy, gz, vx, vy, vz)
    if c.kind != TURNED:
        return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed
    ball = world.spheres[c.body]
    f_rate, g_rate = 2.0 * (c.ax * fx + c.ay * fy + c.az * fz), 2.0 * (c.ax * gx + c.ay * gy + c.az * gz)
    cosine_f, q_f = through_rates(c.b2, ball[RADIUS], ball[INDEX], c.cos_i, c.cos_t, f_rate, 0.0, 0.0)
    cosine_g, q_g = through_rates(c.b2, ball[RADIUS], ball[INDEX], c.cos_i, c.cos_t, g_rate, 0.0, 0.0)
    if c.way > 0:
        cosine_f, q_f = with_cores_rates(c.b2, ball, c.way, c.solid, c.solid_q, cosine_f, q_f, f_rate, 0.0)
        cosine_g, q_g = with_cores_rates(c.b2, ball, c.way, c.solid, c.solid_q, cosine_g, q_g, g_rate, 0.0)
    fx, fy, fz, ux, uy, uz = turned_tangent(
        c.ax, c.ay, c.az, c.dx, c.dy, c.dz, c.b2, c.cosine, c.q, fx, fy, fz, ux, uy, uz, f_rate, cosine_f, q_f
    )
    gx, gy, gz, vx, vy, vz = turned_tangent(
        c.ax, c.ay, c.az, c.dx, c.dy, c.dz, c.b2, c.cosine, c.q, gx, gy, gz, vx, vy, vz, g_rate, cosine_g, q_g
    )
    return fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed


@kernel
def march_pixel_tangents(u: float, v: float, camera: Array, world: World) -> tuple[float, ...]:
    """Trace the ray of acquired pixel (u, v) with its derivatives by u and v.

    Returns status, x, y, dx/du, dx/dv, dy/du, dy/dv, transmittance, key, events.
    """
    dx, dy, dz, ux, uy, uz, vx, vy, vz = pixel_ray_tangents(u, v, camera)
    begin = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ux, uy, uz, vx, vy, vz, 1.0)
    status, px, py, pz, dx, dy, dz, key, events, kept, _ = walk(
        camera[EYE_X], camera[EYE_Y], camera[EYE_Z], dx, dy, dz, world, keep_tangents, begin
    )
    if status == RECOVERED and not dz < 0.0:
        status = MISSED_PLANE
    if status != RECOVERED:
        nan = math.nan
        return status, nan, nan, nan, nan, nan, nan, 0.0, key, events
    fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz, passed = kept
    x, y, xu, xv, yu, yv = land(px, py, pz, dx, dy, dz, fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz)
    return RECOVERED, x, y, xu, xv, yu, yv, passed, key, events
