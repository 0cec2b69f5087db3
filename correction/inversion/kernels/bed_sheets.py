"""Many small sheets in one call: the map behind a bed has tens of thousands, mostly of some dozen nodes.

What ``correction.inversion.invert`` does for one large sheet after the other is done here for one small sheet
after the other: starts scattered, of those from the edges the nearest of each node kept, nodes solved in blocks
and verified.  A bed's rays are verified in a bundle (``tracer.kernels.bundle``): what a block of Newton has
solved is traced once more with all bodies, and only counts if the ray meets the very spheres of the sheet, in
this order, and nothing else.

A sheet that is not done within one portion of starts is left to the caller, who then calls again.
"""

from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.inverse import Tables, unowned_tables
from correction.inversion.kernels.newton import (
    CONVERGED,
    GROUP,
    U,
    V,
    Ways,
    solve_block,
    solve_patiently,
    unowned_ways,
)
from correction.inversion.kernels.starts import DONE, scatter_sheet
from correction.inversion.kernels.views import ANOTHER, begin_group, judge_trips, keep_group, put_off
from ground.jit import Array, kernel, unowned
from tracer.kernels.bundle import follow_bundle
from tracer.kernels.chain import TRIP, whole_vectors
from tracer.kernels.lanes import DX, DY, END_DZ, EVENTS, FATE, Bed, Bundle, unowned_bed, unowned_bundle
from tracer.kernels.tiles import aim_lanes, end_behind, land_lanes, pass_windows
from tracer.kernels.walk import MAX_EVENTS
from tracer.kernels.world import RECOVERED as TRACED

MET = -1  # the trip of a ray that met the spheres of its sheet
LAST_STAMP = 255


class Small(NamedTuple):
    """Sheets in the order in which they are solved.

    Parameters
    ----------
    branch : (S,) int64
        Branch number of each.
    sign : (S,) float64
        Of its determinant.
    events, balls, begin : (E,) int64, (E,) int64, (S + 1,) int64
        Spheres of each sheet, events[begin[s] : begin[s + 1]], in the order of the sphere table and of a bundle's.
    runs, first : (R, RUN) int64, (S + 1,) int64
        Runs of each sheet, runs[first[s] : first[s + 1]].
    enough : (S,) float32
        Weight from which a node takes no view of it.
    """

    branch: Array
    sign: Array
    events: Array
    balls: Array
    begin: Array
    runs: Array
    first: Array
    enough: Array


class Sensor(NamedTuple):
    """Plane points (H, 2 W), branch, flags (H, W) of the sensor; who has ``taken`` a node (h, w): see `starts`."""

    plane: Array
    branch: Array
    flags: Array
    taken: Array


class StartScratch(NamedTuple):
    """``cursor`` (3,), ``listed``, ``measured``, ``starts``, ``nodes`` as for `scatter_sheet`; ``slots``."""

    cursor: Array
    listed: Array
    measured: Array
    starts: Array
    nodes: Array
    slots: Array


@kernel
def keep_nearest(tiled: int, found: int, stamp: int, starts: Array, nodes: Array, slots: Array) -> int:
    """Keep of the starts tiled..found-1 the nearest of each node, the first of equals; return how many are left.

    ``slots`` (a power of two, above twice as many,) int64 is a hash table: stamp and place of what it holds; who
    has another stamp is not there.
    """
    mask, kept = slots.shape[0] - 1, tiled
    for k in range(tiled, found):
        row, column = nodes[k, 0], nodes[k, 1]
        slot = (row * 73856093 ^ column * 19349663) & mask
        at = -1
        while slots[slot] >> 32 == stamp:
            at = slots[slot] & 0xFFFFFFFF
            if nodes[at, 0] == row and nodes[at, 1] == column:
                break
            at = -1
            slot = (slot + 1) & mask
        if at < 0:
            at = kept
            slots[slot] = stamp << 32 | at
            kept += 1
        elif not starts[k, 2] < starts[at, 2]:
            continue
        for c in range(4):
            starts[at, c] = starts[k, c]
        nodes[at, 0], nodes[at, 1] = row, column
    return kept


@kernel
def verify_in_bundle(
    count: int, balls: Array, camera: Array, windows: Array, bed: Bed, table: Array, bundle: Bundle, passed: Array,
    state: Array, trips: Array, b: Array,
) -> None:  # fmt: skip
    """MET for converged pixels whose ray meets the spheres ``balls`` (E,) of `table`, in this order, no others."""
    rays, some, events = bundle.rays, -1, balls.shape[0]
    for i in range(count):
        trips[TRIP + i] = ANOTHER
        if state[i] == CONVERGED:
            some = i
    if some < 0:
        return
    full = whole_vectors(count)
    for i in range(full):
        good = i < count and state[i] == CONVERGED
        rays[DX + i], rays[DY + i] = b[U + i] if good else b[U + some], b[V + i] if good else b[V + some]
    aim_lanes(full, camera, rays, bundle.marks)
    behind = windows.shape[0] > 0
    if behind:
        pass_windows(full, windows, rays, passed)
    follow_bundle(count, MAX_EVENTS, table, bed, bundle)
    if behind:
        for i in range(count, full):
            bundle.ends[END_DZ + i] = -1.0
        land_lanes(full, bundle.ends)
        end_behind(count, windows[windows.shape[0] - 1], passed, bundle.ends, bundle.fates)
    for i in range(count):
        same = state[i] == CONVERGED and bundle.fates[FATE + i] == TRACED and bundle.ends[END_DZ + i] < 0.0
        same = same and bundle.fates[EVENTS + i] == events
        for e in range(events if same else 0):
            same = same and bundle.trail[i * MAX_EVENTS + e] == balls[e]
        trips[TRIP + i] = MET if same else ANOTHER


