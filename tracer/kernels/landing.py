"""Landing points on a target plane with their derivatives by every number of the scene.

The backward sweep ends at the pinhole with f = ds/dorigin and g = ds/ddirection for
each landing coordinate s.  The camera's part is closed form, because the pinhole ray is d = Rot(w) R^T v/|v|
with v = (a, b, 1) and (a, b) the ideal image point of the acquired (x, y):

    ds/dw = d x g,    h = ds/d(a, b) = (c - (c . v) v/|v|^2) / |v| with c = R g,    ds/d(x, y) = h d(a, b)/d(x, y)

and the target's follows from the last straight piece: moving the target's material points by D changes the
landing point on it as moving the ray by -D does, of which the part along the ray counts for nothing.

A row of ``rate`` holds camera (14: x, y, z, rx, ry, rz, focal_px, cu, cv, k1, k2, k3, p1, p2) | 5 of each
sphere (x, y, z, radius, n) | the row of each other body whose kind has `Kind.numbers`, table by table | target (6:
x, y, z, rx, ry, rz); turns are about the world's axes [rad].  What the shapes of balls out of round do stands in
``by_shape``, of no rows where none is.

**The sweep.**  Forwards a ray is a chain of turns (``tracer.kernels.sphere``); for a few outputs and many
parameters the chain rule is cheapest backwards.  The landing point has two coordinates, so two adjoint pairs
(p_bar, d_bar) = d(coordinate)/d(p, d) travel from the plane back to the pinhole.  Through one sphere, with w = p -
c, m = -w . d, a = w + m d, beta = a . a, C and q the turn, a' = C a + beta q d, d' = C d - q a:

    C_bar = a'_bar . a + d'_bar . d          along_bar = a'_bar . d
    q_bar = along_bar beta - d'_bar . a      beta_bar = along_bar q + C_bar C_beta + q_bar q_beta
    a_bar = C a'_bar - q d'_bar + 2 beta_bar a
    d_bar = beta q a'_bar + C d'_bar + m a_bar - (a_bar . d) w
    w_bar = a_bar - (a_bar . d) d
    R_bar = C_bar C_R + q_bar q_R            n_bar = C_bar C_n + q_bar q_n
    p_bar = w_bar                            c_bar = a'_bar - w_bar

Cost: about two tangents, whatever the number of parameters.

A tangent by rounding (``tracer.kernels.march``) passes: C = 1, q = 0 and nothing depends on the sphere.  A body of
another kind gives derivatives forwards only (`Kind.rates`); one sweep through it takes six of them, and one more
for each of its own numbers.
"""

import math
from typing import Any

from ground.jit import Array, kernel, kernel_composed
from tracer.kernels.ball import back_through_shaped, is_shaped
from tracer.kernels.branches import NOTHING, body_of
from tracer.kernels.camera import (
    AHEAD_X,
    AHEAD_Y,
    AHEAD_Z,
    CENTRE_U,
    CENTRE_V,
    DOWN_X,
    DOWN_Y,
    DOWN_Z,
    EYE_X,
    EYE_Y,
    EYE_Z,
    FOCAL,
    K1,
    K2,
    K3,
    P1,
    P2,
    RIGHT_X,
    RIGHT_Y,
    RIGHT_Z,
    undistorted,
)
from tracer.kernels.march import Crossing, walk
from tracer.kernels.sphere import INDEX, RADIUS, angles, through, through_rates, with_cores, with_cores_rates
from tracer.kernels.world import (
    MISSED_PLANE,
    RECOVERED,
    World,
    place_of_other,
    rates_other,
)

STATE = 8  # w, d, m, b2 of each body crossed
AXES, NORMAL = 3, 9  # of a target: where they begin after its origin
CAMERA_NUMBERS, SPHERE_NUMBERS, TARGET_NUMBERS = 14, 5, 6


@kernel_composed
def keep_states(kept: tuple[Array, Array], c: Crossing, world: World) -> tuple[Array, Array]:
    """Record what the way back needs: trail (MAX_EVENTS,) int32, state (MAX_EVENTS, STATE)."""
    trail, state = kept
    at = c.place
    trail[at] = c.event
    state[at, 0], state[at, 1], state[at, 2] = c.wx, c.wy, c.wz
    state[at, 3], state[at, 4], state[at, 5] = c.dx, c.dy, c.dz
    state[at, 6], state[at, 7] = c.m, c.b2
    return kept


