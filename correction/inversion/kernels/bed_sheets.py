"""Many sheets in one call: the map behind a bed has tens of thousands, mostly of some dozen nodes.

What ``correction.inversion.invert`` does for one large sheet after the other is done here for all of them, one
after the other: starts scattered, of those from the edges the nearest of each node kept, nodes solved in blocks
and verified.  A bed's rays are verified in a bundle (``tracer.kernels.bundle``): what a block of Newton has
solved is traced once more with all bodies, and only counts if the ray meets the very spheres of the sheet, in
this order, and nothing else.

All cores work on it: each takes some rows of nodes, and of every sheet that may reach them those nodes alone.
A node's views come in the order of the sheets and its starts from the sheet alone, so its bits are those of one
call for all rows.

**Starts** (`scatter_sheet`) give every node that a sheet may show the pixel from which Newton begins.  Every
useful pixel covers, to first order, the parallelogram of the plane that a square around it sees; nodes in there
may start from it, at the place that second order says.  A sheet is gone through twice:

*tiling* with squares HALF a pixel each way by pixels at no edge, whose derivatives change little; the first pixel
that reaches a node has it.  At the *edges* first order has to do, and squares are larger: REACH where the view is
BENT or pixels next to it are not useful, a whole pixel at the border of the sheet, because the sheet ends
somewhere before the next: Newton decides where.  Of the pixels that reach a node there the nearest has it,
which the caller sees to.

Behind glass that magnifies most pixels cover no node: only those that are flagged NEAR are looked at.

With second derivatives it is also known how fast the Jacobian changes, and so how small a Newton step must be for
the Jacobian before it to be good enough after it: |J^-1 dJ| <= 2 step max |J^-1 d2(x, y)|, summed over uu, uv, vv.
"""

from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.newton import (
    CONVERGED,
    TOLERANCE_PX,
    BranchSequences,
    SheetPath,
    U,
    V,
    inverse_2x2,
    slopes_along,
)
from correction.inversion.kernels.sheets import BORDER, EDGE, FIRST_ROW, HALF, LAST_ROW, NEAR, Sensor, slopes
from correction.inversion.kernels.views import OTHER_PATH, InverseProblem, ViewMaps, solve_sheet
from ground.jit import Array, kernel, kernel_inlined
from piv.resampling.kernels.bspline import NON_NEGATIVE
from tracer.kernels.bundle import follow_bundle
from tracer.kernels.chain import TRIP
from tracer.kernels.lanes import END_DZ, EVENTS, FATE, Bed, Bundle
from tracer.kernels.packets import DX, DY, hit_plane, whole_vectors
from tracer.kernels.packets import LANES as IN_BUNDLE
from tracer.kernels.rays import MAX_EVENTS, trace_pixel_tangents
from tracer.kernels.tiles import aim_lanes, end_behind, pass_windows
from tracer.kernels.world import RECOVERED as TRACED
from tracer.kernels.world import Tables

REACH, WHOLE = 0.7, 1.0
# Relative error of derivatives that are not traced again after the last step; float32 holds 6e-8
SHARP = 1e-7
LOOSE_PX = 1e-4  # the last step is never larger, however straight the view: it leaves about its square
MOST_BEND_PX = 0.05  # a second order larger than this is not to be trusted
TILING, EDGES, DONE = 0, 1, 2  # how far a sheet is
ENOUGH_NODES = 8192  # starts of one portion
LANES = 128  # pixels measured at a time
STEP = LANES + 8  # columns a cache line's multiple apart, but no power of two
REACHED, C, R, LEFT, RIGHT, TOP, BOTTOM = (k * STEP for k in range(7))
XU, XV, YU, YV, XUU, XUV, XVV, YUU, YUV, YVV = (k * STEP for k in range(7, 17))
UX, UY, VX, VY, UUU, UUV, UVV, VUU, VUV, VVV = XU, XV, YU, YV, XUU, XUV, XVV, YUU, YUV, YVV
WITHIN = 17 * STEP
MEASURES = 18 * STEP

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]


MET = -1  # the trip of a ray that met the spheres of its sheet
LAST_STAMP = 255


