"""Tiles of the sensor: bundles of a few rows and columns, what became of their rays, and which branch each took.

A tile is as square as a bundle allows: rays stay together longest so.  Windows in front of everything are a pass
over the tile before it (``tracer.kernels.windowed``): rays stand in the columns in which a block has them.

The branch of a pixel is first an entry in the table of the thread that traced it;
the caller numbers them.  When a table may not hold the next tile the kernel comes back and says where it is.

A table has one entry for each branch that was met, found by a hash of its trail.  Entry e holds the spheres, in
order: met[begin[e] : begin[e + 1]], rows of ``balls``.  Entry 0 is the direct view. ``slots`` (a power of two,)
int32 is a hash table with open addressing: entry + 1, or 0; ``hashes`` (entries,) int64. A hash only says where to
look: that two trails are the same is seen by comparing them.  Each thread keeps its own table; they become one
afterwards (`copy_entries`).

``counts`` (1,) int64 is how many entries there are.
"""

import math
from typing import NamedTuple

from ground.jit import Array, kernel
from tracer.kernels import chain
from tracer.kernels.branches import NOTHING
from tracer.kernels.bundle import follow_bundle
from tracer.kernels.camera import CENTRE_U, CENTRE_V, EYE_X, EYE_Y, EYE_Z, FOCAL, axes_of, lens_of, undistort
from tracer.kernels.lanes import (
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
    LAST,
    LOST,
    PICK,
    PLACE,
    Bed,
    Bundle,
)
from tracer.kernels.packets import DX, DY, DZ, LANES, PX, PY, PZ, hit_plane, whole_vectors
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.window import BEHIND, GLASS, THICKNESS
from tracer.kernels.windowed import OPEN, SHUT, through_window_carefully
from tracer.kernels.world import BLOCKED, MISSED_PLANE, RECOVERED

NON_NEGATIVE = (1 << 62) - 1  # says that a number is not negative
FULL = -1
SIDE = 16  # pixels of a tile each way


class BranchTable(NamedTuple):
    """See the top of the file."""

    slots: Array
    hashes: Array
    begin: Array
    met: Array
    counts: Array


@kernel
def enter(hashed: int, events: int, first: int, step: int, trail: Array, table: BranchTable) -> int:
    """Entry of the trail of so many numbers trail[first], trail[first + step], ..., made if it is new."""
    slots, hashes, begin, met, counts = table
    mask = slots.shape[0] - 1
    # the lower bits of a product know nothing of the upper ones
    slot = ((hashed >> 32) ^ hashed) & mask
    while slots[slot] != 0:
        entry = slots[slot] - 1
        at = begin[entry]
        if hashes[entry] == hashed and begin[entry + 1] - at == events:
            same = 0
            while same < events and met[at + same] == trail[first + same * step]:
                same += 1
            if same == events:
                return int(entry)
        slot = (slot + 1) & mask
    entry = counts[0]
    at = begin[entry]
    for e in range(events):
        met[at + e] = trail[first + e * step]
    begin[entry + 1] = at + events
    hashes[entry] = hashed
    slots[slot] = entry + 1
    counts[0] = entry + 1
    return int(entry)


@kernel
def has_room(entries: int, longest: int, table: BranchTable) -> bool:
    """Return whether so many more entries fit, none longer than `longest`."""
    count = table.counts[0] + entries
    fits = count < table.hashes.shape[0] and 2 * count <= table.slots.shape[0]
    return bool(fits and table.begin[table.counts[0]] + entries * longest <= table.met.shape[0])


@kernel
def copy_entries(table: BranchTable, other: BranchTable, entries: Array) -> None:
    """Enter all that `table` has into `other`, which has room: its entries there go to entries (E,) int64."""
    for entry in range(table.counts[0]):
        at = table.begin[entry]
        entries[entry] = enter(table.hashes[entry], table.begin[entry + 1] - at, at, 1, table.met, other)


@kernel
def pack_ranks(table: BranchTable, rank: Array, bits: int, packed: Array) -> None:
    """Words (W, E) uint64 of the entries that sort as their lengths, then the ranks (N,) of what they met, do.

    The first word of each is the length.
    """
    fit = 63 // bits
    for entry in range(table.counts[0]):
        at, events = table.begin[entry], table.begin[entry + 1] - table.begin[entry]
        packed[0, entry] = events
        for w in range(1, packed.shape[0]):
            word = 0
            for e in range((w - 1) * fit, w * fit):
                word = word << bits | (rank[table.met[at + e]] if e < events else 0)
            packed[w, entry] = word


