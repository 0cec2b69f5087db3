"""Correlation of weighted windows at a pixel's distance, for windows that overlap as much as you like.

What is left to find after the first passes is a fraction of a pixel, and five numbers a window decide about it:
the correlation at no displacement and at one pixel to each side,

    C(0) = sum_x W(x) a(x) b(x),        C(+-1) = sum_x W(x + 1/2) a(x) b(x + 1),  W(x + 1/2) a(x + 1) b(x).

Both products of C(+-1) stand in the middle between two pixels and carry the weight of that place, so a window
that falls off to its sides does not pull the peak to the middle. W(x, y) = w(x) w(y): products are summed down
the columns of a row of windows first, with w(y), a whole frame row at a time; what is left for a window is one
line. Nothing is transformed, no window is cut out, and windows of one row share all products.

Masked pixels are 0 in a and b. How much of W was there is summed the same way from the products of `valid`.
"""

import numpy as np

from ground.jit import Array, kernel

SUMS = 10  # a b at 0, +u, -u, +v, -v; valid at 0, u, v; a a; b b


@kernel
def add_product(weight: np.float32, x: Array, y: Array, out: Array) -> None:
    """Out += weight x y, all (n,) float32."""
    for k in range(out.size):
        out[k] += weight * x[k] * y[k]


@kernel
def down_columns(a: Array, b: Array, valid: Array, row: int, whole: Array, half: Array, columns: Array) -> None:
    """Sum products over the rows of the windows that begin at `row`.

    a, b, valid (H, W) float32; whole (w,) and half (w - 1,) float32 are the weights at pixels and between them;
    columns (SUMS, W) float32 becomes the sums in the order of `SUMS`, those along u at [k] between k and k + 1.
    """
    width = a.shape[1]
    zero = np.float32(0.0)
    for n in range(columns.shape[0]):
        line = columns[n]
        for k in range(width):
            line[k] = zero
    size = whole.size
    for n in range(size):
        la, lb, lv = a[row + n], b[row + n], valid[row + n]
        weight = whole[n]
        add_product(weight, la, lb, columns[0])
        add_product(weight, la[: width - 1], lb[1:], columns[1, : width - 1])
        add_product(weight, la[1:], lb[: width - 1], columns[2, : width - 1])
        add_product(weight, lv, lv, columns[5])
        add_product(weight, lv[: width - 1], lv[1:], columns[6, : width - 1])
        add_product(weight, la, la, columns[8])
        add_product(weight, lb, lb, columns[9])
        if n < size - 1:
            between = half[n]
            add_product(between, la, b[row + n + 1], columns[3])
            add_product(between, a[row + n + 1], lb, columns[4])
            add_product(between, lv, valid[row + n + 1], columns[7])


@kernel
def sum_weighted(line: Array, start: int, weights: Array) -> float:
    """Sum of line[start + k] weights[k]."""
    total = 0.0
    for k in range(weights.size):
        total += line[start + k] * weights[k]
    return total


@kernel
def lag_sums(
    a: Array,
    b: Array,
    valid: Array,
    row: int,
    starts: Array,
    whole: Array,
    half: Array,
    columns: Array,
    out: Array,
) -> None:
    """Out (nx, SUMS) float64: the sums of all windows that begin at `row` and the columns `starts` (nx,)."""
    down_columns(a, b, valid, row, whole, half, columns)
    for i in range(starts.size):
        for n in range(SUMS):
            along = half if n == 1 or n == 2 or n == 6 else whole
            out[i, n] = sum_weighted(columns[n], starts[i], along)


@kernel
def between(low: float, middle: float, high: float) -> float:
    """Place of the peak of three samples (Gaussian, else parabola); NaN where the middle is not highest."""
    if not (middle > low and middle > high):
        return np.nan
    if low > 0.0 and high > 0.0:
        low, middle, high = np.log(low), np.log(middle), np.log(high)
    return 0.5 * (low - high) / (low - 2.0 * middle + high)


@kernel
def read_lags(sums: Array, total: float, floor: float, shift: Array, correlation: Array, share: Array) -> None:
    """Displacement (n, 2), correlation coefficient (n,) and valid share (n,) from sums (n, SUMS).

    `total` is the sum of W. NaN where there is no peak within a pixel or nothing to see, that is a mean square
    of not more than `floor`.
    """
    for i in range(shift.shape[0]):
        s = sums[i]
        share[i] = s[5] / total
        shift[i, 0] = np.nan
        shift[i, 1] = np.nan
        correlation[i] = np.nan
        if not (s[6] > 0.0 and s[7] > 0.0 and min(s[8], s[9]) > floor * s[5]):
            continue
        middle = s[0] / s[5]
        shift[i, 0] = between(s[2] / s[6], middle, s[1] / s[6])
        shift[i, 1] = between(s[4] / s[7], middle, s[3] / s[7])
        correlation[i] = s[0] / np.sqrt(s[8] * s[9])