@kernel_inlined
def mixed_derivative(plane: Array, branch: Array, up: int, row: int, down: int, i: int) -> tuple[float, float]:
    """d2x/du dv and d2y/du dv at pixel (row, i) from its diagonal neighbours, 0 unless all are of its branch."""
    own = branch[row, i]
    there = (branch[up, i - 1] == own) & (branch[up, i + 1] == own) & (up + 2 == down)
    there &= (branch[down, i - 1] == own) & (branch[down, i + 1] == own)
    xx = plane[up, 2 * i - 2] - plane[up, 2 * i + 2] - plane[down, 2 * i - 2] + plane[down, 2 * i + 2]
    yy = plane[up, 2 * i - 1] - plane[up, 2 * i + 3] - plane[down, 2 * i - 1] + plane[down, 2 * i + 3]
    return 0.25 * xx if there else 0.0, 0.25 * yy if there else 0.0


class StartScratch(NamedTuple):
    """Memory for the starts of one sheet.

    Parameters
    ----------
    cursor : (5,) int64
        Where to begin and then where to go on: TILING, EDGES or DONE, run, column; starts that fill a portion;
        calls of `keep_nearest` so far.
    listed, measured, block : (LANES,) int64, (MEASURES,), (NEWTON_NUMBERS,)
        Scratch.
    starts, nodes : (N, 4), (N, 2) int32
        Start u, v, its squared distance from the pixel and how small a Newton step must be to be the last; row and
        column.  Both hold what one pixel gives beyond a portion.
    """

    cursor: Array
    listed: Array
    measured: Array
    block: Array
    starts: Array
    nodes: Array


class Wanted(NamedTuple):
    """Nodes that a sheet may show.

    Parameters
    ----------
    weight, enough, stamp : (h, w) float32, float32, int
        Those whose weight is below `enough`, and that are not taken with `stamp`.
    first, last : int
        In rows first..last-1.
    """

    weight: Array
    enough: np.float32
    stamp: int
    first: int
    last: int


@kernel
def measure_pixels(
    line: int, count: int, tiling: bool, sensor: Sensor, grid: Array, listed: Array, m: Array
) -> int:
    """Reach, node coordinates and derivatives of `count` pixels of a line; how many have no derivatives.

    ``listed`` (LANES,) int64 are their columns, ``m`` (MEASURES,) receives.
    """
    plane, branch, flags, _ = sensor
    up, down = max(0, line - 1), min(branch.shape[0] - 1, line + 1)
    x0, y0, per_mm = grid[0], grid[1], 1.0 / grid[2]
    isolated = 0
    for k in range(count):
        i = listed[k] & NON_NEGATIVE
        xu, xv, yu, yv, xuu, xvv, yuu, yvv = slopes(plane, branch, up, line, down, i)
        m[XU + k], m[XV + k], m[YU + k], m[YV + k] = xu, xv, yu, yv
        m[XUU + k], m[XVV + k], m[YUU + k], m[YVV + k] = xuu, xvv, yuu, yvv
        m[XUV + k], m[YUV + k] = mixed_derivative(plane, branch, up, line, down, i)
        m[C + k], m[R + k] = (plane[line, 2 * i] - x0) * per_mm, (y0 - plane[line, 2 * i + 1]) * per_mm
        reach = WHOLE if flags[line, i] & BORDER else REACH
        m[REACHED + k] = HALF if tiling else reach
        m[WITHIN + k] = TOLERANCE_PX if (flags[line, i] & BORDER != 0) | (up + 2 != down) else LOOSE_PX
        isolated += xu * xv * yu * yv * 0.0 != 0.0  # NaN without a neighbour of its branch
    return isolated


@kernel
def trace_isolated_pixels(
    line: int, count: int, tables: Tables, branch: Array, sequences: BranchSequences, scratch: StartScratch
) -> None:
    """Derivatives of the measured pixels that have no neighbours, as traced."""
    listed, m = scratch.listed, scratch.measured
    for k in range(count):
        if m[XU + k] * m[XV + k] * m[YU + k] * m[YV + k] * 0.0 != 0.0:
            u, v = float(listed[k]), float(line)
            if sequences.begin.shape[0] > 0:
                m[XU + k], m[XV + k], m[YU + k], m[YV + k] = slopes_along(
                    u, v, branch[line, listed[k]], sequences, tables[0], tables[1].spheres, scratch.block
                )
            else:
                _, _, _, m[XU + k], m[XV + k], m[YU + k], m[YV + k], _, _, _ = trace_pixel_tangents(u, v, *tables)
            for column in (XUU, XUV, XVV, YUU, YUV, YVV):
                m[column + k] = 0.0


