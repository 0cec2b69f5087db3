"""Trace a whole sensor behind many spheres, in bundles (``tracer.kernels.bundle``).

Bundles serve scenes of solid and opaque round spheres, however many, behind windows or not: those that are too
many for lockstep, opaque, or thinner than what is around them.

Every thread keeps a table of the branches that it met.  The tables become one list, numbered by length and name,
whatever thread traced them; it remains a list of numbers until names are asked for (`BranchList`).
"""

from collections import deque
from collections.abc import Sequence
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from tracer.kernels.bundle import fill_alike
from tracer.kernels.candidates import BINS, CLUSTER, Lists, Neighbours, count_neighbours
from tracer.kernels.crossed import CONTACT_TOL_MM
from tracer.kernels.lanes import (
    BALL_ROWS,
    END_NUMBERS,
    FATE_NUMBERS,
    GROUP_MARKS,
    GROUP_NUMBERS,
    MARK_NUMBERS,
    RAY_NUMBERS,
    Bed,
    Bundle,
)
from tracer.kernels.packets import LANES
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.rooms import ONE_ROOM
from tracer.kernels.sphere import CENTRE_X, CENTRE_Z, OPAQUE, RADIUS, REFRACTIVE_INDEX
from tracer.kernels.tiles import SIDE, BranchTable, TileArrays, copy_entries, number_rows, pack_ranks, trace_tiles
from tracer.scene.scene import Scene
from tracer.strategies.branches import SHORT_NUMBERS, Branch, BranchList, Numbers
from tracer.strategies.lockstep import NO_WINDOWS, cache_aligned
from tracer.strategies.trace import cells_of, pack_camera

NEIGHBOURS = 100  # balls around each that are asked first
ROOM = 1 << 18  # balls in all lists of a thread, 3 MB: what a bed of a thousand uses
FIRST_ENTRIES = 1024  # branches of a table before it grows


class Balls:
    """Spheres as ``tracer.kernels.bundle`` takes them.

    Parameters
    ----------
    spheres : (N, 6) float64
        Table of solid spheres, see ``Sphere.table_of``.
    """

    def __init__(self, spheres: NDArray[np.float64]) -> None:
        self.order = side_by_side(spheres)
        table = np.ascontiguousarray(spheres[self.order])
        n, radius, opaque = table[:, REFRACTIVE_INDEX], table[:, RADIUS], table[:, OPAQUE]
        square = radius * radius
        rows = [
            *table[:, CENTRE_X : CENTRE_Z + 1].T,
            radius,
            square,
            1.0 / square,
            1.0 / (n * n * square),
            1.0 / n,
            (n - 1.0) * (n + 1.0) / (n * n),
            1.0 / radius,
            opaque,
        ]
        balls = np.ascontiguousarray(np.array(rows).reshape(BALL_ROWS, -1))
        alike = len(np.unique(table[:, RADIUS:], axis=0)) <= 1
        clusters = spheres_around(balls)
        near = neighbours(balls, clusters)
        self.bed = Bed(
            balls,
            near,
            clusters,
            table,
            *cells_of(table),
            ONE_ROOM.home,
            bool(alike),
            not opaque.any(),
            bool((table[:, CENTRE_Z] - radius < -CONTACT_TOL_MM).any()),
        )

    def bundle(self) -> Bundle:
        """Memory of one thread."""
        spheres = self.bed.balls.shape[1]
        room = ROOM + spheres
        lists = Lists(
            np.full(spheres * BINS + 1, -1, np.int32),
            np.empty(spheres * BINS + 1, np.int32),
            np.empty(room, np.int32),
            np.empty(room),
            np.zeros(1, np.int64),
        )
        rays = cache_aligned(RAY_NUMBERS, np.float64)
        if spheres and self.bed.alike:
            fill_alike(self.bed.balls, rays)
        return Bundle(
            rays,
            cache_aligned(MARK_NUMBERS, np.int64),
            cache_aligned(END_NUMBERS, np.float64),
            cache_aligned(FATE_NUMBERS, np.int64),
            np.empty(MAX_EVENTS * LANES, np.int32),
            np.empty(12 + 2 * LANES),
            cache_aligned(GROUP_NUMBERS, np.float64),
            cache_aligned(GROUP_MARKS, np.int64),
            np.full(spheres * BINS + 1, -1, np.int32),
            lists,
        )


