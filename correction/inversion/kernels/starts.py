"""Give every node that a sheet may show the pixel from which Newton starts.

Every useful pixel covers, to first order, the parallelogram of the plane that a square around it sees; nodes
in there may start from it, at the place that second order says.  A sheet is gone through twice:

*tiling* with squares HALF a pixel each way by pixels at no edge, whose derivatives change little; the first pixel
that reaches a node has it.  At the *edges* first order has to do, and squares are larger: REACH where the view is
BENT or pixels next to it are not useful, a whole pixel at the border of the sheet, because the sheet ends
somewhere before the next: Newton decides where.  Of the pixels that reach a node there the nearest has it,
which the caller sees to.

Behind glass that magnifies most pixels cover no node: only those that are flagged NEAR are looked at.

With second derivatives it is also known how fast the Jacobian changes, and so how small a Newton step must be for
the Jacobian before it to be good enough after it: |J^-1 dJ| <= 2 step max |J^-1 d2(x, y)|, summed over uu, uv, vv.
"""

import numpy as np

from correction.inversion.kernels.inverse import TOLERANCE_PX, Tables, inverse_2x2, unowned_tables
from correction.inversion.kernels.newton import Ways, slopes_along, unowned_ways
from correction.inversion.kernels.sheets import BORDER, EDGE, HALF, NEAR, slopes
from ground.jit import Array, kernel, kernel_inlined, unowned
from piv.resampling.kernels.bspline import INDEX
from tracer.kernels.march import march_pixel_tangents

REACH, WHOLE = 0.7, 1.0
SHARP = 1e-7  # relative error of derivatives that are not traced again after the last step; float32 holds 6e-8
LOOSE_PX = 1e-4  # the last step is never larger, however straight the view: it leaves about its square
MOST_BEND_PX = 0.05  # a second order larger than this is not to be trusted
TILING, EDGES, DONE = 0, 1, 2  # how far a sheet is
ENOUGH_NODES = 8192  # starts after which the caller is asked to take them
LANES = 128  # pixels measured at a time
STEP = LANES + 8  # columns a cache line's multiple apart, but no power of two
REACHED, C, R, LEFT, RIGHT, TOP, BOTTOM = (k * STEP for k in range(7))
XU, XV, YU, YV, XUU, XUV, XVV, YUU, YUV, YVV = (k * STEP for k in range(7, 17))
UX, UY, VX, VY, UUU, UUV, UVV, VUU, VUV, VVV = XU, XV, YU, YV, XUU, XUV, XVV, YUU, YUV, YVV
WITHIN = 17 * STEP
MEASURES = 18 * STEP

inverse_inlined = kernel_inlined(inverse_2x2.py_func)  # type: ignore[attr-defined]


@kernel_inlined
def twist(plane: Array, branch: Array, up: int, row: int, down: int, i: int) -> tuple[float, float]:
    """d2x/du dv and d2y/du dv at pixel (row, i) from its diagonal neighbours, 0 unless all are of its branch."""
    own = branch[row, i]
    there = (branch[up, i - 1] == own) & (branch[up, i + 1] == own) & (up + 2 == down)
    there &= (branch[down, i - 1] == own) & (branch[down, i + 1] == own)
    xx = plane[up, 2 * i - 2] - plane[up, 2 * i + 2] - plane[down, 2 * i - 2] + plane[down, 2 * i + 2]
    yy = plane[up, 2 * i - 1] - plane[up, 2 * i + 3] - plane[down, 2 * i - 1] + plane[down, 2 * i + 3]
    return 0.25 * xx if there else 0.0, 0.25 * yy if there else 0.0


@kernel
def measure_pixels(
    line: int,
    count: int,
    tiling: bool,
    listed: Array,
    flags: Array,
    plane: Array,
    branch: Array,
    grid: Array,
    m: Array,
) -> int:
    """Reach, node coordinates and derivatives of `count` pixels of a line; how many have no derivatives.

    ``listed`` (LANES,) int64 are their columns, ``m`` (MEASURES,) receives.
    """
    up, down = max(0, line - 1), min(branch.shape[0] - 1, line + 1)
    x0, y0, per_mm = grid[0], grid[1], 1.0 / grid[2]
    lonely = 0
    for k in range(count):
        i = listed[k] & INDEX
        xu, xv, yu, yv, xuu, xvv, yuu, yvv = slopes(plane, branch, up, line, down, i)
        m[XU + k], m[XV + k], m[YU + k], m[YV + k] = xu, xv, yu, yv
        m[XUU + k], m[XVV + k], m[YUU + k], m[YVV + k] = xuu, xvv, yuu, yvv
        m[XUV + k], m[YUV + k] = twist(plane, branch, up, line, down, i)
        m[C + k], m[R + k] = (plane[line, 2 * i] - x0) * per_mm, (y0 - plane[line, 2 * i + 1]) * per_mm
        reach = WHOLE if flags[line, i] & BORDER else REACH
        m[REACHED + k] = HALF if tiling else reach
        m[WITHIN + k] = TOLERANCE_PX if (flags[line, i] & BORDER != 0) | (up + 2 != down) else LOOSE_PX
        lonely += xu * xv * yu * yv * 0.0 != 0.0
    return lonely


@kernel
def ask_lonely(
    line: int, count: int, listed: Array, tables: Tables, branch: Array, ways: Ways, block: Array, m: Array
) -> None:
    """Derivatives of the measured pixels that have no neighbours, as traced."""
    for k in range(count):
        if m[XU + k] * m[XV + k] * m[YU + k] * m[YV + k] * 0.0 != 0.0:
            u, v = float(listed[k]), float(line)
            if ways.begin.shape[0] > 0:
                m[XU + k], m[XV + k], m[YU + k], m[YV + k] = slopes_along(
                    u, v, branch[line, listed[k]], ways, tables[0], tables[1].spheres, block
                )
            else:
                _, _, _, m[XU + k], m[XV + k], m[YU + k], m[YV + k], _, _, _ = march_pixel_tangents(u, v, *tables)
            for column in (XUU, XUV, XVV, YUU, YUV, YVV):
                m[column + k] = 0.0


