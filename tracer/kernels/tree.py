"""All branches of a ray: reflected at every surface as well as refracted, depth first.

At a sphere a ray of weight w, surface transmittance T and reflectance R = 1 - T splits into

    outside     w R          turned by 2 i - pi
    k inside    w T^2 R^k    turned by 2 (i - t) + k (pi - 2 t),   k = 0, 1, 2, ... (0: straight passage)

of the same foot point and direction (``tracer.kernels.sphere``); with b = |a|, sin t = b / (n R_s):

    2 i - pi:   cos = 2 b^2/R_s^2 - 1,         q = -2 cos i / R_s          (b q = sin)
    pi - 2 t:   cos = 2 b^2/(n R_s)^2 - 1,     q = 2 cos t / (n R_s).

The weights add up to w, so whatever is not followed is known: the rest of the inner series from k on is
w T R^k.  A child lighter than the threshold is dropped with all that would come of it.  From the critical
angle on (n < 1), all light is reflected outside.

The foot point of a ray reflected outside lies inside the sphere, before every later chord, so the rules of
``tracer.kernels.march`` hold: the body just left is excluded, the plane is asked last.

Frames on the stack, one a split: FRAME floats and FRAME_BODY integers.  Events on the trail are pairs
(sphere, kind): kind OUTSIDE or the number k of inner reflections.
"""

from tracer.kernels._jit import Array, kernel
from tracer.kernels.march import MAX_EVENTS, next_body
from tracer.kernels.rod import ROD
from tracer.kernels.sphere import angles, foot, through, transmittance, turned

OUTSIDE = -1
MAX_STEPS = 100_000  # straight pieces followed for one ray; then its remaining light is given up and counted
FRAME, FRAME_BODY = 19, 3
LANDED, ESCAPED, BLOCKED_LIGHT, DROPPED, GIVEN_UP = 0, 1, 2, 3, 4  # where the light went


@kernel
def split(
    wx: float,
    wy: float,
    wz: float,
    dx: float,
    dy: float,
    dz: float,
    weight: float,
    radius: float,
    n: float,
    frame: Array,
) -> bool:
    """Fill `frame` with the children of a ray from w relative to a centre; False if rounding made it a tangent.

    Frame: 0-5 foot point and direction of the next inner child, 6-8 inner turn cos, q and b^2, 9 weight of
    that child, 10 reflectance, 11 light in it and all after it, 12-17 foot point and direction of the child
    reflected outside, 18 its weight.  A tangent leaves its foot point in 0-2.
    """
    _, ax, ay, az = foot(wx, wy, wz, dx, dy, dz)
    b2 = ax * ax + ay * ay + az * az
    frame[0], frame[1], frame[2] = ax, ay, az
    if b2 >= radius * radius:
        return False
    cos_i, cos_t = angles(b2, radius, n)
    chi = b2 / (radius * radius)
    total = b2 >= n * n * radius * radius
    passes = 0.0 if total else transmittance(cos_i, cos_t, n)
    reflects = max(0.0, 1.0 - passes)
    rx, ry, rz, ex, ey, ez = turned(ax, ay, az, dx, dy, dz, b2, 2.0 * chi - 1.0, -2.0 * cos_i / radius)
    frame[12], frame[13], frame[14], frame[15], frame[16], frame[17] = rx, ry, rz, ex, ey, ez
    frame[18] = weight * reflects
    frame[9], frame[10], frame[11] = weight * passes * passes, reflects, weight * passes
    if not total:
        cosine, q = through(b2, radius, n, cos_i, cos_t)
        ax, ay, az, dx, dy, dz = turned(ax, ay, az, dx, dy, dz, b2, cosine, q)
    frame[0], frame[1], frame[2], frame[3], frame[4], frame[5] = ax, ay, az, dx, dy, dz
    frame[6], frame[7], frame[8] = 2.0 * chi / (n * n) - 1.0, 2.0 * cos_t / (n * radius), b2
    return True


