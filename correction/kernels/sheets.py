"""Cut the sensor into sheets: connected regions of one branch and one sign of det d plane / d pixel.

Derivatives come from differences of neighbouring pixels of one branch (central where both neighbours are of
it): nothing is traced.  They only place starts and draw the line along a fold; Newton works with analytic
derivatives, and next to a fold the view is magnified beyond what is kept.  Pixels without a neighbour of their
branch in a row or a column get the analytic ones.

Pixels get a code, 4 branch + 2 (det < 0) + useful, 0 outside glass; useful are pixels whose view is not shrunk
too much to start from.  Equal neighbouring codes but for the last bit make a run of a row; runs that touch,
diagonals included, are joined by union-find.
"""

import math

import numpy as np

from correction.kernels.inverse import inverse_2x2, stretch
from tracer.kernels._jit import Array, kernel, kernel_inlined
from tracer.kernels.march import RECOVERED, march_pixel_tangents

LONELY = 0xFFFFFFFF
REACH = 0.7
AWAY = 2  # column of the starts
TILE, SHIFT = 64, 6  # nodes along a side of a tile of the grid
RUN = 4  # row, first column, last column + 1, code without its last bit

singular_values = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]


@kernel_inlined
def slopes(plane: Array, branch: Array, up: int, row: int, down: int, i: int) -> tuple[float, ...]:
    """dx/du, dx/dv, dy/du, dy/dv at pixel (row, i) from its neighbours; NaN if it has none in one direction."""
    own = branch[row, i]
    left, right = branch[row, i - 1] == own, branch[row, i + 1] == own
    above, below = (branch[up, i] == own) & (up != row), (branch[down, i] == own) & (down != row)
    x, y = plane[row, 2 * i], plane[row, 2 * i + 1]
    xl, yl = plane[row, 2 * i - 2], plane[row, 2 * i - 1]
    xr, yr = plane[row, 2 * i + 2], plane[row, 2 * i + 3]
    xa, ya = plane[up, 2 * i], plane[up, 2 * i + 1]
    xb, yb = plane[down, 2 * i], plane[down, 2 * i + 1]
    xl, yl, xr, yr = xl if left else x, yl if left else y, xr if right else x, yr if right else y
    xa, ya, xb, yb = xa if above else x, ya if above else y, xb if below else x, yb if below else y
    across = 0.5 if left & right else 1.0
    across = across if left | right else math.nan
    along = 0.5 if above & below else 1.0
    along = along if above | below else math.nan
    return (xr - xl) * across, (xb - xa) * along, (yr - yl) * across, (yb - ya) * along


@kernel_inlined
def code_of(branch: int, xu: float, xv: float, yu: float, yv: float, longest: float) -> int:
    """Code of a pixel; `longest` [mm] is the largest singular value of a useful pixel's derivatives."""
    _, high = singular_values(xu, xv, yu, yv)
    return 4 * branch + (2 if xu * yv - xv * yu < 0.0 else 0) + (1 if high <= longest else 0)


@kernel
def code_rows(
    camera: Array,
    spheres: Array,
    rods: Array,
    longest: float,
    first: int,
    last: int,
    plane: Array,
    branch: Array,
    status: Array,
    code: Array,
    counts: Array,
) -> None:
    """Codes (H, W) uint32 of rows first..last-1 and the number of runs in each, counts (H,) int64.

    ``plane`` (H, 2 W) holds x and y in turn.  The outermost columns stay without code.
    """
    height, width = branch.shape
    for row in range(first, last):
        up, down = max(0, row - 1), min(height - 1, row + 1)
        some = 0
        for i in range(width):
            code[row, i] = 0
            some += branch[row, i] != 0
        counts[row] = 0
        if some == 0:
            continue
        lonely = 0
        for j in range(width - 2):
            i = j + 1
            xu, xv, yu, yv = slopes(plane, branch, up, row, down, i)
            own = code_of(branch[row, i], xu, xv, yu, yv, longest)
            alone = xu * xv * yu * yv * 0.0 != 0.0
            here = (branch[row, i] != 0) & (status[row, i] == RECOVERED)
            own = LONELY if alone else own
            code[row, i] = own if here else 0
            lonely += alone & here
        if lonely != 0:
            for i in range(width):
                if code[row, i] == LONELY:
                    s, _, _, xu, xv, yu, yv, _, _, _ = march_pixel_tangents(
                        float(i), float(row), camera, spheres, rods
                    )
                    code[row, i] = code_of(branch[row, i], xu, xv, yu, yv, longest) if s == RECOVERED else 0
        runs = 0
        for j in range(width - 1):
            i = j + 1
            runs += (code[row, i] >> 1 != code[row, i - 1] >> 1) & (code[row, i] != 0)
        counts[row] = runs


