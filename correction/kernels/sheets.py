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

from correction.kernels.inverse import stretch
from tracer.kernels._jit import Array, kernel, kernel_inlined
from tracer.kernels.march import RECOVERED, march_pixel_tangents

LONELY = 0xFFFFFFFF
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
