"""One ray from body to body to the investigation plane, without any epsilon.

Bodies are convex and disjoint (contact at most).  Three facts replace every tolerance:

* A ray that has left a body cannot meet it again on the same straight line, so the body just left is
  excluded by number, not by a minimum distance.  Any distance sends some rays near a contact astray.
* The chords that disjoint convex bodies cut from a line are disjoint, so their order is the order of any
  points inside them: foot points decide which body comes first; no entry point is computed.
  A ray that leaves a sphere is taken from its foot point in that sphere, which lies before every later chord.
* All bodies lie in front of the plane, so every hit comes before the plane.  The plane is asked last, and
  only whether the ray goes down; a sphere that touches the plane needs no special care.

``spheres`` is (N, 6): centre, radius, relative index, opaque, then the cores of spheres that have any
(``tracer.kernels.shell``); ``rods`` is (M, 7): see ``tracer.scene``.  The branch key is a 43-bit hash of the
sequence of events: spheres crossed, and the way through those with cores; 1 is the direct view.
"""

import math

from tracer.kernels._jit import Array, kernel, kernel_inlined
from tracer.kernels.bed import next_in_bed
from tracer.kernels.camera import pixel_ray_tangents
from tracer.kernels.rod import ROD, meets_rod
from tracer.kernels.shell import SOLID, event_at, with_cores, with_cores_rates
from tracer.kernels.sphere import (
    angles,
    foot,
    foot_tangent,
    through,
    through_rates,
    transmittance,
    turned,
    turned_tangent,
)

RECOVERED, BLOCKED, TIR, MISSED_PLANE, TOO_MANY_EVENTS = 0, 1, 2, 3, 4  # RayStatus, as plain integers
MAX_EVENTS = 64  # bodies crossed by one ray; a bed of a thousand spheres stays below 20
DIRECT = 1  # branch key of the direct view
KEY_MASK = (1 << 43) - 1  # with the factor below the product stays inside 63 bits


@kernel
def next_key(key: int, event: int) -> int:
    """Branch key after an event: crossing sphere number `event`, or one with cores, see `event_at`."""
    return (key * 1000003 + event + 2) & KEY_MASK


@kernel
def next_body(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, last: int, spheres: Array, rods: Array
) -> int:
    """Number of the sphere met next, ROD, or -1 for none; the half-line starts at p and `last` is excluded."""
    best = -1
    nearest = math.inf
    for i in range(spheres.shape[0]):
        if i != last:
            wx, wy, wz = px - spheres[i, 0], py - spheres[i, 1], pz - spheres[i, 2]
            m = -(wx * dx + wy * dy + wz * dz)
            if 0.0 < m < nearest:
                ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
                if ax * ax + ay * ay + az * az < spheres[i, 3] * spheres[i, 3]:
                    best, nearest = i, m
    for i in range(rods.shape[0]):
        t = meets_rod(px, py, pz, dx, dy, dz, rods[i])
        if t < nearest:
            best, nearest = ROD, t
    return best


@kernel_inlined
def march(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    spheres: Array,
    rods: Array,
    frame: Array,
    begin: Array,
    items: Array,
    trail: Array,
) -> tuple[float, ...]:
    """Trace one ray from p along d; through a grid of cells (``frame``, ``begin``, ``items``) if it is not empty.

    Returns status, point x, y, z, direction, optical path / n_ambient, transmittance, key, events.  The point
    is the plane point of a recovered ray, else the foot point of its last straight piece.  `trail`
    (MAX_EVENTS,) int32 receives the events: numbers of the spheres crossed, see `event_at`.
    """
    key, events = DIRECT, 0
    path, passed = 0.0, 1.0
    last = -1
    cored = spheres.shape[1] > SOLID
    while True:
        if items.shape[0] > 0:
            body = next_in_bed(px, py, pz, dx, dy, dz, last, spheres, rods, frame, begin, items)
        else:
            body = next_body(px, py, pz, dx, dy, dz, last, spheres, rods)
        if body == -1:
            break
        if body == ROD or spheres[body, 5] != 0.0:
            return BLOCKED, px, py, pz, dx, dy, dz, path, 0.0, key, events
        if events == MAX_EVENTS:
            return TOO_MANY_EVENTS, px, py, pz, dx, dy, dz, path, 0.0, key, events
        cx, cy, cz, radius, n = (
            spheres[body, 0],
            spheres[body, 1],
            spheres[body, 2],
            spheres[body, 3],
            spheres[body, 4],
        )
        m, ax, ay, az = foot(px - cx, py - cy, pz - cz, dx, dy, dz)
        b2 = ax * ax + ay * ay + az * az
        event = event_at(b2, body, spheres) if cored else body
        trail[events] = event
        key = next_key(key, event)
        events += 1
        if b2 < radius * radius:  # else rounding made a tangent of it: it passes
            if b2 >= n * n * radius * radius:
                return TIR, px, py, pz, dx, dy, dz, path, 0.0, key, events
            cos_i, cos_t = angles(b2, radius, n)
            surface = transmittance(cos_i, cos_t, n)
            passed *= surface * surface
            path += m + 2.0 * radius * (n * cos_t - cos_i)
            cosine, q = through(b2, radius, n, cos_i, cos_t)
            if cored and event != body:
                way = event // spheres.shape[0]
                cosine, q, more, share = with_cores(b2, spheres[body], way, cosine, q)
                path += more
                passed *= share
            ax, ay, az, dx, dy, dz = turned(ax, ay, az, dx, dy, dz, b2, cosine, q)
        else:
            path += m
        px, py, pz = cx + ax, cy + ay, cz + az
        last = body
    if not dz < 0.0:
        return MISSED_PLANE, px, py, pz, dx, dy, dz, path, passed, key, events
    t = -pz / dz
    return RECOVERED, px + t * dx, py + t * dy, 0.0, dx, dy, dz, path + t, passed, key, events