@kernel
def invert_measures(count: int, per_mm: float, right: float, bottom: float, m: Array) -> None:
    """Boxes of nodes around measured pixels, and their derivatives by those of u and v by x and y, in place."""
    for k in range(count):
        xu, xv, yu, yv = m[XU + k], m[XV + k], m[YU + k], m[YV + k]
        xuu, xuv, xvv, yuu, yuv, yvv = m[XUU + k], m[XUV + k], m[XVV + k], m[YUU + k], m[YUV + k], m[YVV + k]
        ux, uy, vx, vy = inverse_inlined(xu, xv, yu, yv)
        c, r, reach = m[C + k], m[R + k], m[REACHED + k] * per_mm
        c_half, r_half = reach * (abs(xu) + abs(xv)), reach * (abs(yu) + abs(yv))
        m[LEFT + k], m[RIGHT + k] = max(0.0, np.ceil(c - c_half)), min(right, np.floor(c + c_half))
        m[TOP + k], m[BOTTOM + k] = max(0.0, np.ceil(r - r_half)), min(bottom, np.floor(r + r_half))
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
    listed: Array,
    m: Array,
    pitch: float,
    weight: Array,
    enough: np.float32,
    stamp: int,
    found: int,
    taken: Array,
    starts: Array,
    nodes: Array,
) -> tuple[int, int]:
    """Starts for the nodes around measured pixels; of how many pixels, and nodes with the `found` ones before."""
    for k in range(count):
        if found >= ENOUGH_NODES:
            return k, found
        i, c, r, reach = listed[k], m[C + k], m[R + k], m[REACHED + k]
        ux, uy, vx, vy = m[UX + k], m[UY + k], m[VX + k], m[VY + k]
        left, right = int(m[LEFT + k]), int(m[RIGHT + k])
        for row in range(int(m[TOP + k]), int(m[BOTTOM + k]) + 1):
            row = row & INDEX
            ey = -(row - r) * pitch
            for column in range(left, right + 1):
                column = column & INDEX
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
    plane: Array,
    branch: Array,
    flags: Array,
    runs: Array,
    tables: Tables,
    ways: Ways,
    grid: Array,
    weight: Array,
    enough: np.float32,
    stamp: int,
    taken: Array,
    cursor: Array,
    listed: Array,
    measured: Array,
    block: Array,
    starts: Array,
    nodes: Array,
) -> tuple[int, int]:
    """Scatter starts of one sheet until there are ENOUGH_NODES or it is done.

    Returns how many came from the tiling, and how many with those from the edges, which may name a node again.

    ``plane`` (H, 2 W), ``branch``, ``flags`` (H, W) as in ``sheets``, ``runs`` (R, RUN) those
    of the sheet, ``tables`` camera and bodies.  Nodes whose ``weight`` (h, w) is `enough` are left out,
    and those whose ``taken`` (h, w) uint8 is `stamp`, which nodes get from the tiling.

    ``nodes`` (N, 2) int32 receives rows and columns of the nodes, ``starts`` (N, 4) their start u, v, its squared
    distance from the pixel and how small a Newton step must be to be the last; both hold what one pixel gives
    beyond ENOUGH_NODES.  ``cursor`` (3,) int64 is where to begin and then where to go on: TILING, EDGES or DONE,
    run, column.  Scratch: ``listed`` (LANES,) int64, ``measured`` (MEASURES,), ``block`` (NEWTON_NUMBERS,).
    """
    plane, branch, flags, runs = unowned(plane), unowned(branch), unowned(flags), unowned(runs)
    weight, taken, starts, nodes = unowned(weight), unowned(taken), unowned(starts), unowned(nodes)
    tables, ways, block = unowned_tables(tables), unowned_ways(ways), unowned(block)
    grid, listed, measured = unowned(grid), unowned(listed), unowned(measured)
    tiled = found = 0
    for sweep in range(cursor[0], DONE):
        asked = NEAR | EDGE | BORDER if sweep == TILING else EDGE | BORDER
        for run in range(cursor[1], runs.shape[0]):
            line, i, last = runs[run, 0], max(runs[run, 1], cursor[2]), runs[run, 2]
            while i < last:
                count = 0
                while i < last and count < LANES:
                    listed[count] = i
                    flag = flags[line, i] & asked
                    count += (flag == NEAR) if sweep == TILING else (flag != 0)
                    i += 1
                if measure_pixels(line, count, sweep == TILING, listed, flags, plane, branch, grid, measured) != 0:
                    ask_lonely(line, count, listed, tables, branch, ways, block, measured)
                invert_measures(count, 1.0 / grid[2], taken.shape[1] - 1.0, taken.shape[0] - 1.0, measured)
                given, found = give_starts(
                    line,
                    count,
                    sweep == TILING,
                    listed,
                    measured,
                    grid[2],
                    weight,
                    enough,
                    stamp,
                    found,
                    taken,
                    starts,
                    nodes,
                )
                if given < count:
                    cursor[0], cursor[1], cursor[2] = sweep, run, listed[given]
                    return found if sweep == TILING else tiled, found
            cursor[2] = 0
        cursor[1] = 0
        tiled = found if sweep == TILING else tiled
    cursor[0] = DONE
    return tiled, found