def neighbours(balls: NDArray[np.float64], clusters: NDArray[np.float64]) -> Neighbours:
    """Balls near each ball: all of them where they are few, else some NEIGHBOURS."""
    count, horizon = balls.shape[1], np.inf
    if count > NEIGHBOURS:
        x, radius = balls[:3], balls[3]
        volume = np.prod((x + radius).max(axis=1) - (x - radius).min(axis=1))
        across = (NEIGHBOURS / count * volume * 0.75 / np.pi) ** (1.0 / 3.0)
        horizon = float(max(across - 2.0 * radius.mean(), radius.min()))
    begin, items = np.empty(count + 1, np.int32), np.empty(2 * NEIGHBOURS * count, np.int32)
    total = count_neighbours(balls, clusters, horizon, begin, items)
    if total > len(items):
        items = np.empty(total, np.int32)
        count_neighbours(balls, clusters, horizon, begin, items)
    return Neighbours(begin, items, horizon)


def side_by_side(spheres: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order (N,) of a sphere table in which neighbours in space stand side by side: halved again and again."""
    parts, done = deque([np.arange(len(spheres))]), []
    while parts:
        part = parts.popleft()
        if len(part) <= CLUSTER:
            done.append(part)
            continue
        centres = spheres[part, CENTRE_X : CENTRE_Z + 1]
        axis = int(np.argmax(np.ptp(centres, axis=0)))
        part = part[np.lexsort((*spheres[part].T, centres[:, axis]))]  # the same for any order of bodies
        half = CLUSTER * ((len(part) // 2 + CLUSTER - 1) // CLUSTER)
        parts.extendleft((part[half:], part[:half]))
    return np.concatenate(done)


def spheres_around(balls: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spheres x, y, z, R (4, C) around each CLUSTER of balls (BALL_ROWS, N)."""
    count = balls.shape[1]
    around = np.empty((4, -(-count // CLUSTER)))
    for c in range(around.shape[1]):
        x, radius = balls[:3, CLUSTER * c : CLUSTER * (c + 1)], balls[3, CLUSTER * c : CLUSTER * (c + 1)]
        around[:3, c] = 0.5 * ((x - radius).min(axis=1) + (x + radius).max(axis=1))
        away = np.sqrt(((x - around[:3, c : c + 1]) ** 2).sum(axis=0)) + radius
        around[3, c] = away.max() * (1.0 + 1e-9)
    return around


def new_table(entries: int) -> BranchTable:
    """Return a table for so many branches, which has the direct view."""
    slots = 1 << (4 * entries - 1).bit_length()
    table = BranchTable(
        np.zeros(slots, np.int32),
        np.empty(entries + 1, np.int64),
        np.zeros(entries + 2, np.int64),
        np.empty(entries * MAX_EVENTS, np.int32),
        np.zeros(1, np.int64),
    )
    first = BranchTable(table.slots, np.ones(1, np.int64), np.zeros(2, np.int64), table.met, np.ones(1, np.int64))
    copy_entries(first, table, np.empty(1, np.int64))
    return table


def enlarge(table: BranchTable) -> BranchTable:
    """Return a table with the same entries and twice the room."""
    larger = new_table(2 * len(table.hashes))
    copy_entries(table, larger, np.empty(int(table.counts[0]), np.int64))
    return larger


def trace_bed(
    scene: Scene,
    plane: NDArray[np.float64 | np.float32],
    status: NDArray[np.uint8],
    branch: Numbers,
    most: int = MAX_EVENTS,
    windows: NDArray[np.float64] = NO_WINDOWS,
) -> tuple[Numbers, Sequence[Branch]] | None:
    """Trace every pixel into plane (H, W, 2) and status (H, W), with the same bits for any order of bodies.

    Parameters
    ----------
    scene : Scene
        Solid spheres.
    plane, status, branch : arrays (H, W, 2), (H, W), (H, W)
        What is written; `branch` only if its numbers are long enough.
    most : int
        No ray goes through more spheres.
    windows : (K, 10) float64
        Windows in front of all spheres, from the camera on.

    Returns
    -------
    tuple or None
        Branch numbers (H, W), in `branch` if they fit, and the branches; None: some ray passes beside a window's
        plane or is reflected by it, which only `trace_ray` can follow.
    """
    height, width = status.shape
    camera, spheres = pack_camera(scene.camera), Balls(scene.sphere_table())
    point, entry = plane.reshape(height, 2 * width), np.empty((height, width), np.uint32)
    bands = -(-height // SIDE)
    owner, tables = np.empty(bands, np.int64), list[BranchTable]()
    spare, one_at_a_time = deque[tuple[int, Bundle, NDArray[np.int64]]](), Lock()
    odd = np.zeros(height, np.int64)
    out = TileArrays(odd, point, status, entry)

    def work(first: int, last: int) -> None:
        try:
            number, bundle, passed = spare.pop()
        except IndexError:
            bundle, passed = spheres.bundle(), np.empty(LANES, np.int64)
            with one_at_a_time:
                number = len(tables)
                tables.append(new_table(FIRST_ENTRIES))
        for band in range(first, last):
            owner[band], tile, row = number, 0, SIDE * band
            rows = min(SIDE, height - row)
            while SIDE * tile < width:
                place, scratch = (row, rows, tile), (bundle, passed)
                tile = trace_tiles(camera, spheres.bed, windows, most, place, scratch, tables[number], out)
                if SIDE * tile < width:
                    tables[number] = enlarge(tables[number])
        spare.append((number, bundle, passed))

    run_rows(work, bands, block=max(1, bands // 32))
    if odd.any():
        return None
    numbers, branches = number_tables(scene, spheres.order, tables)
    if len(branches) > SHORT_NUMBERS:
        branch = np.empty((height, width), np.uint32)

    def number(first: int, last: int) -> None:
        for band in range(first, last):
            number_rows(SIDE * band, min(height, SIDE * (band + 1)), entry, numbers[owner[band]], branch)

    run_rows(number, bands, block=max(1, bands // 32))
    return branch, branches


def number_tables(
    scene: Scene, order: NDArray[np.int64], tables: list[BranchTable]
) -> tuple[list[NDArray[np.int64]], BranchList]:
    """Branch numbers of the entries of each table, and the branches that they number."""
    entries = int(sum(table.counts[0] for table in tables))
    every = new_table(entries)
    into = [np.empty(int(table.counts[0]), np.int64) for table in tables]
    for table, places in zip(tables, into, strict=True):
        copy_entries(table, every, places)
    count = int(every.counts[0])
    names = np.array(scene.event_names()[: len(order)], dtype=object)[order]
    rank = np.empty(len(order), np.int64)
    rank[np.argsort(names)] = np.arange(len(order))
    bits = max(1, len(order).bit_length())
    lengths = np.diff(every.begin[: count + 1])
    words = -(-int(lengths.max(initial=0)) // (63 // bits))
    packed = np.empty((1 + words, count), np.uint64)
    pack_ranks(every, rank, bits, packed)
    sorting = np.lexsort(packed[::-1])
    number = np.empty(count, np.int64)
    number[sorting] = np.arange(count)
    begin = np.concatenate(([0], np.cumsum(lengths[sorting])))
    where = np.repeat(every.begin[sorting] - begin[:-1], lengths[sorting]) + np.arange(begin[-1])
    return [number[places] for places in into], BranchList(scene.event_names(), order[every.met[where]], begin)