@kernel
def land(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    fx: float,
    fy: float,
    fz: float,
    gx: float,
    gy: float,
    gz: float,
    ux: float,
    uy: float,
    uz: float,
    vx: float,
    vy: float,
    vz: float,
) -> tuple[float, ...]:
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


@kernel
def march_pixel_tangents(
    u: float, v: float, camera: Array, spheres: Array, rods: Array, frame: Array, begin: Array, items: Array
) -> tuple[float, ...]:
    """Trace the ray of acquired pixel (u, v) with its derivatives by u and v; cells as for `march`.

    Returns status, x, y, dx/du, dx/dv, dy/du, dy/dv, transmittance, key, events.  The tangents of foot
    point and direction go through the same turns as the ray itself.
    """
    dx, dy, dz, ux, uy, uz, vx, vy, vz = pixel_ray_tangents(u, v, camera)
    px, py, pz = camera[0], camera[1], camera[2]
    fx = fy = fz = gx = gy = gz = 0.0  # derivatives of p by u and by v
    key, events = DIRECT, 0
    passed = 1.0
    last = -1
    nan = math.nan
    while True:
        if items.shape[0] > 0:
            body = next_in_bed(px, py, pz, dx, dy, dz, last, spheres, rods, frame, begin, items)
        else:
            body = next_body(px, py, pz, dx, dy, dz, last, spheres, rods)
        if body == -1:
            break
        if body == ROD or spheres[body, 5] != 0.0:
            return BLOCKED, nan, nan, nan, nan, nan, nan, 0.0, key, events
        if events == MAX_EVENTS:
            return TOO_MANY_EVENTS, nan, nan, nan, nan, nan, nan, 0.0, key, events
        cx, cy, cz, radius, n = (
            spheres[body, 0],
            spheres[body, 1],
            spheres[body, 2],
            spheres[body, 3],
            spheres[body, 4],
        )
        wx, wy, wz = px - cx, py - cy, pz - cz
        m, ax, ay, az = foot(wx, wy, wz, dx, dy, dz)
        b2 = ax * ax + ay * ay + az * az
        event = event_at(b2, body, spheres)
        key = next_key(key, event)
        events += 1
        fx, fy, fz = foot_tangent(wx, wy, wz, dx, dy, dz, m, fx, fy, fz, ux, uy, uz)
        gx, gy, gz = foot_tangent(wx, wy, wz, dx, dy, dz, m, gx, gy, gz, vx, vy, vz)
        if b2 < radius * radius:
            if b2 >= n * n * radius * radius:
                return TIR, nan, nan, nan, nan, nan, nan, 0.0, key, events
            cos_i, cos_t = angles(b2, radius, n)
            surface = transmittance(cos_i, cos_t, n)
            passed *= surface * surface
            cosine, q = through(b2, radius, n, cos_i, cos_t)
            f_rate, g_rate = 2.0 * (ax * fx + ay * fy + az * fz), 2.0 * (ax * gx + ay * gy + az * gz)
            cosine_f, q_f = through_rates(b2, radius, n, cos_i, cos_t, f_rate, 0.0, 0.0)
            cosine_g, q_g = through_rates(b2, radius, n, cos_i, cos_t, g_rate, 0.0, 0.0)
            if event != body:
                ball, way = spheres[body], event // spheres.shape[0]
                cosine_f, q_f = with_cores_rates(b2, ball, way, cosine, q, cosine_f, q_f, f_rate, 0.0)
                cosine_g, q_g = with_cores_rates(b2, ball, way, cosine, q, cosine_g, q_g, g_rate, 0.0)
                cosine, q, _, share = with_cores(b2, ball, way, cosine, q)
                passed *= share
            fx, fy, fz, ux, uy, uz = turned_tangent(
                ax, ay, az, dx, dy, dz, b2, cosine, q, fx, fy, fz, ux, uy, uz, f_rate, cosine_f, q_f
            )
            gx, gy, gz, vx, vy, vz = turned_tangent(
                ax, ay, az, dx, dy, dz, b2, cosine, q, gx, gy, gz, vx, vy, vz, g_rate, cosine_g, q_g
            )
            ax, ay, az, dx, dy, dz = turned(ax, ay, az, dx, dy, dz, b2, cosine, q)
        px, py, pz = cx + ax, cy + ay, cz + az
        last = body
    if not dz < 0.0:
        return MISSED_PLANE, nan, nan, nan, nan, nan, nan, 0.0, key, events
    x, y, xu, xv, yu, yv = land(px, py, pz, dx, dy, dz, fx, fy, fz, gx, gy, gz, ux, uy, uz, vx, vy, vz)
    return RECOVERED, x, y, xu, xv, yu, yv, passed, key, events
