"""Deform a frame by a dense displacement field, the innermost loop of the window deformation.

The displacement of a pixel comes from a coarse grid by a cubic B-spline (`piv.correlation.windows`); along u the
grid has been refined beforehand (`refined`, one line a grid row), so a frame row needs four multiplications a
pixel.

Neighbouring pixels move almost alike: in a row the integer parts of the displacement stay constant over
runs of many pixels.  Within a run the 6 x 6 footprints are consecutive in memory, so the spline is evaluated
for 8 or 16 pixels at once, several times faster than point by point and with the same weights.  A run is made a
multiple of so many pixels long: what is too much is overwritten by the next run, and costs less than the odd
pixels one by one.
"""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from piv.resampling.kernels.bspline import quintic_at, weight_inner, weight_middle, weight_outer

_ONE = np.float32(1.0)
LANES = 8  # pixels at once


@kernel_inlined
def quintic_run(
    r0: Array, r1: Array, r2: Array, r3: Array, r4: Array, r5: Array, s: Array, t: Array, out: Array
) -> None:
    """out[k] = spline value from the coefficients k..k+5 of six rows at the fractions s[k], t[k].

    Part of its caller: runs of a curved field are short, and a call with nine arrays takes as long as 60 pixels.
    """
    for k in range(out.size):
        p, q = s[k], t[k]
        p1, q1 = _ONE - p, _ONE - q
        x0, x1, x2 = weight_outer(p), weight_middle(p), weight_inner(p)
        x3, x4, x5 = weight_inner(p1), weight_middle(p1), weight_outer(p1)
        m, n = k + 1, k + 2
        d, e, f = k + 3, k + 4, k + 5
        out[k] = (
            weight_outer(q) * (x0 * r0[k] + x1 * r0[m] + x2 * r0[n] + x3 * r0[d] + x4 * r0[e] + x5 * r0[f])
            + weight_middle(q) * (x0 * r1[k] + x1 * r1[m] + x2 * r1[n] + x3 * r1[d] + x4 * r1[e] + x5 * r1[f])
            + weight_inner(q) * (x0 * r2[k] + x1 * r2[m] + x2 * r2[n] + x3 * r2[d] + x4 * r2[e] + x5 * r2[f])
            + weight_inner(q1) * (x0 * r3[k] + x1 * r3[m] + x2 * r3[n] + x3 * r3[d] + x4 * r3[e] + x5 * r3[f])
            + weight_middle(q1) * (x0 * r4[k] + x1 * r4[m] + x2 * r4[n] + x3 * r4[d] + x4 * r4[e] + x5 * r4[f])
            + weight_outer(q1) * (x0 * r5[k] + x1 * r5[m] + x2 * r5[n] + x3 * r5[d] + x4 * r5[e] + x5 * r5[f])
        )


@kernel
def refine_lines(lines: Array, cell: Array, weight: Array, out: Array) -> None:
    """out[axis, j, k] = sum_m weight[k, m] lines[j, cell[k] + m, axis]: grid lines refined along u.

    lines (rows, columns, 2) and weight (W, 4) float64, cell (W,) int, out (2, rows, W) float32.
    """
    for axis in range(2):
        for j in range(lines.shape[0]):
            line, refined = lines[j], out[axis, j]
            for k in range(cell.size):
                c = cell[k]
                refined[k] = (
                    weight[k, 0] * line[c, axis]
                    + weight[k, 1] * line[c + 1, axis]
                    + weight[k, 2] * line[c + 2, axis]
                    + weight[k, 3] * line[c + 3, axis]
                )


@kernel
def row_offsets(
    refined_u: Array, refined_v: Array, weight: Array, scale: np.float32, offset: Array, fraction: Array
) -> None:
    """Integer part (2, W) int32 and fraction (2, W) float32 of scale * displacement along one row.

    refined_u, refined_v are (4, W): the grid lines around the row; weight (4,) their share.
    """
    w0, w1, w2, w3 = weight[0], weight[1], weight[2], weight[3]
    for axis in range(2):
        lines = refined_u if axis == 0 else refined_v
        l0, l1, l2, l3 = lines[0], lines[1], lines[2], lines[3]
        whole, part = offset[axis], fraction[axis]
        for k in range(part.size):
            d = scale * (w0 * l0[k] + w1 * l1[k] + w2 * l2[k] + w3 * l3[k])
            floor = np.floor(d)
            whole[k] = np.int32(floor)
            part[k] = d - floor