@kernel
def invert_measures(count: int, per_mm: float, right: float, wanted: Wanted, m: Array) -> None:
    """Boxes of wanted nodes around measured pixels, and derivatives by those of u and v by x and y, in place."""
    top, bottom = float(wanted.first), wanted.last - 1.0
    for k in range(count):
        xu, xv, yu, yv = m[XU + k], m[XV + k], m[YU + k], m[YV + k]
        xuu, xuv, xvv, yuu, yuv, yvv = m[XUU + k], m[XUV + k], m[XVV + k], m[YUU + k], m[YUV + k], m[YVV + k]
        ux, uy, vx, vy = inverse_inlined(xu, xv, yu, yv)
        c, r, reach = m[C + k], m[R + k], m[REACHED + k] * per_mm
        c_half, r_half = reach * (abs(xu) + abs(xv)), reach * (abs(yu) + abs(yv))
        m[LEFT + k], m[RIGHT + k] = max(0.0, np.ceil(c - c_half)), min(right, np.floor(c + c_half))
        m[TOP + k], m[BOTTOM + k] = max(top, np.ceil(r - r_half)), min(bottom, np.floor(r + r_half))
        m[UX + k], m[UY + k], m[VX + k], m[VY + k] = ux, uy, vx, vy
        m[UUU + k], m[VUU + k] = 0.5 * (ux * xuu + uy * yuu), 0.5 * (vx * xuu + vy * yuu)
        m[UUV + k], m[VUV + k] = ux * xuv + uy * yuv, vx * xuv + vy * yuv
        m[UVV + k], m[VVV + k] = 0.5 * (ux * xvv + uy * yvv), 0.5 * (vx * xvv + vy * yvv)
        bend_u = abs(m[UUU + k]) + abs(m[UUV + k]) + abs(m[UVV + k])
        bend_v = abs(m[VUU + k]) + abs(m[VUV + k]) + abs(m[VVV + k])
        m[WITHIN + k] = max(min(SHARP / (2.0 * max(bend_u, bend_v)), m[WITHIN + k]), TOLERANCE_PX)


@kernel
def give_starts(
    line: int,
    count: int,
    tiling: bool,
    pitch: float,
    taken: Array,
    wanted: Wanted,
    found: int,
    scratch: StartScratch,
) -> tuple[int, int]:
    """Starts for the nodes around measured pixels; of how many pixels, and nodes with the `found` ones before."""
    cursor, listed, m, _, starts, nodes = scratch
    weight, enough, stamp, _, _ = wanted
    for k in range(count):
        if found >= cursor[3]:
            return k, found
        i, c, r, reach = listed[k], m[C + k], m[R + k], m[REACHED + k]
        ux, uy, vx, vy = m[UX + k], m[UY + k], m[VX + k], m[VY + k]
        left, right = int(m[LEFT + k]), int(m[RIGHT + k])
        for row in range(int(m[TOP + k]), int(m[BOTTOM + k]) + 1):
            row = row & NON_NEGATIVE
            ey = -(row - r) * pitch
            for column in range(left, right + 1):
                column = column & NON_NEGATIVE
                ex = (column - c) * pitch
                du, dv = ux * ex + uy * ey, vx * ex + vy * ey
                if not (abs(du) <= reach and abs(dv) <= reach):
                    continue
                if taken[row, column] == stamp or weight[row, column] >= enough:
                    continue
                uu, uv, vv = du * du, du * dv, dv * dv
                bend_u = m[UUU + k] * uu + m[UUV + k] * uv + m[UVV + k] * vv
                bend_v = m[VUU + k] * uu + m[VUV + k] * uv + m[VVV + k] * vv
                if not (tiling and abs(bend_u) + abs(bend_v) <= MOST_BEND_PX):
                    bend_u = bend_v = 0.0
                starts[found, 0], starts[found, 1] = i + (du - bend_u), line + (dv - bend_v)
                starts[found, 2], starts[found, 3] = uu + vv, m[WITHIN + k]
                nodes[found, 0], nodes[found, 1] = row, column
                if tiling:
                    taken[row, column] = stamp
                found += 1
    return count, found


