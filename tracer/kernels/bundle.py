"""A bundle of neighbouring rays through many spheres, round by round: the fast form of `trace_ray` for beds.

A bundle is up to LANES rays, those of a tile of the sensor.  As in ``tracer.kernels.chain`` all that calculates
goes over its rays in one structure of arrays, in loops without a branch that the compiler puts into vectors.  In
a bed rays do not stay together, so each round begins with sorting them:

    group      rays that left the same ball in about the same direction ask the same list
    intersect  the spheres of the list, nearest first, until no ray of the group can find a nearer one
    compact    rays that met nothing are done, and the last rays of the bundle take their places: no lane is idle
    refract    all other rays, each by the numbers of its own sphere.

Directions are unit vectors, as for `trace_ray`; its three facts (``tracer.kernels.rays``) replace every tolerance
here as well.  Nothing is assumed of the order in which spheres are met, or of how many there are.

A pixel has the same bits whatever bundle it is in: loops that calculate run over whole vectors, lanes beyond the
last ray repeat the first, and which spheres are asked does not change which one is found.

Lists are those of ``tracer.kernels.candidates``, nearest first; every
ray of a group keeps the nearest foot point ahead, as `trace_ray` does, until none can find a nearer one.  A ray
that finds nothing as near as its list reaches is traced in the cells of the bed.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.branches import NOTHING
from tracer.kernels.candidates import (
    BALL_R,
    BALL_X,
    BALL_Y,
    BALL_Z,
    BINS,
    NON_NEGATIVE,
    cell_of,
    list_from_ball,
    list_from_box,
    narrow_list,
)
from tracer.kernels.crossed import enters_behind, leaves_behind
from tracer.kernels.lanes import (
    BALL_GK,
    BALL_IR,
    BALL_IR2,
    BALL_KT,
    BALL_NU,
    BALL_OPAQUE,
    BALL_R2,
    BEGIN,
    CELL,
    CX,
    CY,
    CZ,
    END_DX,
    END_DY,
    END_DZ,
    END_PX,
    END_PY,
    END_PZ,
    EVENTS,
    FATE,
    FOUND,
    GK,
    GROUPED,
    GU,
    GV,
    GW,
    GX,
    GY,
    GZ,
    HASH,
    IR,
    IR2,
    KEY,
    KT,
    LANE,
    LAST,
    LIST,
    LOST,
    MEMBER,
    NEAR,
    NU,
    PICK,
    PLACE,
    R2,
    Bed,
    Bundle,
)
from tracer.kernels.packets import DX, DY, DZ, LANES, PX, PY, PZ, STEP, VECTOR, refract, whole_vectors
from tracer.kernels.rooms import OUTERMOST
from tracer.kernels.sphere import foot
from tracer.kernels.vectors import Vector, dot, move, subtract
from tracer.kernels.world import BLOCKED, IN_GLASS, RECOVERED, TIR, TOO_MANY_EVENTS, next_in_bed

MANY, LONG = 16, 4  # rays of a group and balls of its list from which it pays to narrow it
foot_inlined = kernel_inlined(foot.py_func)  # type: ignore[attr-defined]
LEFT_BEHIND = 2  # LOST: behind the investigation plane; 1: totally reflected
FACTOR = 6364136223846793005  # of the hash of a trail, modulo 2^64 (Knuth's MMIX generator)


@kernel
def box_of(count: int, step: int, rays: Array, box: Array) -> None:
    """Lowest and highest start and direction, columns `step` apart, of `count` rays, whole vectors: box (12,).

    Halved again and again: one after the other would wait for itself.  Behind the box is scratch (2 LANES,).
    """
    low, high = box[12:], box[12 + LANES :]
    for k in range(6):
        column, at, left = rays[k * step :], k if k < 3 else k + 3, whole_vectors((count + 1) // 2)
        upper = column[left:]
        for i in range(count - left):
            low[i], high[i] = min(column[i], upper[i]), max(column[i], upper[i])
        for i in range(count - left, left):
            low[i], high[i] = column[i], column[i]
        while left > VECTOR:
            half = whole_vectors((left + 1) // 2)
            lower, higher = low[half:], high[half:]
            for i in range(left - half):
                low[i], high[i] = min(low[i], lower[i]), max(high[i], higher[i])
            left = half
        a, b, c, d = low[0], low[1], high[0], high[1]
        for i in range(2, VECTOR, 2):
            a, b, c, d = min(a, low[i]), min(b, low[i + 1]), max(c, high[i]), max(d, high[i + 1])
        box[at], box[at + 3] = min(a, b), max(c, d)


@kernel
def point_cells(count: int, rays: Array, marks: Array) -> None:
    """Cell of the cube that each ray points to."""
    for i in range(count):
        marks[CELL + i] = cell_of(rays[DX + i], rays[DY + i], rays[DZ + i])


@kernel
def group_lanes(count: int, bundle: Bundle) -> int:
    """Sort copies of `count` rays into groups that ask the same list; return how many groups.

    Group g has lanes group_marks[BEGIN + g] to group_marks[BEGIN + g + 1], whole vectors; those beyond its last
    ray repeat its first, and have no LANE.
    """
    rays, marks, grouped, places, group_of = (
        bundle.rays,
        bundle.marks,
        bundle.grouped,
        bundle.group_marks,
        bundle.group_of,
    )
    groups, others = 0, 0
    for i in range(count):
        others += (marks[LAST + i] != marks[LAST]) | (marks[CELL + i] != marks[CELL])
    if others == 0:  # the usual case of few balls and many pixels
        full = whole_vectors(count)
        for column in range(6):
            for i in range(full):
                grouped[column * GROUPED + i] = rays[column * STEP + i]
        for i in range(full):
            places[LANE + i] = i if i < count else NOTHING
        places[LIST] = group_of.shape[0] - 1 if marks[LAST] < 0 else marks[LAST] * BINS + marks[CELL]
        places[BEGIN], places[BEGIN + 1] = 0, full
        return 1
    for i in range(count):
        last = marks[LAST + i]
        at = group_of.shape[0] - 1 if last < 0 else last * BINS + marks[CELL + i]
        g = group_of[at & NON_NEGATIVE]
        if g < 0:
            g = groups
            group_of[at & NON_NEGATIVE] = g
            places[LIST + g], places[BEGIN + g] = at, 0
            groups += 1
        places[BEGIN + g] += 1
        places[MEMBER + i] = g
    lane = 0
    for g in range(groups):
        size, places[BEGIN + g] = places[BEGIN + g], lane
        for i in range(lane + size, lane + whole_vectors(size)):
            places[LANE + i] = NOTHING
        lane += whole_vectors(size)
        group_of[places[LIST + g] & NON_NEGATIVE] = -1
    places[BEGIN + groups] = lane
    for i in range(count):
        g = places[MEMBER + i] & NON_NEGATIVE
        at = places[BEGIN + g] & NON_NEGATIVE
        places[BEGIN + g] = at + 1
        places[LANE + at] = i
        grouped[GX + at], grouped[GY + at], grouped[GZ + at] = rays[PX + i], rays[PY + i], rays[PZ + i]
        grouped[GU + at], grouped[GV + at], grouped[GW + at] = rays[DX + i], rays[DY + i], rays[DZ + i]
    first = 0
    for g in range(groups):
        size = places[BEGIN + g] - first
        places[BEGIN + g] = first
        full = whole_vectors(size)
        for i in range(first + size, first + full):
            for column in range(6):
                grouped[column * GROUPED + i] = grouped[column * GROUPED + first]
        first += full
    return groups


@kernel
def intersect(k: int, beyond: float, count: int, balls: Array, grouped: Array, places: Array) -> int:
    """Note sphere k for the lanes of a group whose nearest it is so far; how many may find one beyond `beyond`."""
    cx, cy, cz, r2 = balls[BALL_X, k], balls[BALL_Y, k], balls[BALL_Z, k], balls[BALL_R2, k]
    still = 0
    for i in range(count):
        dx, dy, dz = grouped[GU + i], grouped[GV + i], grouped[GW + i]
        wx, wy, wz = grouped[GX + i] - cx, grouped[GY + i] - cy, grouped[GZ + i] - cz
        m = -(wx * dx + wy * dy + wz * dz)
        ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
        near, pick = grouped[NEAR + i], places[FOUND + i]
        first_one = (m < near) | ((m == near) & (k < pick))  # whatever the order in which they are asked
        nearer = (ax * ax + ay * ay + az * az < r2) & (m > 0.0) & first_one
        near = m if nearer else near
        grouped[NEAR + i] = near
        places[FOUND + i] = k if nearer else pick
        still += near > beyond
    return still


@kernel
def intersect_groups(groups: int, bed: Bed, bundle: Bundle) -> None:
    """Find the sphere that each ray of some groups meets next: PICK, or NOTHING."""
    marks, grouped, places, lists = bundle.marks, bundle.grouped, bundle.group_marks, bundle.lists
    balls, near = bed.balls, bed.near
    lanes = places[BEGIN + groups]
    for i in range(lanes):
        grouped[NEAR + i] = math.inf
    for i in range(lanes):
        places[FOUND + i] = NOTHING
    for g in range(groups):
        at, first, last = places[LIST + g] & NON_NEGATIVE, places[BEGIN + g], places[BEGIN + g + 1]
        of_tile = at == lists.begin.shape[0] - 1
        if lists.begin[at] < 0:
            list_from_ball(at // BINS, at % BINS, balls, near, lists)
        begin, end = lists.begin[at], lists.begin[at] + lists.size[at]
        lanes_of, found_of = grouped[first:], places[first:]
        if last - first >= MANY and end - begin >= LONG and not of_tile:
            box_of(last - first, GROUPED, lanes_of, bundle.box)
            begin, end = narrow_list(begin, end, bundle.box, balls, lists)
        for e in range(begin, end):
            beyond = lists.least[e + 1] if e + 1 < end else math.inf
            if intersect(lists.ball[e], beyond, last - first, balls, lanes_of, found_of) == 0:
                break
        for i in range(first, last):
            lane = places[LANE + i]
            if lane < 0:
                continue
            pick = places[FOUND + i]
            if not (of_tile or grouped[NEAR + i] <= near.horizon):
                p = grouped[GX + i], grouped[GY + i], grouped[GZ + i]
                d = grouped[GU + i], grouped[GV + i], grouped[GW + i]
                if not is_outside(move(p, near.horizon, d), bed.frame) or pick != NOTHING:
                    cells = bed.frame, bed.begin, bed.items
                    pick, _ = next_in_bed(p, d, at // BINS, bed.spheres, cells, OUTERMOST, bed.home)
            marks[PICK + lane] = pick


@kernel_inlined
def is_outside(p: Vector, frame: Array) -> bool:
    """Return whether a point is out of the box of all spheres."""
    (x, y, z), side = p, frame[3]
    out = (x < frame[0]) | (y < frame[1]) | (z < frame[2])
    return bool(
        out
        | (x > frame[0] + frame[4] * side)
        | (y > frame[1] + frame[5] * side)
        | (z > frame[2] + frame[6] * side)
    )


@kernel_inlined
def end_ray(i: int, fate: int, events: int, rays: Array, marks: Array, ends: Array, fates: Array) -> None:
    """Write down what became of the ray in lane i."""
    at = marks[PLACE + i] & NON_NEGATIVE
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
def compact_active_rays(count: int, events: int, most: int, bed: Bed, bundle: Bundle) -> int:
    """End the rays that met nothing, or are stopped, and note what the others met; return how many these are."""
    rays, marks, ends, fates = bundle.rays, bundle.marks, bundle.ends, bundle.fates
    nothing, clear = 0, bed.clear
    for i in range(count):
        nothing += marks[PICK + i] == NOTHING
    some = nothing > 0 or not clear or events == most
    for i in range(count - 1 if some else -1, -1, -1):  # the last ray goes on, or is this one
        pick = marks[PICK + i]
        stopped = pick != NOTHING and not clear and bed.balls[BALL_OPAQUE, pick & NON_NEGATIVE] != 0.0
        if pick == NOTHING or stopped or events == most:
            fate = RECOVERED if pick == NOTHING else BLOCKED if stopped else TOO_MANY_EVENTS
            end_ray(i, fate, events, rays, marks, ends, fates)
            count -= 1
            if i < count:
                move_ray(i, count, rays, marks)
    for i in range(count):
        marks[LAST + i] = marks[PICK + i]
        marks[KEY + i] = marks[KEY + i] * FACTOR + marks[PICK + i] + 1
    trail = bundle.trail[events * LANES :]
    for i in range(count):
        trail[marks[PLACE + i] & NON_NEGATIVE] = marks[PICK + i]
    return count


@kernel
def fill_alike(balls: Array, rays: Array) -> None:
    """Put radius and index of the first ball into all lanes."""
    for i in range(STEP):
        rays[R2 + i], rays[IR2 + i], rays[KT + i] = balls[BALL_R2, 0], balls[BALL_IR2, 0], balls[BALL_KT, 0]
        rays[NU + i], rays[GK + i], rays[IR + i] = balls[BALL_NU, 0], balls[BALL_GK, 0], balls[BALL_IR, 0]


@kernel
def refract_bundle(count: int, bed: Bed, rays: Array, marks: Array) -> int:
    """Refract every ray at its sphere, LAST; return how many are totally reflected there, LOST.

    If all balls have one radius and one index, these stand in the columns already (`fill_alike`).
    """
    balls = bed.balls
    for i in range(count):
        k = marks[LAST + i] & NON_NEGATIVE
        rays[CX + i], rays[CY + i], rays[CZ + i] = balls[BALL_X, k], balls[BALL_Y, k], balls[BALL_Z, k]
    for i in range(0 if bed.alike else count):
        k = marks[LAST + i] & NON_NEGATIVE
        rays[R2 + i], rays[IR2 + i], rays[KT + i] = balls[BALL_R2, k], balls[BALL_IR2, k], balls[BALL_KT, k]
        rays[NU + i], rays[GK + i], rays[IR + i] = balls[BALL_NU, k], balls[BALL_GK, k], balls[BALL_IR, k]
    lost = 0
    for i in range(count):
        centre = rays[CX + i], rays[CY + i], rays[CZ + i]
        glass = rays[R2 + i], rays[IR2 + i], rays[KT + i], rays[NU + i], rays[GK + i], rays[IR + i]
        d = rays[DX + i], rays[DY + i], rays[DZ + i]
        _, a = foot_inlined(subtract((rays[PX + i], rays[PY + i], rays[PZ + i]), centre), d)
        b2 = dot(a, a)
        inside = b2 < glass[0]  # else a tangent by rounding, which passes
        p, d = refract(centre, a, b2, d, (1.0, 1.0), glass, inside)
        rays[PX + i], rays[PY + i], rays[PZ + i] = p
        rays[DX + i], rays[DY + i], rays[DZ + i] = d
        total = inside & (b2 * glass[2] >= 1.0)
        marks[LOST + i] = 1 if total else 0
        lost += total
    return lost


@kernel
def stop_at_plane(count: int, balls: Array, rays: Array, marks: Array) -> None:
    """Let rays that reach the investigation plane before their sphere meet nothing."""
    for i in range(count):
        k = marks[PICK + i]
        if k != NOTHING:
            p = rays[PX + i], rays[PY + i], rays[PZ + i]
            d = rays[DX + i], rays[DY + i], rays[DZ + i]
            if enters_behind(p, d, (balls[BALL_X, k], balls[BALL_Y, k], balls[BALL_Z, k]), balls[BALL_R, k]):
                marks[PICK + i] = NOTHING


@kernel
def lose_in_glass(count: int, balls: Array, rays: Array, marks: Array) -> int:
    """Mark rays that left their sphere, LAST, behind the investigation plane; return how many."""
    lost = 0
    for i in range(count):
        k = marks[LAST + i] & NON_NEGATIVE
        a = rays[PX + i] - balls[BALL_X, k], rays[PY + i] - balls[BALL_Y, k], rays[PZ + i] - balls[BALL_Z, k]
        d = rays[DX + i], rays[DY + i], rays[DZ + i]
        if marks[LOST + i] == 0 and leaves_behind(a, d, balls[BALL_Z, k], balls[BALL_R, k]):
            marks[LOST + i] = LEFT_BEHIND
            lost += 1
    return lost


@kernel
def end_lost(count: int, events: int, bundle: Bundle) -> int:
    """End the rays that were totally reflected, or are behind the plane; return how many are left."""
    rays, marks, ends, fates = bundle.rays, bundle.marks, bundle.ends, bundle.fates
    i = 0
    while i < count:
        if marks[LOST + i] != 0:
            end_ray(i, IN_GLASS if marks[LOST + i] == LEFT_BEHIND else TIR, events, rays, marks, ends, fates)
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
def follow_bundle(count: int, most: int, bed: Bed, bundle: Bundle) -> bool:
    """Take `count` rays through at most `most` spheres each; return whether there are any in view."""
    rays, marks, events = bundle.rays, bundle.marks, 0
    box_of(fill_lanes(count, rays, marks), STEP, rays, bundle.box)
    if list_from_box(bundle.box, bed.balls, bed.clusters, bundle.lists) == 0:
        compact_active_rays(count, events, most, bed, bundle)
        return False
    while True:
        groups = group_lanes(count, bundle)
        intersect_groups(groups, bed, bundle)
        if bed.is_crossed:
            stop_at_plane(count, bed.balls, rays, marks)
        count = compact_active_rays(count, events, most, bed, bundle)
        if count == 0:
            return True
        full = fill_lanes(count, rays, marks)
        events += 1
        lost = refract_bundle(full, bed, rays, marks)
        if bed.is_crossed:
            lost += lose_in_glass(full, bed.balls, rays, marks)
        if lost != 0:
            count = end_lost(count, events, bundle)
            if count == 0:
                return True
        point_cells(count, rays, marks)
