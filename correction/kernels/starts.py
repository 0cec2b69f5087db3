"""Give every node that a sheet may show the pixel from which Newton starts.

Every useful pixel covers, to first order, the parallelogram of the plane that a square around it sees; nodes
in there may start from it, and the nearest pixel wins.  The square is REACH wide each way, more than its own
half, for what first order leaves out; at the border of the sheet a whole pixel, because the sheet ends
somewhere before the next: Newton decides where.

Behind glass that magnifies, most pixels cover no node.  So a run of pixels is measured first, in vectors, and only
those whose box holds a node are looked at one by one.
"""

import math

import numpy as np

from correction.kernels.inverse import inverse_2x2
from correction.kernels.sheets import slopes
from tracer.kernels._jit import Array, kernel, unowned
from tracer.kernels.march import march_pixel_tangents

REACH = 0.7
AWAY = 2  # column of the starts
LANES = 256  # pixels measured at a time
STEP = LANES + 8  # columns a cache line's multiple apart, but no power of two
XU, XV, YU, YV, C, R, SIDE, HIT = (k * STEP for k in range(8))
MEASURES = 8 * STEP


@kernel
def measure_run(
    plane: Array,
    branch: Array,
    code: Array,
    grid: Array,
    rows: int,
    columns: int,
    line: int,
    first: int,
    count: int,
    begins: bool,
    ends: bool,
    out: Array,
) -> None:
    """Derivatives, node coordinates, reach, and whether a node may lie within it, of `count` pixels of a line.

    ``out`` (MEASURES,) holds them in columns.  A run begins with the first pixel, or ends with the last, if said
    so.  A pixel without derivatives is a hit: it is asked for them.
    """
    height = branch.shape[0]
    up, down = max(0, line - 1), min(height - 1, line + 1)
    x0, y0, per_mm = grid[0], grid[1], 1.0 / grid[2]
    right, bottom = columns - 1.0, rows - 1.0
    first = max(first, 1)  # always so; said for the compiler, which must not ask every index for its sign
    for k in range(count):
        i = first + k
        own = code[line, i] >> 1
        inner = (code[up, i] >> 1 == own) & (code[down, i] >> 1 == own)
        side = REACH if inner else 1.0
        out[SIDE + k] = side
        out[HIT + k] = 1.0 if code[line, i] & 1 else 0.0
    out[SIDE] = 1.0 if begins else out[SIDE]
    out[SIDE + count - 1] = 1.0 if ends else out[SIDE + count - 1]
    for k in range(count):
        i = first + k
        xu, xv, yu, yv = slopes(plane, branch, up, line, down, i)
        c, r = (plane[line, 2 * i] - x0) * per_mm, (y0 - plane[line, 2 * i + 1]) * per_mm
        scale = out[SIDE + k] * per_mm
        c_half, r_half = scale * (abs(xu) + abs(xv)), scale * (abs(yu) + abs(yv))
        empty = np.ceil(c - c_half) > np.floor(c + c_half)
        empty |= np.ceil(r - r_half) > np.floor(r + r_half)
        empty |= (c + c_half < 0.0) | (r + r_half < 0.0) | (c - c_half > right) | (r - r_half > bottom)
        out[XU + k], out[XV + k], out[YU + k], out[YV + k] = xu, xv, yu, yv
        out[C + k], out[R + k] = c, r
        out[HIT + k] = 0.0 if empty else out[HIT + k]


@kernel
def give_starts(
    line: int,
    first: int,
    count: int,
    measured: Array,
    tables: tuple[Array, Array, Array],
    grid: Array,
    weight: Array,
    enough: np.float32,
    base: int,
    found: int,
    places: Array,
    starts: Array,
    nodes: Array,
) -> int:
    """Starts for the nodes around measured pixels; see `scatter_sheet`.  ``found`` nodes had one before."""
    rows, columns = places.shape
    pitch, per_mm = grid[2], 1.0 / grid[2]
    for k in range(count):
        if measured[HIT + k] == 0.0:
            continue
        i, c, r, reach = first + k, measured[C + k], measured[R + k], measured[SIDE + k]
        xu, xv, yu, yv = measured[XU + k], measured[XV + k], measured[YU + k], measured[YV + k]
        if xu * xv * yu * yv * 0.0 != 0.0:
            _, _, _, xu, xv, yu, yv, _, _, _ = march_pixel_tangents(
                float(i), float(line), tables[0], tables[1], tables[2]
            )
        scale = reach * per_mm
        c_half, r_half = scale * (abs(xu) + abs(xv)), scale * (abs(yu) + abs(yv))
        c_first, c_last = max(0, math.ceil(c - c_half)), min(columns - 1, math.floor(c + c_half))
        r_first, r_last = max(0, math.ceil(r - r_half)), min(rows - 1, math.floor(r + r_half))
        ux, uy, vx, vy = inverse_2x2(xu, xv, yu, yv)
        for row in range(r_first, r_last + 1):
            ey = -(row - r) * pitch
            for column in range(c_first, c_last + 1):
                ex = (column - c) * pitch
                du, dv = ux * ex + uy * ey, vx * ex + vy * ey
                if not (abs(du) <= reach and abs(dv) <= reach):
                    continue
                place, away = places[row, column] - base, du * du + dv * dv
                if place < 0:
                    if weight[row, column] >= enough:
                        continue
                    place = found
                    places[row, column], nodes[place] = base + place, row * columns + column
                    found += 1
                elif not away < starts[place, AWAY]:
                    continue
                starts[place, 0], starts[place, 1], starts[place, AWAY] = i + du, line + dv, away
    return found


@kernel
def scatter_sheet(
    plane: Array,
    branch: Array,
    code: Array,
    runs: Array,
    tables: tuple[Array, Array, Array],
    grid: Array,
    weight: Array,
    enough: np.float32,
    base: int,
    places: Array,
    starts: Array,
    nodes: Array,
    measured: Array,
) -> int:
    """Scatter the starts of one sheet; how many nodes it may show.

    ``plane`` (H, 2 W), ``branch``, ``code`` (H, W) as in ``correction.kernels.sheets``, ``runs`` (R, RUN) those of
    the sheet, ``tables`` camera, spheres, rods.  Nodes whose ``weight`` (h, w) is `enough` are left out.

    ``nodes`` (N,) int32 receives the flat numbers of the nodes, ``starts`` (N, 3) their start u, v and its squared
    distance from the pixel; ``places`` (h, w) int32, where a node stands in these plus `base`, less if nowhere.
    ``measured`` (MEASURES,) is scratch.
    """
    rows, columns = places.shape
    plane, branch, code, runs = unowned(plane), unowned(branch), unowned(code), unowned(runs)
    weight, places, starts, nodes = unowned(weight), unowned(places), unowned(starts), unowned(nodes)
    tables = unowned(tables[0]), unowned(tables[1]), unowned(tables[2])
    grid, measured = unowned(grid), unowned(measured)
    found = 0
    for k in range(runs.shape[0]):
        line, first, last = runs[k, 0], runs[k, 1], runs[k, 2]
        for low in range(first, last, LANES):
            count = min(LANES, last - low)
            begins, ends = low == first, low + count == last
            measure_run(plane, branch, code, grid, rows, columns, line, low, count, begins, ends, measured)
            found = give_starts(
                line, low, count, measured, tables, grid, weight, enough, base, found, places, starts, nodes
            )
    return found
