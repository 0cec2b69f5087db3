"""Which nodes a moved sphere can have touched; see ``correction.moved``."""

import math

from correction.kernels.inverse import stretch
from correction.kernels.sheets import slopes
from tracer.kernels._jit import Array, kernel, unowned
from tracer.kernels.chain import glass_span, place_row
from tracer.kernels.march import RECOVERED, march_pixel_tangents

SAFE = 1.0 + 1e-9  # vectors round differently
NEAR = 2  # pixels: a start depends on its pixel's neighbours, and those on theirs


@kernel
def changed_rows(
    point: Array,
    other: Array,
    branch: Array,
    branch_2: Array,
    status: Array,
    status_2: Array,
    first: int,
    last: int,
    changed: Array,
) -> None:
    """Mark in changed (H, W) uint8 the pixels of rows first..last-1 that differ in any bit.

    ``point`` and ``other`` (H, 2 W) int64, the bits of two maps' plane points; NaN equals NaN.
    """
    for row in range(first, last):
        for i in range(branch.shape[1]):
            changed[row, i] = (branch[row, i] != branch_2[row, i]) | (status[row, i] != status_2[row, i])
        some = 0
        for i in range(branch.shape[1]):
            some += branch[row, i] != 0
        if some != 0:  # what is seen directly lies where it lay
            for i in range(branch.shape[1]):
                moved = (point[row, 2 * i] != other[row, 2 * i]) | (point[row, 2 * i + 1] != other[row, 2 * i + 1])
                changed[row, i] |= moved


@kernel
def widen_rows(marks: Array, first: int, last: int, out: Array) -> None:
    """Rows first..last-1 of out (H, W) uint8: whether a mark is at most NEAR rows and columns away."""
    height, width = marks.shape
    for row in range(first, last):
        line = out[row]
        for i in range(width):
            line[i] = 0
        for other in range(max(0, row - NEAR), min(height, row + NEAR + 1)):
            source = marks[other]
            for shift in range(2 * NEAR + 1):
                begin, end = max(0, NEAR - shift), min(width, width + NEAR - shift)
                for i in range(end - begin):
                    line[begin + i] |= source[begin + shift - NEAR + i]


@kernel
def mark_footprints(
    near: Array,
    plane: Array,
    branch: Array,
    status: Array,
    tables: tuple[Array, Array, Array],
    longest: float,
    grid: Array,
    first: int,
    last: int,
    dirty: Array,
) -> None:
    """Mark in dirty (h, w) uint8 the nodes for which a pixel of `near` behind glass could give a start.

    The other arguments are those of ``correction.kernels.sheets``.  A box around what `scatter_sheet` reaches.
    """
    height, width = branch.shape
    rows, columns = dirty.shape
    per_mm = 1.0 / grid[2]
    for line in range(first, last):
        up, down = max(0, line - 1), min(height - 1, line + 1)
        for j in range(width - 2):
            i = j + 1
            if near[line, i] == 0 or branch[line, i] == 0 or status[line, i] != RECOVERED:
                continue
            xu, xv, yu, yv = slopes(plane, branch, up, line, down, i)
            if xu * xv * yu * yv * 0.0 != 0.0:
                _, _, _, xu, xv, yu, yv, _, _, _ = march_pixel_tangents(
                    float(i), float(line), tables[0], tables[1], tables[2]
                )
            _, high = stretch(xu, xv, yu, yv)
            if not high <= longest:
                continue
            c, r = (plane[line, 2 * i] - grid[0]) * per_mm, (grid[1] - plane[line, 2 * i + 1]) * per_mm
            c_half, r_half = SAFE * per_mm * (abs(xu) + abs(xv)), SAFE * per_mm * (abs(yu) + abs(yv))
            for row in range(max(0, math.ceil(r - r_half)), min(rows - 1, math.floor(r + r_half)) + 1):
                for column in range(max(0, math.ceil(c - c_half)), min(columns - 1, math.floor(c + c_half)) + 1):
                    dirty[row, column] = 1


@kernel
def mark_shadows(place: Array, discs: Array, first: int, last: int, x: Array, y: Array, dirty: Array) -> None:
    """Mark in dirty (h, w) uint8 the nodes of rows first..last-1 in the shadows of some discs (N, BALL)."""
    x, y, discs = unowned(x), unowned(y), unowned(discs)
    for row in range(first, last):
        place_row(row, True, place, x, y)
        for k in range(discs.shape[0]):
            low, high = glass_span(x, y, True, place, discs, k)
            for i in range(low, high):
                dirty[row, i] = 1


@kernel
def take_nodes(asked: Array, first: int, last: int, fresh: tuple[Array, ...], kept: tuple[Array, ...]) -> None:
    """Copy the asked nodes (h, w) bool of rows first..last-1 from `fresh` to `kept`, maps as in `keep_view`."""
    status, pixel, jacobian, weight, transmittance, branch = fresh
    status_2, pixel_2, jacobian_2, weight_2, transmittance_2, branch_2 = kept
    for row in range(first, last):
        for i in range(asked.shape[1]):
            if not asked[row, i]:
                continue
            status_2[row, i] = status[row, i]
            for layer in range(weight.shape[0]):
                for k in range(2):
                    pixel_2[layer, row, i, k] = pixel[layer, row, i, k]
                for k in range(4):
                    jacobian_2[layer, row, i, k] = jacobian[layer, row, i, k]
                weight_2[layer, row, i] = weight[layer, row, i]
                transmittance_2[layer, row, i] = transmittance[layer, row, i]
                branch_2[layer, row, i] = branch[layer, row, i]
