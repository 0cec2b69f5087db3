"""Landing points on a target plane with their derivatives by every number of the scene.

The backward sweep (`tracer.kernels.adjoint`) ends at the pinhole with f = ds/dorigin and g = ds/ddirection for
each landing coordinate s.  The camera's part is closed form, because the pinhole ray is d = Rot(w) R^T v/|v|
with v = (a, b, 1) and (a, b) the ideal image point of the acquired (x, y):

    ds/dw = d x g,    h = ds/d(a, b) = (c - (c . v) v/|v|^2) / |v| with c = R g,    ds/d(x, y) = h d(a, b)/d(x, y)

and the target's follows from the last straight piece: moving the target's material points by D changes the
landing point on it as moving the ray by -D does, of which the part along the ray counts for nothing.

A row of ``rate`` holds camera (14: x, y, z, rx, ry, rz, focal_px, cu, cv, k1, k2, k3, p1, p2) | 5 of each
sphere (x, y, z, radius, n) | the row of each other body whose kind has `Kind.numbers`, table by table | target (6:
x, y, z, rx, ry, rz); turns are about the world's axes [rad].  What the shapes of balls out of round do stands in
``by_shape``, of no rows where none is.
"""

import math

import numpy as np

from ground.jit import Array, kernel, unowned
from tracer.kernels.adjoint import (
    NORMAL,
    back_through,
    back_through_other,
    back_to_row,
    keep_states,
    land_on_target,
)
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
from tracer.kernels.shaped import back_through_shaped, is_shaped
from tracer.kernels.walk import walk
from tracer.kernels.world import MISSED_PLANE, MOST_NUMBERS, RECOVERED, World, place_of_other, unowned_world

CAMERA_NUMBERS, SPHERE_NUMBERS, TARGET_NUMBERS = 14, 5, 6


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
    first: int, last: int, trail: Array, state: Array, status: Array, key: Array, point: Array, by_pixel: Array,
    rate: Array, by_shape: Array,
) -> None:  # fmt: skip
    """Trace pixels first..last-1 onto a target plane with all derivatives.

    pixels (N, 2); directions (N, 3) of their rays; camera (20,); target (12,) origin and axes; trail
    (MAX_EVENTS,) int32 and state (MAX_EVENTS, STATE) scratch; status (N,) uint8, key (N,) int64, point (N, 2)
    target coordinates, by_pixel (N, 2, 2), rate (N, 2, 14 + 5 S + W + 6) out, or with W = 0 where nobody asks for
    the other bodies' numbers; by_shape (N, 2, S, 50), or (0, 2, S, 50) where all spheres are round.  NaN unless
    recovered.
    """
    world, trail, state = unowned_world(world), unowned(trail), unowned(state)
    point, by_pixel, rate = unowned(point), unowned(by_pixel), unowned(rate)
    spheres = world.spheres
    of_others = CAMERA_NUMBERS + SPHERE_NUMBERS * spheres.shape[0]
    place = rate.shape[2] - TARGET_NUMBERS
    move = np.zeros(MOST_NUMBERS if len(world.others) > 0 else 0)
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
