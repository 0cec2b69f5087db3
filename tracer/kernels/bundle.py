"""A bundle of neighbouring rays through many spheres, round by round: the fast form of ``march`` for beds.

A bundle is up to LANES rays, those of a tile of the sensor.  As in ``tracer.kernels.chain`` all that calculates
goes over its rays in one structure of arrays, in loops without a branch that the compiler puts into vectors.  In
a bed rays do not stay together, so each round begins with sorting them:

    group   rays that left the same ball in about the same direction ask the same list (``tracer.kernels.groups``)
    look    at the spheres of the list, nearest first, until no ray of the group can find a nearer one
    part    rays that met nothing are done, and the last rays of the bundle take their places: no lane is idle
    turn    all rays that are left, each by the numbers of its own sphere.

Directions are unit vectors, as for `march`, whose three facts (``tracer.kernels.walk``) replace every tolerance
here as well.  Nothing is assumed of the order in which spheres are met, or of how many there are.

A pixel has the same bits whatever bundle it is in: loops that calculate run over whole vectors, lanes beyond the
last ray repeat the first, and which spheres are asked does not change which one is found.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.branches import NOTHING
from tracer.kernels.candidates import BALL_X, BALL_Y, BALL_Z, INDEX, list_from_box
from tracer.kernels.chain import whole_vectors
from tracer.kernels.groups import box_of, group_lanes, look_around, point_cells
from tracer.kernels.lanes import (
    BALL_GK,
    BALL_IR,
    BALL_IR2,
    BALL_KT,
    BALL_NU,
    BALL_OPAQUE,
    BALL_R2,
    CX,
    CY,
    CZ,
    DX,
    DY,
    DZ,
    END_DX,
    END_DY,
    END_DZ,
    END_PX,
    END_PY,
    END_PZ,
    EVENTS,
    FATE,
    GK,
    HASH,
    IR,
    IR2,
    KEY,
    KT,
    LAST,
    LOST,
    NU,
    PICK,
    PLACE,
    PX,
    PY,
    PZ,
    R2,
    STEP,
    Bed,
    Bundle,
)
from tracer.kernels.walk import MAX_EVENTS
from tracer.kernels.world import BLOCKED, RECOVERED, TIR, TOO_MANY_EVENTS

FACTOR = 6364136223846793005  # of the hash of a trail, modulo 2^64 (Knuth's MMIX generator)


@kernel_inlined
def end_ray(i: int, fate: int, events: int, rays: Array, marks: Array, ends: Array, fates: Array) -> None:
    """Write down what became of the ray in lane i."""
    at = marks[PLACE + i] & INDEX
    ends[END_PX + at], ends[END_PY + at], ends[END_PZ + at] = rays[PX + i], rays[PY + i], rays[PZ + i]
    ends[END_DX + at], ends[END_DY + at], ends[END_DZ + at] = rays[DX + i], rays[DY + i], rays[DZ + i]
    fates[FATE + at], fates[EVENTS + at], fates[HASH + at] = fate, events, marks[KEY + i]


@kernel_inlined
def move_ray(to: int, i: int, rays: Array, marks: Array) -> None:
    """Put the ray of lane i into lane `to`."""
    rays[PX + to], rays[PY + to], rays[PZ + to] = rays[PX + i], rays[PY + i], rays[PZ + i]
    rays[DX + to], rays[DY + to], rays[DZ + to] = rays[DX + i], rays[DY + i], rays[DZ + i]
    marks[LAST + to], marks[PICK + to], marks[PLACE + to] = marks[LAST + i], marks[PICK + i], marks[PLACE + i]
    marks[KEY + to], marks[LOST + to] = marks[KEY + i], marks[LOST + i]


@kernel
def part(count: int, events: int, most: int, clear: bool, balls: Array, bundle: Bundle) -> int:
    """End the rays that met nothing, or are stopped, and note what the others met; return how many these are."""
    rays, marks, ends, fates, trail = bundle.rays, bundle.marks, bundle.ends, bundle.fates, bundle.trail
    i = 0
    while i < count:
        pick = marks[PICK + i]
        stopped = pick != NOTHING and not clear and balls[BALL_OPAQUE, pick & INDEX] != 0.0
        if pick == NOTHING or stopped or events == most:
            fate = RECOVERED if pick == NOTHING else BLOCKED if stopped else TOO_MANY_EVENTS
            end_ray(i, fate, events, rays, marks, ends, fates)
            count -= 1
            move_ray(i, count, rays, marks)
            continue
        marks[KEY + i] = marks[KEY + i] * FACTOR + pick + 1
        trail[(marks[PLACE + i] & INDEX) * MAX_EVENTS + events] = pick
        marks[LAST + i] = pick
        i += 1
    return count


@kernel
def fill_alike(balls: Array, rays: Array) -> None:
    """Put radius and index of the first ball into all lanes."""
    for i in range(STEP):
        rays[R2 + i], rays[IR2 + i], rays[KT + i] = balls[BALL_R2, 0], balls[BALL_IR2, 0], balls[BALL_KT, 0]
        rays[NU + i], rays[GK + i], rays[IR + i] = balls[BALL_NU, 0], balls[BALL_GK, 0], balls[BALL_IR, 0]


@kernel
def turn(count: int, alike: bool, balls: Array, rays: Array, marks: Array) -> int:
    """Turn every ray at its sphere, LAST; return how many are totally reflected there, LOST.

    `alike`: all balls have one radius and one index, which stand in the columns already (`fill_alike`).
    """
    for i in range(count):
        k = marks[LAST + i] & INDEX
        rays[CX + i], rays[CY + i], rays[CZ + i] = balls[BALL_X, k], balls[BALL_Y, k], balls[BALL_Z, k]
    for i in range(0 if alike else count):
        k = marks[LAST + i] & INDEX
        rays[R2 + i], rays[IR2 + i], rays[KT + i] = balls[BALL_R2, k], balls[BALL_IR2, k], balls[BALL_KT, k]
        rays[NU + i], rays[GK + i], rays[IR + i] = balls[BALL_NU, k], balls[BALL_GK, k], balls[BALL_IR, k]
    lost = 0
    for i in range(count):
        cx, cy, cz, r2, ir2 = rays[CX + i], rays[CY + i], rays[CZ + i], rays[R2 + i], rays[IR2 + i]
        kt, nu, gk, ir = rays[KT + i], rays[NU + i], rays[GK + i], rays[IR + i]
        dx, dy, dz = rays[DX + i], rays[DY + i], rays[DZ + i]
        wx, wy, wz = rays[PX + i] - cx, rays[PY + i] - cy, rays[PZ + i] - cz
        m = -(wx * dx + wy * dy + wz * dz)
        ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
        # Once more, as `foot` of ``tracer.kernels.sphere`` does: from far away the first is not across d.
        e = ax * dx + ay * dy + az * dz
        ax, ay, az = ax - e * dx, ay - e * dy, az - e * dz
        b2 = ax * ax + ay * ay + az * az
        chi = b2 * ir2
        cos_i = math.sqrt(max((r2 - b2) * ir2, 0.0))
        cos_t = math.sqrt(max(1.0 - b2 * kt, 0.0))
        g = gk / (cos_t + cos_i * nu)
        cosine = 1.0 - 2.0 * chi * g * g
        q = 2.0 * g * (cos_i * cos_t + chi * nu) * ir
        inside = b2 < r2  # else a tangent by rounding, which passes
        cosine, q = cosine if inside else 1.0, q if inside else 0.0
        along = b2 * q
        rays[PX + i] = cx + ax * cosine + dx * along
        rays[PY + i] = cy + ay * cosine + dy * along
        rays[PZ + i] = cz + az * cosine + dz * along
        rays[DX + i], rays[DY + i], rays[DZ + i] = dx * cosine - ax * q, dy * cosine - ay * q, dz * cosine - az * q
        total = inside & (b2 * kt >= 1.0)
        marks[LOST + i] = 1 if total else 0
        lost += total
    return lost


@kernel
def part_lost(count: int, events: int, bundle: Bundle) -> int:
    """End the rays that were totally reflected; return how many are left."""
    rays, marks, ends, fates = bundle.rays, bundle.marks, bundle.ends, bundle.fates
    i = 0
    while i < count:
        if marks[LOST + i] != 0:
            end_ray(i, TIR, events, rays, marks, ends, fates)
            count -= 1
            move_ray(i, count, rays, marks)
            continue
        i += 1
    return count


@kernel
def fill_lanes(count: int, rays: Array, marks: Array) -> int:
    """Let the lanes up to whole vectors repeat the first; return how many lanes these are."""
    full = whole_vectors(count)
    for i in range(count, full):
        move_ray(i, 0, rays, marks)
    return int(full)


@kernel
def follow_bundle(count: int, most: int, balls: Array, bed: Bed, bundle: Bundle) -> bool:
    """Take `count` rays through the spheres, `most` each (MAX_EVENTS or fewer); whether there are any in view."""
    rays, marks, events = bundle.rays, bundle.marks, 0
    box_of(fill_lanes(count, rays, marks), STEP, rays, bundle.box)
    if list_from_box(bundle.box, balls, bed.clusters, bundle.lists) == 0:
        part(count, events, most, bed.clear, balls, bundle)
        return False
    while True:
        groups = group_lanes(count, balls, bed, bundle)
        look_around(groups, count, balls, bed, bundle)
        count = part(count, events, most, bed.clear, balls, bundle)
        if count == 0:
            return True
        full = fill_lanes(count, rays, marks)
        events += 1
        if turn(full, bed.alike, balls, rays, marks) != 0:
            count = part_lost(count, events, bundle)
            if count == 0:
                return True
        point_cells(count, rays, marks)