@kernel
def list_runs(code: Array, first: int, last: int, begin: Array, runs: Array) -> None:
    """Write the runs of rows first..last-1 to runs (R, RUN) int64; those of row r begin at begin[r]."""
    width = code.shape[1]
    for row in range(first, last):
        k = begin[row]
        if begin[row + 1] == k:
            continue
        i = 0
        while i < width:
            own = code[row, i] >> 1
            start = i
            i += 1
            while i < width and code[row, i] >> 1 == own:
                i += 1
            if own != 0:
                runs[k, 0], runs[k, 1], runs[k, 2], runs[k, 3] = row, start, i, own
                k += 1


@kernel
def root_of(parent: Array, k: int) -> int:
    """First run of the sheet that run k belongs to; halves the way for the next who asks."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def join_runs(begin: Array, runs: Array, parent: Array) -> None:
    """Join runs of equal code in neighbouring rows that touch: parent (R,) int64 becomes the sheet's first run."""
    for k in range(runs.shape[0]):
        parent[k] = k
    for row in range(1, begin.shape[0] - 1):
        above = begin[row - 1]
        for k in range(begin[row], begin[row + 1]):
            while above < begin[row] and runs[above, 2] < runs[k, 1]:
                above += 1
            other = above
            while other < begin[row] and runs[other, 1] <= runs[k, 2]:
                if runs[other, 3] == runs[k, 3]:
                    a, b = root_of(parent, other), root_of(parent, k)
                    parent[max(a, b)] = min(a, b)
                other += 1
    for k in range(runs.shape[0]):
        parent[k] = root_of(parent, k)


@kernel
def count_useful(code: Array, runs: Array, parent: Array, useful: Array) -> None:
    """Add to useful (R,) int64, in the place of each sheet's first run, its pixels that are worth a start."""
    for k in range(runs.shape[0]):
        for i in range(runs[k, 1], runs[k, 2]):
            useful[parent[k]] += code[runs[k, 0], i] & 1


@kernel
def scatter_sheet(
    plane: Array,
    branch: Array,
    code: Array,
    runs: Array,
    tables: tuple[Array, Array, Array],
    grid: Array,
    tiles: Array,
    weight: Array,
    enough: np.float32,
    base: int,
    places: Array,
    starts: Array,
    nodes: Array,
) -> int:
    """Give the nodes that one sheet may show the pixel from which Newton starts; how many there are.

    Every useful pixel covers, to first order, the parallelogram of the plane that a square around it sees; nodes
    in there may start from it, and the nearest pixel wins.  The square is REACH wide each way, more than its own
    half, for what first order leaves out; at the border of the sheet a whole pixel, because the sheet ends
    somewhere before the next: Newton decides where.

    ``plane`` (H, 2 W), ``branch``, ``code`` (H, W) as in ``correction.kernels.sheets``, ``runs`` (R, RUN) those of
    the sheet, ``tables`` camera, spheres, rods.  Left out are nodes whose ``weight`` (h, w) is `enough` and pixels
    that show a tile of TILE x TILE nodes not marked in ``tiles``.

    ``nodes`` (N,) int32 receives the flat numbers of the nodes, ``starts`` (N, 3) their start u, v and its squared
    distance from the pixel; ``places`` (h, w) int32, where a node stands in these plus `base`, less if nowhere.
    """
    height = branch.shape[0]
    rows, columns = places.shape
    per_mm = 1.0 / grid[2]
    found = 0
    for k in range(runs.shape[0]):
        line = runs[k, 0]
        up, down = max(0, line - 1), min(height - 1, line + 1)
        for i in range(runs[k, 1], runs[k, 2]):
            if not code[line, i] & 1:
                continue
            c, r = (plane[line, 2 * i] - grid[0]) * per_mm, (grid[1] - plane[line, 2 * i + 1]) * per_mm
            tile_row, tile_column = (
                int(min(max(r, 0.0), rows - 1.0)) >> SHIFT,
                int(min(max(c, 0.0), columns - 1.0)) >> SHIFT,
            )
            if tiles[tile_row, tile_column] == 0:
                continue
            xu, xv, yu, yv = slopes(plane, branch, up, line, down, i)
            if xu * xv * yu * yv * 0.0 != 0.0:
                _, _, _, xu, xv, yu, yv, _, _, _ = march_pixel_tangents(
                    float(i), float(line), tables[0], tables[1], tables[2]
                )
            reach = REACH if i > runs[k, 1] and i + 1 < runs[k, 2] else 1.0
            if code[up, i] >> 1 != code[line, i] >> 1 or code[down, i] >> 1 != code[line, i] >> 1:
                reach = 1.0
            scale = reach * per_mm
            c_half, r_half = scale * (abs(xu) + abs(xv)), scale * (abs(yu) + abs(yv))
            c_first, c_last = max(0, math.ceil(c - c_half)), min(columns - 1, math.floor(c + c_half))
            r_first, r_last = max(0, math.ceil(r - r_half)), min(rows - 1, math.floor(r + r_half))
            if c_first > c_last or r_first > r_last:
                continue
            ux, uy, vx, vy = inverse_2x2(xu, xv, yu, yv)
            for row in range(r_first, r_last + 1):
                ey = -(row - r) * grid[2]
                for column in range(c_first, c_last + 1):
                    ex = (column - c) * grid[2]
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