@kernel
def follow_tree(
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    spheres: Array,
    rods: Array,
    threshold: float,
    pixel: int,
    fill: bool,
    frames: Array,
    stack: Array,
    trail: Array,
    light: Array,
    records: Array,
    codes: Array,
    first_record: int,
    first_code: int,
) -> tuple[int, int]:
    """Follow every branch of one ray; returns the records and event pairs it has.

    Scratch: `frames` (MAX_EVENTS, FRAME) float64, `stack` (MAX_EVENTS, FRAME_BODY) int32 (sphere, next
    child, events before), `trail` (MAX_EVENTS, 2) int32.  `light` (5,) receives where the light went.  With
    `fill`, branches that land go to `records` (reflections.BRANCH) from `first_record` on and their events to
    `codes` (., 2) int32 from `first_code` on; else they are only counted.
    """
    light[:] = 0.0
    level = events = found = used = steps = 0
    weight = 1.0
    last = -1
    while True:
        steps += 1
        body = next_body(px, py, pz, dx, dy, dz, last, spheres, rods)
        if body == -1:
            if dz < 0.0:
                if fill:
                    record = first_record + found
                    t = -pz / dz
                    records[record].pixel = pixel
                    records[record].x_mm = px + t * dx
                    records[record].y_mm = py + t * dy
                    records[record].transmittance = weight
                    records[record].first = first_code + used
                    records[record].events = events
                    for i in range(events):
                        codes[first_code + used + i, 0] = trail[i, 0]
                        codes[first_code + used + i, 1] = trail[i, 1]
                found += 1
                used += events
                light[LANDED] += weight
            else:
                light[ESCAPED] += weight
        elif body == ROD or spheres[body, 5] != 0.0:
            light[BLOCKED_LIGHT] += weight
        elif events == MAX_EVENTS or steps > MAX_STEPS:
            light[GIVEN_UP] += weight
        else:
            cx, cy, cz = spheres[body, 0], spheres[body, 1], spheres[body, 2]
            trail[events, 0] = body
            trail[events, 1] = 0
            frame = frames[level]
            if not split(px - cx, py - cy, pz - cz, dx, dy, dz, weight, spheres[body, 3], spheres[body, 4], frame):
                px, py, pz = cx + frame[0], cy + frame[1], cz + frame[2]
                last = body
                events += 1
                continue
            stack[level, 0], stack[level, 1], stack[level, 2] = body, OUTSIDE, events
            level += 1
        taken = False
        while level > 0 and not taken:
            frame = frames[level - 1]
            last, kind, events = stack[level - 1, 0], stack[level - 1, 1], stack[level - 1, 2]
            lost = GIVEN_UP if steps > MAX_STEPS else DROPPED
            cx, cy, cz = spheres[last, 0], spheres[last, 1], spheres[last, 2]
            trail[events, 0] = last
            trail[events, 1] = kind
            stack[level - 1, 1] = kind + 1
            if kind == OUTSIDE:
                weight = frame[18]
                taken = weight >= threshold and steps <= MAX_STEPS
                if not taken:
                    light[lost] += weight
                px, py, pz = cx + frame[12], cy + frame[13], cz + frame[14]
                dx, dy, dz = frame[15], frame[16], frame[17]
                continue
            weight = frame[9]
            taken = weight >= threshold and steps <= MAX_STEPS
            if not taken:
                light[lost] += frame[11]
                level -= 1
                continue
            px, py, pz = cx + frame[0], cy + frame[1], cz + frame[2]
            dx, dy, dz = frame[3], frame[4], frame[5]
            frame[0], frame[1], frame[2], frame[3], frame[4], frame[5] = turned(
                frame[0], frame[1], frame[2], dx, dy, dz, frame[8], frame[6], frame[7]
            )
            frame[9] *= frame[10]
            frame[11] *= frame[10]
        if not taken:
            return found, used
        events += 1


@kernel
def follow_trees(
    origin: Array,
    directions: Array,
    spheres: Array,
    rods: Array,
    threshold: float,
    first: int,
    last: int,
    fill: bool,
    frames: Array,
    stack: Array,
    trail: Array,
    light: Array,
    counts: Array,
    records: Array,
    codes: Array,
) -> None:
    """Follow rays first..last-1 from origin (3,) along directions (N, 3).

    Without `fill`, `counts` (N + 1, 2) int64 receives records and event pairs of ray i in row i + 1 and `light`
    (N, 5) where its light went; with `fill`, row i of `counts` says where the ray's records and pairs begin.
    """
    for i in range(first, last):
        found, used = follow_tree(
            origin[0],
            origin[1],
            origin[2],
            directions[i, 0],
            directions[i, 1],
            directions[i, 2],
            spheres,
            rods,
            threshold,
            i,
            fill,
            frames,
            stack,
            trail,
            light[i],
            records,
            codes,
            counts[i, 0],
            counts[i, 1],
        )
        if not fill:
            counts[i + 1, 0] = found
            counts[i + 1, 1] = used
