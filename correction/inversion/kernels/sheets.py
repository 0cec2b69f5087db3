"""Cut the sensor into sheets: connected regions of one branch and one sign of det d plane / d pixel.

Derivatives come from differences of neighbouring pixels of one branch (central where both neighbours are of
it): nothing is traced.  They only place starts and draw the line along a fold; Newton works with analytic
derivatives, and next to a fold the view is magnified beyond what is kept.  Pixels without a neighbour of their
branch in a row or a column get the analytic ones.

Pixels behind glass get FLAGS, others 0:

    SIGN    det < 0; equal branch and sign of neighbours make a run of a row, and runs that touch, diagonals
            included, are joined by union-find to sheets
    USEFUL  the view is not shrunk too much to start from
    NEAR    useful, and a node may lie within HALF a pixel, or a bit more
    BENT    the derivatives change so much from here to the next pixel that nodes in between may be within HALF
            of neither
    EDGE    useful, and one of the nine pixels here is bent or of another sheet, or one beside is not useful
    BORDER  useful, and at the border of the sheet
"""

import math
from typing import NamedTuple

import numpy as np

from correction.inversion.kernels.newton import BranchSequences, slopes_along, stretch
from ground.jit import Array, kernel, kernel_inlined
from tracer.kernels.rays import trace_pixel_tangents
from tracer.kernels.world import RECOVERED, Tables

SIGN, USEFUL, NEAR, BENT, GLASS, EDGE, BORDER = 1, 2, 4, 8, 16, 32, 64
KIND = SIGN | GLASS
ISOLATED = 0xFF
HALF = 0.55  # first order is right to 0.05 px halfway to the next pixel, unless BENT
MOST_BENT = 0.2  # change of the derivatives a pixel: an eighth of it is the error halfway
# Row, first column, last column + 1, 2 branch + (det < 0); first and last row of nodes that it may show
RUN = 6
FIRST_ROW, LAST_ROW = 4, 5

singular_values = kernel_inlined(stretch.py_func)  # type: ignore[attr-defined]


@kernel_inlined
def slopes(plane: Array, branch: Array, up: int, row: int, down: int, i: int) -> tuple[float, ...]:
    """dx/du, dx/dv, dy/du, dy/dv at pixel (row, i) from its neighbours, and d2x/du2, d2x/dv2, d2y/du2, d2y/dv2.

    Neighbours of other branches are left out: first derivatives are NaN if there is none in one direction, second
    ones 0 if there is only one.
    """
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
    xu, xv, yu, yv = (xr - xl) * across, (xb - xa) * along, (yr - yl) * across, (yb - ya) * along
    xuu, yuu, xvv, yvv = xl + xr - 2.0 * x, yl + yr - 2.0 * y, xa + xb - 2.0 * x, ya + yb - 2.0 * y
    xuu, yuu = xuu if left & right else 0.0, yuu if left & right else 0.0
    xvv, yvv = xvv if above & below else 0.0, yvv if above & below else 0.0
    return xu, xv, yu, yv, xuu, xvv, yuu, yvv


class Sensor(NamedTuple):
    """Plane points (H, 2 W), branch, flags (H, W) of the sensor; ``taken`` (h, w): stamps of nodes with starts."""

    plane: Array
    branch: Array
    flags: Array
    taken: Array


class NodeScale(NamedTuple):
    """Grid (3,) of the nodes, last column and row of its ``box`` (2,), and what makes a pixel useful.

    Parameters
    ----------
    longest : float
        Largest singular value [mm] of the derivatives of a useful pixel.
    least : int
        First branch that is sought.
    """

    grid: Array
    box: Array
    longest: float
    least: int