@kernel
def scatter_sheet(
    problem: InverseProblem, sensor: Sensor, runs: Array, sequences: BranchSequences, wanted: Wanted, found: int,
    scratch: StartScratch,
) -> tuple[int, int]:  # fmt: skip
    """Scatter starts of one sheet, whose ``runs`` are (R, RUN), until a portion is full or it is done.

    Returns how many came from the tiling, and how many with those from the edges, which may name a node again,
    with the `found` ones that are there.  Nodes get the stamp of the sheet from the tiling.
    """
    flags, taken, grid, tables = sensor.flags, sensor.taken, problem.grid, problem.tables
    cursor, listed, measured, tiled = scratch.cursor, scratch.listed, scratch.measured, found
    for sweep in range(cursor[0], DONE):
        asked = NEAR | EDGE | BORDER if sweep == TILING else EDGE | BORDER
        for run in range(cursor[1], runs.shape[0]):
            if runs[run, LAST_ROW] < wanted.first or runs[run, FIRST_ROW] >= wanted.last:
                continue
            line, i, last = runs[run, 0], max(runs[run, 1], cursor[2]), runs[run, 2]
            while i < last:
                count = 0
                while i < last and count < LANES:
                    listed[count] = i
                    flag = flags[line, i] & asked
                    count += (flag == NEAR) if sweep == TILING else (flag != 0)
                    i += 1
                if measure_pixels(line, count, sweep == TILING, sensor, grid, listed, measured) != 0:
                    trace_isolated_pixels(line, count, tables, sensor.branch, sequences, scratch)
                invert_measures(count, 1.0 / grid[2], taken.shape[1] - 1.0, wanted, measured)
                given, found = give_starts(line, count, sweep == TILING, grid[2], taken, wanted, found, scratch)
                if given < count:
                    cursor[0], cursor[1], cursor[2] = sweep, run, listed[given]
                    return found if sweep == TILING else tiled, found
            cursor[2] = 0
        cursor[1] = 0
        tiled = found if sweep == TILING else tiled
    cursor[0] = DONE
    return tiled, found