@kernel
def share_at(valid: Array, i: int, j: int, s: np.float32, t: np.float32) -> np.float32:
    """Bilinear value of the mask (H, W) float32 at (i + s, j + t); 0 outside the pixel centres."""
    height, width = valid.shape
    if i < 0 or j < 0 or i + 1 >= width or j + 1 >= height:
        return np.float32(0.0)
    above = valid[j, i] * (_ONE - s) + valid[j, i + 1] * s
    below = valid[j + 1, i] * (_ONE - s) + valid[j + 1, i + 1] * s
    return above * (_ONE - t) + below * t  # type: ignore[no-any-return]


@kernel
def deform_rows(
    coefficients: Array,
    valid: Array,
    masked: bool,
    refined: Array,
    cell: Array,
    weight: Array,
    scale: np.float32,
    first: int,
    last: int,
    offset: Array,
    fraction: Array,
    out: Array,
    out_valid: Array,
) -> None:
    """Rows first..last-1 of the frame sampled at x + scale * displacement(x).

    coefficients (H, W) float32; valid (H, W) float32, looked at if `masked`; refined (2, rows, W) float32, the
    grid refined along u; cell (H,) int and weight (H, 4) float32, the four grid lines of each frame row and
    their shares.  offset (2, W) int32 and fraction (2, W) float32 are scratch.  out (H, W) float32 becomes 0
    where there is no value; out_valid (H, W) float32 is multiplied by the share of valid pixels there, so that
    two frames have one in common.
    """
    height, width = coefficients.shape
    for row in range(first, last):
        c = cell[row]
        row_offsets(refined[0, c : c + 4], refined[1, c : c + 4], weight[row], scale, offset, fraction)
        start = 0
        while start < width:
            shift, rise = offset[0, start], offset[1, start]
            stop = start + 1
            while stop < width and offset[0, stop] == shift and offset[1, stop] == rise:
                stop += 1
            j = row + rise - 2
            # inside begin..end-1 every footprint lies in the frame
            begin = min(max(start, 2 - shift), stop)
            end = max(min(stop, width - 3 - shift), begin)
            if j < 0 or j + 5 >= height:
                end = begin = start
            if end > begin:
                whole = begin + (end - begin + LANES - 1) // LANES * LANES
                if whole > width or whole + shift + 3 > width:
                    whole = end
                a, b = begin + shift - 2, whole + shift + 3
                quintic_run(
                    coefficients[j, a:b],
                    coefficients[j + 1, a:b],
                    coefficients[j + 2, a:b],
                    coefficients[j + 3, a:b],
                    coefficients[j + 4, a:b],
                    coefficients[j + 5, a:b],
                    fraction[0, begin:whole],
                    fraction[1, begin:whole],
                    out[row, begin:whole],
                )
            for k in range(start, stop):
                if k < begin or k >= end:
                    value = quintic_at(coefficients, k + shift + fraction[0, k], row + rise + fraction[1, k])
                    inside = value == value
                    out[row, k] = value if inside else np.float32(0.0)
                    out_valid[row, k] *= _ONE if inside else np.float32(0.0)
                if masked:
                    out_valid[row, k] *= share_at(valid, k + shift, row + rise, fraction[0, k], fraction[1, k])
            start = stop


@kernel
def agree_rows(
    a: Array,
    b: Array,
    variance: Array,
    noise: np.float32,
    refined: Array,
    cell: Array,
    weight: Array,
    first: int,
    last: int,
    offset: Array,
    fraction: Array,
    variances: Array,
    worth: Array,
) -> None:
    """Draw rows first..last-1 of two deformed frames to each other, see `piv.correlation.deform`.

    a, b (H, W) float32 are changed in place; variance (H, W) float32 of what undeformed frames were filled with;
    noise, the usual variance; refined, cell, weight, offset and fraction as in `deform_rows`; variances (2, W)
    float32 is scratch; worth (H, W) float32 becomes the weight of what is left of the difference.
    """
    width = a.shape[1]
    for row in range(first, last):
        c = cell[row]
        for n in range(2):
            scale = np.float32(n - 0.5)
            row_offsets(refined[0, c : c + 4], refined[1, c : c + 4], weight[row], scale, offset, fraction)
            for k in range(width):
                i, j = k + offset[0, k], row + offset[1, k]
                variances[n, k] = share_at(variance, i, j, fraction[0, k], fraction[1, k])
        for k in range(width):
            share = _ONE / (variances[0, k] + variances[1, k] + noise)
            apart = (b[row, k] - a[row, k]) * share
            a[row, k] += variances[0, k] * apart
            b[row, k] -= variances[1, k] * apart
            worth[row, k] = noise * share