@kernel_inlined
def flags_of(x: float, y: float, derivatives: tuple[float, float, float, float], scale: NodeScale) -> int:
    """Flags but for BENT of a pixel that sees the plane point x, y."""
    (xu, xv, yu, yv), box, per_mm = derivatives, scale.box, 1.0 / scale.grid[2]
    c, r = (x - scale.grid[0]) * per_mm, (scale.grid[1] - y) * per_mm
    _, high = singular_values(xu, xv, yu, yv)
    det, reach = xu * yv - xv * yu, HALF * per_mm
    c_half, r_half = reach * (abs(xu) + abs(xv)), reach * (abs(yu) + abs(yv))
    left, right, top, bottom = np.ceil(c - c_half), np.floor(c + c_half), np.ceil(r - r_half), np.floor(r + r_half)
    near = (left <= right) & (top <= bottom)
    near &= (right >= 0.0) & (bottom >= 0.0) & (left <= box[0]) & (top <= box[1])
    # Of several nodes in the box some may be out of reach: that is not asked here.
    several = (left != right) | (top != bottom)
    ex, ey, most = left - c, r - top, reach * abs(det)
    near &= several | ((abs(yv * ex - xv * ey) <= most) & (abs(xu * ey - yu * ex) <= most))
    useful = high <= scale.longest
    flags = GLASS | (SIGN if det < 0.0 else 0)
    return flags | (USEFUL if useful else 0) | (NEAR if useful & near else 0)


@kernel
def flag_rows(
    tables: Tables, scale: NodeScale, first: int, last: int, sensor: Sensor, status: Array,
    sequences: BranchSequences, scratch: tuple[Array, Array],
) -> None:  # fmt: skip
    """Flags (H, W) uint8 of rows first..last-1 and the number of runs in each.

    Branches below `scale.least` are left out.  The outermost columns stay without flags.  `scratch`: a block
    (NEWTON_NUMBERS,) and the counts (H,) int64, which are written.
    """
    (plane, branch, flags, _), (block, counts), least = sensor, scratch, scale.least
    known, camera, spheres = sequences.begin.shape[0] > 0, tables[0], tables[1].spheres
    height, width = branch.shape
    for row in range(first, last):
        up, down = max(0, row - 1), min(height - 1, row + 1)
        begin, end = width, 0
        for i in range(width):
            flags[row, i] = 0
            glass = branch[row, i] >= least
            begin, end = min(begin, i if glass else width), max(end, i + 1 if glass else 0)
        begin, end = max(begin, 1), min(end, width - 1)
        counts[row] = 0
        isolated = 0
        for j in range(end - begin):
            i = begin + j
            xu, xv, yu, yv, xuu, xvv, yuu, yvv = slopes(plane, branch, up, row, down, i)
            own = flags_of(plane[row, 2 * i], plane[row, 2 * i + 1], (xu, xv, yu, yv), scale)
            bend_u = abs(yv * xuu - xv * yuu) + abs(yv * xvv - xv * yvv)
            bend_v = abs(xu * yuu - yu * xuu) + abs(xu * yvv - yu * xvv)
            straight = max(bend_u, bend_v) <= MOST_BENT * abs(xu * yv - xv * yu)
            own |= 0 if straight else BENT
            alone = xu * xv * yu * yv * 0.0 != 0.0
            here = (branch[row, i] >= least) & (status[row, i] == RECOVERED)
            own = ISOLATED if alone else own
            flags[row, i] = own if here else 0
            isolated += alone & here
        if isolated != 0:
            for i in range(begin, end):
                if flags[row, i] == ISOLATED:
                    s, x, y = float(RECOVERED), plane[row, 2 * i], plane[row, 2 * i + 1]
                    if known:
                        xu, xv, yu, yv = slopes_along(
                            float(i), float(row), branch[row, i], sequences, camera, spheres, block
                        )
                    else:
                        s, x, y, xu, xv, yu, yv, _, _, _ = trace_pixel_tangents(float(i), float(row), *tables)
                    own = flags_of(x, y, (xu, xv, yu, yv), scale)
                    flags[row, i] = own if s == RECOVERED else 0
        runs = 0
        for j in range(end - begin):
            i = begin + j
            other = (flags[row, i] ^ flags[row, i - 1]) & KIND != 0
            runs += (other | (branch[row, i] != branch[row, i - 1])) & (flags[row, i] != 0)
        counts[row] = runs