@kernel
def trace_states(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, world: World, trail: Array, state: Array
) -> tuple[Any, ...]:  # fmt: skip
    """Trace one ray from p along d as `walk`, and keep its states."""
    status, px, py, pz, dx, dy, dz, key, events, _, _ = walk(
        px, py, pz, dx, dy, dz, world, keep_states, (trail, state)
    )
    return status, px, py, pz, dx, dy, dz, key, events


@kernel
def back_through_other(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, body: int, way: int,
    world: World, state: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry one adjoint pair (f, g) of (p', d') back through a body of another kind."""
    px, py, pz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    back = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(6):
        a, b, c = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0
        e, f, g = 1.0 if k == 3 else 0.0, 1.0 if k == 4 else 0.0, 1.0 if k == 5 else 0.0
        x, y, z, u, v, w = rates_other(
            px, py, pz, dx, dy, dz, a, b, c, e, f, g, body, world.others, world.still, way
        )
        rate = fx * x + fy * y + fz * z + gx * u + gy * v + gz * w
        back = (
            rate if k == 0 else back[0],
            rate if k == 1 else back[1],
            rate if k == 2 else back[2],
            rate if k == 3 else back[3],
            rate if k == 4 else back[4],
            rate if k == 5 else back[5],
        )
    return back


@kernel
def back_to_row(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float, body: int, way: int,
    world: World, state: Array, move: Array, out: Array,
) -> None:  # fmt: skip
    """Add what a body of another kind has of one adjoint pair by each number of its row to out (W,).

    move (MOST_NUMBERS,) scratch, all zeros before and after.
    """
    px, py, pz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    for k in range(out.shape[0]):
        move[k] = 1.0
        x, y, z, u, v, w = rates_other(
            px, py, pz, dx, dy, dz, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, body, world.others, move, way
        )
        out[k] += fx * x + fy * y + fz * z + gx * u + gy * v + gz * w
        move[k] = 0.0


@kernel
def back_through(
    fx: float, fy: float, fz: float, gx: float, gy: float, gz: float,
    sphere: Array, way: int, state: Array, out: Array,
) -> tuple[float, ...]:  # fmt: skip
    """Carry one adjoint pair (f, g) of (a', d') back through a sphere; add c_bar, R_bar, n_bar to out (5,).

    `way` through its cores, which are held fixed (``tracer.kernels.sphere``).
    """
    wx, wy, wz, dx, dy, dz = state[0], state[1], state[2], state[3], state[4], state[5]
    m, b2 = state[6], state[7]
    radius, n = sphere[RADIUS], sphere[INDEX]
    if not b2 < radius * radius:
        return fx, fy, fz, gx + m * fx, gy + m * fy, gz + m * fz
    ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
    cos_i, cos_t = angles(b2, radius, n)
    solid, solid_q = through(b2, radius, n, cos_i, cos_t)
    cosine, q = solid, solid_q
    if way > 0:
        cosine, q, _, _ = with_cores(b2, sphere, way, solid, solid_q)
    cosine_bar = fx * ax + fy * ay + fz * az + gx * dx + gy * dy + gz * dz
    along_bar = fx * dx + fy * dy + fz * dz
    q_bar = along_bar * b2 - (gx * ax + gy * ay + gz * az)
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 1.0, 0.0, 0.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 1.0, 0.0)
    b2_bar = along_bar * q + cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 0.0, 1.0, 0.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 0.0, 0.0)
    out[3] += cosine_bar * cosine_rate + q_bar * q_rate
    cosine_rate, q_rate = through_rates(b2, radius, n, cos_i, cos_t, 0.0, 0.0, 1.0)
    if way > 0:
        cosine_rate, q_rate = with_cores_rates(b2, sphere, way, solid, solid_q, cosine_rate, q_rate, 0.0, 1.0)
    out[4] += cosine_bar * cosine_rate + q_bar * q_rate
    hx = cosine * fx - q * gx + 2.0 * b2_bar * ax
    hy = cosine * fy - q * gy + 2.0 * b2_bar * ay
    hz = cosine * fz - q * gz + 2.0 * b2_bar * az
    h = hx * dx + hy * dy + hz * dz
    ux, uy, uz = hx - h * dx, hy - h * dy, hz - h * dz
    out[0] += fx - ux
    out[1] += fy - uy
    out[2] += fz - uz
    along = b2 * q
    return (
        ux,
        uy,
        uz,
        along * fx + cosine * gx + m * hx - h * wx,
        along * fy + cosine * gy + m * hy - h * wy,
        along * fz + cosine * gz + m * hz - h * wz,
    )


@kernel
def land_on_target(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, target: Array, axis: int
) -> tuple[float, ...]:
    """Target coordinate of p + t d along target axis 0 or 1, t, and the adjoints p_bar, d_bar of that coordinate.

    ``target`` (12,): origin, first axis, second axis, normal (orthonormal).
    """
    ex, ey, ez = target[AXES + 3 * axis], target[AXES + 3 * axis + 1], target[AXES + 3 * axis + 2]
    nx, ny, nz = target[NORMAL], target[NORMAL + 1], target[NORMAL + 2]
    qx, qy, qz = px - target[0], py - target[1], pz - target[2]
    slope = dx * nx + dy * ny + dz * nz
    t = -(qx * nx + qy * ny + qz * nz) / slope
    value = (qx + t * dx) * ex + (qy + t * dy) * ey + (qz + t * dz) * ez
    k = (dx * ex + dy * ey + dz * ez) / slope
    fx, fy, fz = ex - k * nx, ey - k * ny, ez - k * nz
    return value, t, fx, fy, fz, t * fx, t * fy, t * fz


@kernel
def camera_rates(
    u: float, v: float, camera: Array, dx: float, dy: float, dz: float, gx: float, gy: float, gz: float,
    by_pixel: Array, row: Array,
) -> None:  # fmt: skip
    """Derivatives of one landing coordinate by rotation, focal length, centre and lens, from g = ds/ddirection.

    camera (20,) as in `tracer.kernels.camera`; (dx, dy, dz) the ray's direction; by_pixel (2,) out; row (14,)
    out, of which the first three are left alone.
    """
    focal = camera[FOCAL]
    x, y = (u - camera[CENTRE_U]) / focal, (v - camera[CENTRE_V]) / focal
    p1, p2 = camera[P1], camera[P2]
    a, b, radial, slope = undistorted(x, y, camera[K1], camera[K2], camera[K3], p1, p2)
    row[3], row[4], row[5] = dy * gz - dz * gy, dz * gx - dx * gz, dx * gy - dy * gx
    cx = camera[RIGHT_X] * gx + camera[RIGHT_Y] * gy + camera[RIGHT_Z] * gz
    cy = camera[DOWN_X] * gx + camera[DOWN_Y] * gy + camera[DOWN_Z] * gz
    cz = camera[AHEAD_X] * gx + camera[AHEAD_Y] * gy + camera[AHEAD_Z] * gz
    square = a * a + b * b + 1.0
    length, along = math.sqrt(square), (cx * a + cy * b + cz) / square
    hx, hy = (cx - along * a) / length, (cy - along * b) / length
    mixed = 2.0 * (x * y * slope + p1 * x + p2 * y)
    by_x = hx * (radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x) + hy * mixed
    by_y = hy * (radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x) + hx * mixed
    by_pixel[0], by_pixel[1] = by_x / focal, by_y / focal
    row[6], row[7], row[8] = -(by_x * x + by_y * y) / focal, -by_x / focal, -by_y / focal
    r2, outward = x * x + y * y, hx * x + hy * y
    row[9], row[10], row[11] = outward * r2, outward * r2 * r2, outward * r2 * r2 * r2
    row[12] = 2.0 * hx * x * y + hy * (r2 + 2.0 * y * y)
    row[13] = hx * (r2 + 2.0 * x * x) + 2.0 * hy * x * y


@kernel
def trace_landings(
    pixels: Array, directions: Array, camera: Array, world: World, target: Array, n_ambient: float,
    first: int, last: int, trail: Array, state: Array, move: Array, status: Array, key: Array, point: Array, by_pixel: Array,
    rate: Array, by_shape: Array,
) -> None:  # fmt: skip
    """Trace pixels first..last-1 onto a target plane with all derivatives.

    pixels (N, 2); directions (N, 3) of their rays; camera (20,); target (12,) origin and axes; trail
    (MAX_EVENTS,) int32 and state (MAX_EVENTS, STATE) scratch; status (N,) uint8, key (N,) int64, point (N, 2)
    target coordinates, by_pixel (N, 2, 2), rate (N, 2, 14 + 5 S + W + 6) out, or with W = 0 where no call asks for
    the other bodies' numbers; by_shape (N, 2, S, 50), or (0, 2, S, 50) where all spheres are round.  NaN unless
    recovered.
    """
    spheres = world.spheres
    of_others = CAMERA_NUMBERS + SPHERE_NUMBERS * spheres.shape[0]
    place = rate.shape[2] - TARGET_NUMBERS
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    for i in range(first, last):
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        s, px, py, pz, wx, wy, wz, k, events, _, _ = walk(
            ox, oy, oz, dx, dy, dz, world, keep_states, (trail, state)
        )
        if s == RECOVERED and not wx * target[NORMAL] + wy * target[NORMAL + 1] + wz * target[NORMAL + 2] < 0.0:
            s = MISSED_PLANE
        status[i], key[i] = s, k
        if s != RECOVERED:
            point[i] = math.nan
            by_pixel[i] = math.nan
            rate[i] = math.nan
            if len(world.shapes) > 0:
                by_shape[i] = math.nan
            continue
        for axis in range(2):
            value, t, fx, fy, fz, gx, gy, gz = land_on_target(px, py, pz, wx, wy, wz, target, axis)
            row = rate[i, axis]
            point[i, axis] = value
            ax, ay, az = px + t * wx - target[0], py + t * wy - target[1], pz + t * wz - target[2]
            row[place], row[place + 1], row[place + 2] = -fx, -fy, -fz
            row[place + 3], row[place + 4] = -(ay * fz - az * fy), -(az * fx - ax * fz)
            row[place + 5] = -(ax * fy - ay * fx)
            row[CAMERA_NUMBERS:place] = 0.0
            if len(world.shapes) > 0:
                by_shape[i, axis] = 0.0
            for event in range(int(events) - 1, -1, -1):
                body, way = body_of(trail[event], spheres)
                if len(world.others) > 0 and body < NOTHING:
                    at, width = place_of_other(body, world.others, of_others)
                    if at + width <= place:
                        numbers = row[at : at + width]
                        back_to_row(fx, fy, fz, gx, gy, gz, body, way, world, state[event], move, numbers)
                    fx, fy, fz, gx, gy, gz = back_through_other(
                        fx, fy, fz, gx, gy, gz, body, way, world, state[event]
                    )
                    continue
                at = CAMERA_NUMBERS + SPHERE_NUMBERS * body
                if len(world.shapes) > 0 and is_shaped(world.shapes, body):
                    fx, fy, fz, gx, gy, gz = back_through_shaped(
                        fx, fy, fz, gx, gy, gz, state[event], body, spheres, world.shapes,
                        row[at : at + SPHERE_NUMBERS], by_shape[i, axis, body],
                    )  # fmt: skip
                    continue
                fx, fy, fz, gx, gy, gz = back_through(
                    fx, fy, fz, gx, gy, gz, spheres[body], way, state[event], row[at : at + SPHERE_NUMBERS]
                )
            for k in range(spheres.shape[0]):
                around = n_ambient
                if world.rooms.home.shape[0] > 0:
                    around *= world.rooms.n[world.rooms.home[k]]
                row[CAMERA_NUMBERS + SPHERE_NUMBERS * k + 4] /= around
            row[0], row[1], row[2] = fx, fy, fz
            camera_rates(pixels[i, 0], pixels[i, 1], camera, dx, dy, dz, gx, gy, gz, by_pixel[i, axis], row)