class TileArrays(NamedTuple):
    """Results of a sensor.

    Parameters
    ----------
    odd : (H,) int64
        In the first row of each tile how many of its rays only `trace_ray` can follow through the windows.
    point, status, entry : (H, 2 W), (H, W) uint8, (H, W) uint32
        Plane points, status, and entries in the thread's table.
    """

    odd: Array
    point: Array
    status: Array
    entry: Array


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
        a, b, _, _ = undistort(x, y, k1, k2, k3, p1, p2)
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
def pass_windows(count: int, windows: Array, rays: Array, fates: Array) -> int:
    """Take `count` rays, whole vectors, through windows (K, 10); how many come through, as `fates` (n,) says."""
    for i in range(count):
        fates[i] = OPEN
        rays[chain.QQ + i] = 1.0
    away, k = 0.0, 0
    for k in range(windows.shape[0]):
        row = windows[k]
        before = (rays[PX] - row[0]) * row[3] + (rays[PY] - row[1]) * row[4] + (rays[PZ] - row[2]) * row[5]
        away = ((away + before) * row[GLASS] + row[THICKNESS]) * row[BEHIND] / row[GLASS]
        through_window_carefully(count, row, rays, fates)
        for i in range(count):
            rays[chain.QQ + i] = 1.0
    # back to about where they seem to come from: a list is the shorter the closer rays begin together
    nx, ny, nz = windows[k, 3], windows[k, 4], windows[k, 5]
    passed = 0
    for i in range(count):
        t = -away / (rays[DX + i] * nx + rays[DY + i] * ny + rays[DZ + i] * nz)
        back = t if fates[i] == OPEN else 0.0
        rays[PX + i] -= back * rays[DX + i]
        rays[PY + i] -= back * rays[DY + i]
        rays[PZ + i] -= back * rays[DZ + i]
        passed += fates[i] == OPEN
    return passed


@kernel
def end_behind(count: int, inner: Array, fates: Array, ends: Array, ended: Array) -> int:
    """Correct what became of landed rays behind windows, the last one `inner`; how many `trace_ray` has to know.

    A ray that would land in front of its back meets the wall there.
    """
    nx, ny, nz = inner[3], inner[4], inner[5]
    level = inner[2] * nz - inner[THICKNESS]
    odd = 0
    for i in range(count):
        above = (ends[END_PX + i] - inner[0]) * nx + (ends[END_PY + i] - inner[1]) * ny > level
        if fates[i] != OPEN:
            ended[FATE + i], ended[EVENTS + i], ended[HASH + i] = BLOCKED, 0, 1
            odd += fates[i] != SHUT
        elif above and ended[FATE + i] == RECOVERED:
            ended[FATE + i] = MISSED_PLANE
    return odd


@kernel
def write_tile(
    row: int, rows: int, column: int, columns: int, bundle: Bundle, table: BranchTable, out: TileArrays
) -> None:
    """Write the finished rays of a tile."""
    point, status, entry = out.point, out.status, out.entry
    ends, fates, trail = bundle.ends, bundle.fates, bundle.trail
    before, known = -1, 0
    for r in range(rows):
        first = r * columns
        p, s = point[row + r, 2 * column : 2 * (column + columns)], status[row + r, column : column + columns]
        for c in range(columns):
            i = first + c
            x, y, fate = ends[END_PX + i], ends[END_PY + i], fates[FATE + i]
            fate = MISSED_PLANE if (fate == RECOVERED) & (x != x) else fate
            good = fate == RECOVERED
            p[2 * c], p[2 * c + 1] = x if good else math.nan, y if good else math.nan
            s[c] = fate
        e = entry[row + r, column : column + columns]
        for c in range(columns):
            i = first + c
            events = fates[EVENTS + i]
            same = before >= 0 and fates[HASH + i] == fates[HASH + before] and events == fates[EVENTS + before]
            if same:
                k = 0
                while k < events and trail[k * LANES + i] == trail[k * LANES + before]:
                    k += 1
                same = k == events
            if not same:
                known = enter(fates[HASH + i], events, i, LANES, trail, table)
            before = i
            e[c] = known


@kernel
def trace_tiles(
    camera: Array, bed: Bed, windows: Array, most: int, place: tuple[int, int, int], scratch: tuple[Bundle, Array],
    table: BranchTable, out: TileArrays,
) -> int:  # fmt: skip
    """Trace tiles of a band, `place`: first row, rows, number of the first tile; the number of the next one.

    ``windows`` (K, 10) are passed before, from the camera on; `scratch` is a bundle and (LANES,) int64.
    """
    (row, rows, tile), (bundle, passed), odd, status = place, scratch, out.odd, out.status
    rays, marks, ends = bundle.rays, bundle.marks, bundle.ends
    width = status.shape[1]
    while tile * SIDE < width:
        column = tile * SIDE
        columns = min(SIDE, width - column)
        count = rows * columns
        if not has_room(count, MAX_EVENTS, table):
            return tile
        for r in range(rows):
            for c in range(columns):
                rays[DX + r * columns + c], rays[DY + r * columns + c] = column + c, row + r
        full = whole_vectors(count)
        for i in range(count, full):
            rays[DX + i], rays[DY + i] = rays[DX], rays[DY]
        aim_lanes(full, camera, rays, marks)
        behind = windows.shape[0] > 0
        if not behind or pass_windows(full, windows, rays, passed) > 0:
            follow_bundle(count, most, bed, bundle)
        for i in range(count, full):
            ends[END_PX + i], ends[END_PY + i], ends[END_PZ + i] = ends[END_PX], ends[END_PY], ends[END_PZ]
            ends[END_DX + i], ends[END_DY + i], ends[END_DZ + i] = ends[END_DX], ends[END_DY], ends[END_DZ]
        hit_plane(full, ends)
        if behind:
            odd[row] += end_behind(count, windows[windows.shape[0] - 1], passed, ends, bundle.fates)
        write_tile(row, rows, column, columns, bundle, table, out)
        tile += 1
    return tile


@kernel
def number_rows(first: int, last: int, entry: Array, numbers: Array, branch: Array) -> None:
    """Turn the entries (H, W) of rows first..last-1 into branch numbers (H, W) by numbers (E,)."""
    for row in range(first, last):
        for column in range(entry.shape[1]):
            branch[row, column] = numbers[entry[row, column]]
