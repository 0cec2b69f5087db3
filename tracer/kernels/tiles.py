"""Tiles of the sensor: bundles of a few rows and columns, what became of their rays, and which branch each took.

A tile is as square as a bundle allows: rays stay together longest so.  The branch of a pixel is first an entry in
the book of the thread that traced it (``tracer.kernels.branch_book``); the caller numbers them.  When a book may
not hold the next tile the kernel comes back and says where it is.
"""

import math

from ground.jit import Array, kernel, unowned
from tracer.kernels.branch_book import BranchBook, enter, has_room
from tracer.kernels.branches import NOTHING
from tracer.kernels.bundle import (
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
    HASH,
    KEY,
    LANES,
    LAST,
    LOST,
    PICK,
    PLACE,
    PX,
    PY,
    PZ,
    Bed,
    Bundle,
    follow_bundle,
    unowned_bed,
    unowned_bundle,
)
from tracer.kernels.camera import CENTRE_U, CENTRE_V, EYE_X, EYE_Y, EYE_Z, FOCAL, axes_of, lens_of, undistorted
from tracer.kernels.chain import whole_vectors
from tracer.kernels.walk import MAX_EVENTS
from tracer.kernels.world import MISSED_PLANE, RECOVERED

SIDE = 16  # pixels of a tile each way
assert SIDE * SIDE == LANES


@kernel
def aim_lanes(count: int, camera: Array, rays: Array, marks: Array) -> None:
    """Begin `count` rays, whole vectors, through acquired pixels u, v, which stand in columns DX, DY."""
    ox, oy, oz = camera[EYE_X], camera[EYE_Y], camera[EYE_Z]
    c3, c4, c5, c6, c7, c8, c9, c10, c11 = axes_of(camera)
    focal, u0, v0 = camera[FOCAL], camera[CENTRE_U], camera[CENTRE_V]
    k1, k2, k3, p1, p2 = lens_of(camera)
    for i in range(count):
        x, y = (rays[DX + i] - u0) / focal, (rays[DY + i] - v0) / focal
        a, b, _, _ = undistorted(x, y, k1, k2, k3, p1, p2)
        scale = 1.0 / math.sqrt(a * a + b * b + 1.0)
        a, b = a * scale, b * scale
        rays[DX + i], rays[DY + i], rays[DZ + i] = (
            c3 * a + c6 * b + c9 * scale,
            c4 * a + c7 * b + c10 * scale,
            c5 * a + c8 * b + c11 * scale,
        )
        rays[PX + i], rays[PY + i], rays[PZ + i] = ox, oy, oz
    for i in range(count):
        marks[LAST + i], marks[PICK + i], marks[PLACE + i] = NOTHING, NOTHING, i
        marks[KEY + i], marks[LOST + i] = 1, 0


@kernel
def land_lanes(count: int, ends: Array) -> None:
    """Take the rays to the plane, whole vectors: their points in END_PX, END_PY, NaN for those that go up."""
    for i in range(count):
        dz = ends[END_DZ + i]
        t = -ends[END_PZ + i] / dz
        x, y = ends[END_PX + i] + t * ends[END_DX + i], ends[END_PY + i] + t * ends[END_DY + i]
        down = dz < 0.0
        ends[END_PX + i], ends[END_PY + i] = x if down else math.nan, y if down else math.nan


@kernel
def write_tile(
    row: int, rows: int, column: int, columns: int, bundle: Bundle, book: BranchBook,
    point: Array, status: Array, entry: Array,
) -> None:  # fmt: skip
    """Write the finished rays of a tile."""
    ends, fates, trail = bundle.ends, bundle.fates, bundle.trail
    before, known = -1, 0
    for r in range(rows):
        for c in range(columns):
            i = r * columns + c
            fate = fates[FATE + i]
            x, y = ends[END_PX + i], ends[END_PY + i]
            fate = MISSED_PLANE if fate == RECOVERED and math.isnan(x) else fate
            good = fate == RECOVERED
            point[row + r, 2 * (column + c)] = x if good else math.nan
            point[row + r, 2 * (column + c) + 1] = y if good else math.nan
            status[row + r, column + c] = fate
            events, first = fates[EVENTS + i], i * MAX_EVENTS
            same = before >= 0 and fates[HASH + i] == fates[HASH + before] and events == fates[EVENTS + before]
            if same:
                e = 0
                while e < events and trail[first + e] == trail[before * MAX_EVENTS + e]:
                    e += 1
                same = e == events
            if not same:
                known = enter(fates[HASH + i], events, first, trail, book)
            before = i
            entry[row + r, column + c] = known


@kernel
def trace_tiles(
    camera: Array, balls: Array, bed: Bed, most: int, row: int, rows: int, tile: int,
    bundle: Bundle, book: BranchBook, point: Array, status: Array, entry: Array,
) -> int:  # fmt: skip
    """Trace the tiles of `rows` rows from `row` on, beginning with number `tile`; the number of the next one.

    Outputs: plane points (H, 2 W), status (H, W) uint8 and entries in the book (H, W) uint32.
    """
    camera, balls, bed = unowned(camera), unowned(balls), unowned_bed(bed)
    point, status, entry = unowned(point), unowned(status), unowned(entry)
    bundle = unowned_bundle(bundle)
    book = BranchBook(
        unowned(book.slots), unowned(book.hashes), unowned(book.begin), unowned(book.met), unowned(book.counts)
    )
    rays, marks, ends = bundle.rays, bundle.marks, bundle.ends
    width = status.shape[1]
    while tile * SIDE < width:
        column = tile * SIDE
        columns = min(SIDE, width - column)
        count = rows * columns
        if not has_room(count, MAX_EVENTS, book):
            return tile
        for i in range(count):
            rays[DX + i], rays[DY + i] = column + i % columns, row + i // columns
        full = whole_vectors(count)
        for i in range(count, full):
            rays[DX + i], rays[DY + i] = rays[DX], rays[DY]
        aim_lanes(full, camera, rays, marks)
        follow_bundle(count, most, balls, bed, bundle)
        for i in range(count, full):
            ends[END_PX + i], ends[END_PY + i], ends[END_PZ + i] = ends[END_PX], ends[END_PY], ends[END_PZ]
            ends[END_DX + i], ends[END_DY + i], ends[END_DZ + i] = ends[END_DX], ends[END_DY], ends[END_DZ]
        land_lanes(full, ends)
        write_tile(row, rows, column, columns, bundle, book, point, status, entry)
        tile += 1
    return tile


@kernel
def number_rows(first: int, last: int, entry: Array, numbers: Array, branch: Array) -> None:
    """Turn the entries (H, W) of rows first..last-1 into branch numbers (H, W) by numbers (E,)."""
    for row in range(first, last):
        for column in range(entry.shape[1]):
            branch[row, column] = numbers[entry[row, column]]
