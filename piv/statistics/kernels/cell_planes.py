"""Products of two frames at many displacements, summed over small square cells.

A product a(x_a) b(x_a + s) belongs to the cell that holds the middle between its pixels, x_a = x - floor(s/2): so
a gradient across a cell pulls the peak to no side. Windows of any size are sums of cells, made afterwards.
"""

import numpy as np

from ground.jit import Array, kernel
from piv.correlation.kernels.lags import add_product

TEMPLATES = 7  # 1, x, y, x x, y y, x y, each with a Gaussian, and 1 without
CUBIC = 4  # and x x x, x x y, x y y, y y y with it, for derivatives of these


@kernel
def cell_products(
    a: Array, b: Array, lags: Array, row: int, column: int, cell: int, line: Array, out: Array
) -> None:
    """Sum products over the cells of one row of cells.

    a, b (H, W) float32; lags (L, 2) int, dv and du; the cells begin at the pixel `row`, `column` and are `cell` px
    a side; line (W,) float32 is scratch; out (L, nx) float32 becomes the sums. What lies outside the frame is 0.
    """
    height, width = a.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    for n in range(lags.shape[0]):
        dv, du = lags[n, 0], lags[n, 1]
        up, left = -(dv >> 1), -(du >> 1)
        low = max(0, -left, -left - du)
        high = min(width, width - left, width - left - du)
        for k in range(width):
            line[k] = zero
        for y in range(row, row + cell):
            ja = y + up
            jb = ja + dv
            if min(ja, jb) >= 0 and max(ja, jb) < height and high > low:
                add_product(one, a[ja, low + left : high + left], b[jb, low + left + du : high + left + du],
                            line[low:high])  # fmt: skip
        target = out[n]
        for i in range(target.size):
            start = column + i * cell
            total = zero
            for k in range(cell):
                total += line[start + k]
            target[i] = total


@kernel
def template_sums(plane: Array, lags: Array, variance: Array, weight: Array, out: Array) -> None:
    """Sums of a plane times the templates of TEMPLATES and of CUBIC.

    plane (L, nx) float32; lags (L, 2) int; variance (nx,) float32 of the Gaussians [px^2]; weight (reach + 1, nx)
    float32 is scratch; out (TEMPLATES + CUBIC, nx) float32.
    """
    half, zero = np.float32(0.5), np.float32(0.0)
    for k in range(weight.shape[0]):
        for i in range(variance.size):
            weight[k, i] = np.exp(-half * np.float32(k * k) / variance[i])
    for k in range(TEMPLATES + CUBIC):
        for i in range(variance.size):
            out[k, i] = zero
    for n in range(lags.shape[0]):
        dv, du = lags[n, 0], lags[n, 1]
        x, y = np.float32(du), np.float32(dv)
        along, down, values = weight[abs(du)], weight[abs(dv)], plane[n]
        for i in range(variance.size):
            value = values[i]
            g = along[i] * down[i] * value
            out[0, i] += g
            out[1, i] += x * g
            out[2, i] += y * g
            out[3, i] += x * x * g
            out[4, i] += y * y * g
            out[5, i] += x * y * g
            out[6, i] += value
            out[7, i] += x * x * x * g
            out[8, i] += x * x * y * g
            out[9, i] += x * y * y * g
            out[10, i] += y * y * y * g