@kernel
def list_runs(
    sensor: Sensor, scale: NodeScale, first: int, last: int, begin: Array, ends: Array, runs: Array
) -> None:
    """Write the runs of rows first..last-1 to runs (R, RUN) int64; those of row r begin at begin[r].

    A useful pixel reaches nodes within |dy/du| + |dy/dv| of the point that it sees, which is at most sqrt(2) times
    its largest singular value; a row more is for rounding.  ``ends`` (W,) int64 is scratch.
    """
    (plane, branch, flags, _), width = sensor, sensor.flags.shape[1]
    per_mm, reach = 1.0 / scale.grid[2], math.sqrt(2.0) * scale.longest / scale.grid[2] + 1.0
    for row in range(first, last):
        k = begin[row]
        if begin[row + 1] == k:
            continue
        count = 0
        for j in range(width - 1):
            i = j + 1
            ends[count] = i
            other = (flags[row, i] ^ flags[row, i - 1]) & KIND != 0
            count += other | ((branch[row, i] != branch[row, i - 1]) & (flags[row, i] != 0))
        for j in range(count - 1):
            start = ends[j]
            if flags[row, start] != 0:
                number, sign = branch[row, start], flags[row, start] & SIGN
                runs[k, 0], runs[k, 1], runs[k, 2], runs[k, 3] = row, start, ends[j + 1], 2 * number + sign
                top, bottom = math.inf, -math.inf
                for i in range(start, ends[j + 1]):
                    r = (scale.grid[1] - plane[row, 2 * i + 1]) * per_mm
                    useful = flags[row, i] & USEFUL != 0
                    top, bottom = min(top, r if useful else top), max(bottom, r if useful else bottom)
                top, bottom = max(top - reach, 0.0), min(bottom + reach, scale.box[1])
                runs[k, FIRST_ROW], runs[k, LAST_ROW] = (int(top), int(bottom)) if top <= bottom else (1, 0)
                k += 1


@kernel
def flag_edges(flags: Array, branch: Array, first: int, last: int, begin: Array, edges: Array) -> None:
    """Flag the edges and borders in rows first..last-1; ``edges`` (W,) uint8 is scratch.

    Other rows may be flagged at the same time: what is read of them does not change.
    """
    height, width = flags.shape
    for row in range(first, last):
        if begin[row + 1] == begin[row]:
            continue
        up, down = max(0, row - 1), min(height - 1, row + 1)
        for j in range(width - 2):
            i = j + 1
            own, number = flags[row, i], branch[row, i]
            above, below, left, right = flags[up, i], flags[down, i], flags[row, i - 1], flags[row, i + 1]
            inner = ((own ^ above) | (own ^ below) | (own ^ left) | (own ^ right)) & KIND == 0
            inner &= (branch[up, i] == number) & (branch[down, i] == number)
            inner &= (branch[row, i - 1] == number) & (branch[row, i + 1] == number)
            one, two, three, four = flags[up, i - 1], flags[up, i + 1], flags[down, i - 1], flags[down, i + 1]
            corners = ((own ^ one) | (own ^ two) | (own ^ three) | (own ^ four)) & KIND == 0
            corners &= (branch[up, i - 1] == number) & (branch[up, i + 1] == number)
            corners &= (branch[down, i - 1] == number) & (branch[down, i + 1] == number)
            bent = (own | above | below | left | right | one | two | three | four) & BENT != 0
            edge = bent | (above & below & left & right & USEFUL == 0) | (not corners)
            flag = (EDGE if edge else 0) | (0 if inner else BORDER)
            edges[i] = flag if own & USEFUL else 0
        for j in range(width - 2):
            flags[row, j + 1] |= edges[j + 1]


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
def count_useful(flags: Array, runs: Array, parent: Array, useful: Array) -> None:
    """Add to useful (R,) int64, in the place of each sheet's first run, its pixels that are worth a start."""
    for k in range(runs.shape[0]):
        row, some = runs[k, 0], 0
        for i in range(runs[k, 1], runs[k, 2]):
            some += (flags[row, i] & USEFUL) != 0
        useful[parent[k]] += some
