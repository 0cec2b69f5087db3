"""What each ray of a bundle meets next: rays in groups that ask the same list of spheres, nearest first.

Rays that left the same ball in about the same direction ask the same list (``tracer.kernels.candidates``); every
ray of a group keeps the nearest foot point ahead, as `march` does, until none can find a nearer one.  Who finds
nothing as near as its list reaches is asked again in the cells of the bed.
"""

import math

from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.bed import next_in_bed
from tracer.kernels.branches import NOTHING
from tracer.kernels.candidates import BALL_X, BALL_Y, BALL_Z, BINS, INDEX, cell_of, list_from_ball, narrow_list
from tracer.kernels.chain import whole_vectors
from tracer.kernels.lanes import (
    BALL_R2,
    BEGIN,
    CELL,
    DX,
    DY,
    DZ,
    FOUND,
    GROUPED,
    GU,
    GV,
    GW,
    GX,
    GY,
    GZ,
    LANE,
    LAST,
    LIST,
    MEMBER,
    NEAR,
    PICK,
    PX,
    PY,
    PZ,
    STEP,
    Bed,
    Bundle,
)
from tracer.kernels.rooms import OUTERMOST

MANY, LONG = 16, 4  # rays of a group and balls of its list from which it pays to narrow it


@kernel
def box_of(count: int, step: int, rays: Array, box: Array) -> None:
    """Lowest and highest start and direction, columns `step` apart, of `count` rays, whole vectors: box (12,)."""
    for k in range(6):
        column, at = k * step, k if k < 3 else k + 3
        a, b = rays[column], rays[column + 1]
        c, d, low, high, lower, higher = a, b, a, a, b, b
        for i in range(0, count, 4):  # four at a time: one after the other would wait for itself
            a, b, c, d = rays[column + i], rays[column + i + 1], rays[column + i + 2], rays[column + i + 3]
            low, high = min(low, min(a, b)), max(high, max(a, b))
            lower, higher = min(lower, min(c, d)), max(higher, max(c, d))
        box[at], box[at + 3] = min(low, lower), max(high, higher)


@kernel
def point_cells(count: int, rays: Array, marks: Array) -> None:
    """Cell of the cube that each ray points to."""
    for i in range(count):
        marks[CELL + i] = cell_of(rays[DX + i], rays[DY + i], rays[DZ + i])


@kernel
def group_lanes(count: int, balls: Array, bed: Bed, bundle: Bundle) -> int:
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
        g = group_of[at & INDEX]
        if g < 0:
            g = groups
            group_of[at & INDEX] = g
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
        group_of[places[LIST + g] & INDEX] = -1
    places[BEGIN + groups] = lane
    for i in range(count):
        g = places[MEMBER + i] & INDEX
        at = places[BEGIN + g] & INDEX
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
def look(k: int, beyond: float, count: int, balls: Array, grouped: Array, places: Array) -> int:
    """Note sphere k for the lanes of a group whose nearest it is so far; how many may find one beyond `beyond`."""
    cx, cy, cz, r2 = balls[BALL_X, k], balls[BALL_Y, k], balls[BALL_Z, k], balls[BALL_R2, k]
    still = 0
    for i in range(count):
        dx, dy, dz = grouped[GU + i], grouped[GV + i], grouped[GW + i]
        wx, wy, wz = grouped[GX + i] - cx, grouped[GY + i] - cy, grouped[GZ + i] - cz
        m = -(wx * dx + wy * dy + wz * dz)
        ax, ay, az = wx + m * dx, wy + m * dy, wz + m * dz
        near, pick = grouped[NEAR + i], places[FOUND + i]
        first_one = (m < near) | ((m == near) & (k < pick))  # whatever the order in which they are looked at
        nearer = (ax * ax + ay * ay + az * az < r2) & (m > 0.0) & first_one
        near = m if nearer else near
        grouped[NEAR + i] = near
        places[FOUND + i] = k if nearer else pick
        still += near > beyond
    return still


@kernel
def look_around(groups: int, count: int, balls: Array, bed: Bed, bundle: Bundle) -> None:
    """Find the sphere that each of `count` rays in `groups` meets next: PICK, or NOTHING."""
    marks, grouped, places, lists, near = (
        bundle.marks,
        bundle.grouped,
        bundle.group_marks,
        bundle.lists,
        bed.near,
    )
    lanes = places[BEGIN + groups]
    for i in range(lanes):
        grouped[NEAR + i] = math.inf
    for i in range(lanes):
        places[FOUND + i] = NOTHING
    for g in range(groups):
        at, first, last = places[LIST + g] & INDEX, places[BEGIN + g], places[BEGIN + g + 1]
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
            if look(lists.ball[e], beyond, last - first, balls, lanes_of, found_of) == 0:
                break
        for i in range(first, last):
            lane = places[LANE + i]
            if lane < 0:
                continue
            pick = places[FOUND + i]
            if not (of_tile or grouped[NEAR + i] <= near.horizon):
                px, py, pz = grouped[GX + i], grouped[GY + i], grouped[GZ + i]
                dx, dy, dz = grouped[GU + i], grouped[GV + i], grouped[GW + i]
                if not leaves(px, py, pz, dx, dy, dz, near.horizon, bed.frame) or pick != NOTHING:
                    pick, _ = next_in_bed(
                        px, py, pz, dx, dy, dz, at // BINS, bed.spheres, bed.frame, bed.begin, bed.items,
                        OUTERMOST, bed.home,
                    )  # fmt: skip
            marks[PICK + lane] = pick


@kernel_inlined
def leaves(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, within: float, frame: Array
) -> bool:  # fmt: skip
    """Whether a ray is out of the box of all spheres after a distance `within`."""
    x, y, z, side = px + within * dx, py + within * dy, pz + within * dz, frame[3]
    out = (x < frame[0]) | (y < frame[1]) | (z < frame[2])
    return bool(
        out
        | (x > frame[0] + frame[4] * side)
        | (y > frame[1] + frame[5] * side)
        | (z > frame[2] + frame[6] * side)
    )