@kernel
def solve_in_bundle(
    tables: Tables, grid: Array, windows: Array, table: Array, bed: Bed, every: bool, sequence: Array,
    balls: Array, number: int, sign: float, limits: Array, starts: Array, nodes: Array, bundle: Bundle,
    passed: Array, block: Array, state: Array, trips: Array, maps: tuple[Array, ...],
) -> None:  # fmt: skip
    """Solve nodes of one sheet from their starts and keep the views, as `solve_nodes`.

    ``sequence``, ``balls`` (E,) are the spheres of the sheet in the order of the sphere table and of the bundle's
    ``table``; the others are those of `solve_small_sheets`.
    """
    tables, bed, bundle = unowned_tables(tables), unowned_bed(bed), unowned_bundle(bundle)
    camera, spheres, windows, passed = tables[0], tables[1].spheres, unowned(windows), unowned(passed)
    block, state, trips, table = unowned(block), unowned(state), unowned(trips), unowned(table)
    starts, nodes, sequence, balls = unowned(starts), unowned(nodes), unowned(sequence), unowned(balls)
    total, left = nodes.shape[0], 0
    for patient in range(2):
        for low in range(0, total, GROUP):
            count = min(GROUP, total - low)
            group, of_group = starts[low : low + count], nodes[low : low + count]
            begin_group(count, grid, group, of_group, block, state)
            if patient:
                solve_patiently(whole_vectors(count), camera, windows, spheres, sequence, sign, block, state)
            else:
                solve_block(whole_vectors(count), camera, windows, spheres, sequence, sign, block, state)
            verify_in_bundle(count, balls, camera, windows, bed, table, bundle, passed, state, trips, block)
            judge_trips(count, MET, every, group, trips, block, state)
            keep_group(count, grid[2], balls.shape[0], number, limits, of_group, block, state, maps)
            left = put_off(low, count, left, starts, nodes, trips)
        total, left = left, 0


@kernel
def solve_small_sheets(
    tables: Tables, ways: Ways, grid: Array, windows: Array, table: Array, bed: Bed, every: bool, sheets: Small,
    sensor: Sensor, progress: Array, limits: Array, start: StartScratch, bundle: Bundle, passed: Array,
    block: Array, state: Array, trips: Array, maps: tuple[Array, ...],
) -> None:  # fmt: skip
    """Solve sheets from number progress[0] on, until one is too large, which then is progress[0], or all are done.

    ``table`` (BALL_ROWS, N) balls of the bundle; ``progress`` (2,) int64: next sheet, stamp of the last one;
    ``passed`` (GROUP,) int64 is scratch.
    Others as `solve_nodes` and `scatter_sheet` take them.
    """
    tables, ways = unowned_tables(tables), unowned_ways(ways)
    starts, nodes = unowned(start.starts), unowned(start.nodes)
    events, balls, begin, weight = unowned(sheets.events), unowned(sheets.balls), unowned(sheets.begin), maps[3]
    while progress[0] < sheets.branch.shape[0]:
        s = progress[0]
        if progress[1] == LAST_STAMP:
            sensor.taken[:] = 0
            progress[1] = 0
        progress[1] += 1
        start.cursor[:] = 0
        tiled, found = scatter_sheet(
            sensor.plane, sensor.branch, sensor.flags, sheets.runs[sheets.first[s] : sheets.first[s + 1]],
            tables, ways, grid, weight[weight.shape[0] - 1], sheets.enough[s], progress[1], sensor.taken,
            start.cursor, start.listed, start.measured, block, starts, nodes,
        )  # fmt: skip
        if start.cursor[0] < DONE:
            return
        found = keep_nearest(tiled, found, s + 1, starts, nodes, start.slots)
        solve_in_bundle(
            tables, grid, windows, table, bed, every, events[begin[s] : begin[s + 1]],
            balls[begin[s] : begin[s + 1]], sheets.branch[s], sheets.sign[s], limits, starts[:found],
            nodes[:found], bundle, passed, block, state, trips, maps,
        )  # fmt: skip
        progress[0] = s + 1


assert np.iinfo(np.uint8).max == LAST_STAMP