class BedSheets(NamedTuple):
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
    sequences : BranchSequences
        Spheres of every branch.
    """

    branch: Array
    sign: Array
    events: Array
    balls: Array
    begin: Array
    runs: Array
    first: Array
    enough: Array
    sequences: BranchSequences


class BundleScratch(NamedTuple):
    """Memory of one thread: a bundle, ``passed``, ``state`` (GROUP,) int64, ``block``, ``trips`` of a block."""

    bundle: Bundle
    passed: Array
    block: Array
    state: Array
    trips: Array


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
    count: int, problem: InverseProblem, path: SheetPath, bed: Bed, scratch: BundleScratch
) -> None:
    """MET for converged pixels whose ray meets the spheres of the path, in this order, and no others."""
    (bundle, passed, b, state, trips), windows, balls = scratch, problem.windows, path.balls
    rays, some, events = bundle.rays, -1, balls.shape[0]
    for i in range(count):
        trips[TRIP + i] = OTHER_PATH
        if state[i] == CONVERGED:
            some = i
    if some < 0:
        return
    full = whole_vectors(count)
    for i in range(full):
        good = i < count and state[i] == CONVERGED
        rays[DX + i], rays[DY + i] = b[U + i] if good else b[U + some], b[V + i] if good else b[V + some]
    aim_lanes(full, problem.tables[0], rays, bundle.marks)
    behind = windows.shape[0] > 0
    if behind:
        pass_windows(full, windows, rays, passed)
    follow_bundle(count, MAX_EVENTS, bed, bundle)
    if behind:
        for i in range(count, full):
            bundle.ends[END_DZ + i] = -1.0
        hit_plane(full, bundle.ends)
        end_behind(count, windows[windows.shape[0] - 1], passed, bundle.ends, bundle.fates)
    for i in range(count):
        same = state[i] == CONVERGED and bundle.fates[FATE + i] == TRACED and bundle.ends[END_DZ + i] < 0.0
        same = same and bundle.fates[EVENTS + i] == events
        for e in range(events if same else 0):
            same = same and bundle.trail[e * IN_BUNDLE + i] == balls[e]
        trips[TRIP + i] = MET if same else OTHER_PATH


@kernel
def solve_in_bundle(
    problem: InverseProblem, path: SheetPath, starts: Array, nodes: Array, bed: Bed, scratch: BundleScratch,
    maps: ViewMaps,
) -> None:  # fmt: skip
    """Solve nodes of one sheet from their starts and keep the views, as `solve_nodes`, verified in bundles."""
    solve_sheet(problem, path, starts, nodes, verify_in_bundle, bed, scratch, maps)


@kernel
def solve_edges(
    problem: InverseProblem, sheet: tuple[SheetPath, Array, BranchSequences], sensor: Sensor, wanted: Wanted,
    bed: Bed, room: tuple[StartScratch, Array], scratch: BundleScratch, maps: ViewMaps,
) -> None:  # fmt: skip
    """Solve the nodes at the edges of a sheet where they are more than a portion: some rows at a time."""
    (path, runs, sequences), (start, slots) = sheet, room
    first, last = wanted.first, wanted.last
    while first < wanted.last:
        part = Wanted(wanted.weight, wanted.enough, wanted.stamp, first, last)
        start.cursor[0], start.cursor[1], start.cursor[2] = EDGES, 0, 0
        found = 0
        while start.cursor[0] < DONE and (found < start.cursor[3] // 2 or first + 1 == last):
            _, found = scatter_sheet(problem, sensor, runs, sequences, part, found, start)
            start.cursor[4] += 1
            found = keep_nearest(0, found, start.cursor[4], start.starts, start.nodes, slots)
        if start.cursor[0] < DONE:
            last = first + (last - first) // 2
            continue
        solve_in_bundle(problem, path, start.starts[:found], start.nodes[:found], bed, scratch, maps)
        first, last = last, wanted.last


@kernel
def solve_sheets(
    problem: InverseProblem, bed: Bed, sheets: BedSheets, share: tuple[Array, int, int], sensor: Sensor,
    room: tuple[StartScratch, Array], scratch: BundleScratch, maps: ViewMaps,
) -> None:  # fmt: skip
    """Solve some nodes of some sheets.

    `share`: the numbers (S,) of the sheets, and the first row of nodes and the one after the last. `room` is
    scratch for starts and the slots of `keep_nearest`.
    """
    (some, first, last), (start, slots), weight, stamp = share, room, maps.weight, 0
    for k in range(some.shape[0]):
        s = some[k]
        if stamp == LAST_STAMP:
            sensor.taken[first:last] = 0
            stamp = 0
        stamp += 1
        start.cursor[0], start.cursor[1], start.cursor[2] = TILING, 0, 0
        runs = sheets.runs[sheets.first[s] : sheets.first[s + 1]]
        wanted = Wanted(weight[weight.shape[0] - 1], sheets.enough[s], stamp, first, last)
        low, high = sheets.begin[s], sheets.begin[s + 1]
        path = SheetPath(
            sheets.events[low:high], sheets.balls[low:high], 0, MET, sheets.branch[s], sheets.sign[s], True
        )
        tiled, found = scatter_sheet(problem, sensor, runs, sheets.sequences, wanted, 0, start)
        while start.cursor[0] == TILING:
            solve_in_bundle(problem, path, start.starts[:found], start.nodes[:found], bed, scratch, maps)
            tiled, found = scatter_sheet(problem, sensor, runs, sheets.sequences, wanted, 0, start)
        is_done = start.cursor[0] == DONE
        start.cursor[4] += 1
        kept = keep_nearest(tiled, found, start.cursor[4], start.starts, start.nodes, slots) if is_done else tiled
        solve_in_bundle(problem, path, start.starts[:kept], start.nodes[:kept], bed, scratch, maps)
        if not is_done:
            sheet = path, runs, sheets.sequences
            solve_edges(problem, sheet, sensor, wanted, bed, room, scratch, maps)


assert np.iinfo(np.uint8).max == LAST_STAMP
