"""The tabulated jet at many points: cubic convolution of a uniform table, with its slopes."""

import numpy as np

from ground.jit import Array, kernel, kernel_inlined


@kernel_inlined
def keys(t: float, k: int) -> float:
    """Weight of node k = -1, 0, 1, 2 at t in 0..1 of cubic convolution (Keys 1981); C1 from cell to cell."""
    if k == -1:
        return t * (-0.5 + t * (1.0 - 0.5 * t))
    if k == 0:
        return 1.0 + t * t * (-2.5 + 1.5 * t)
    if k == 1:
        return t * (0.5 + t * (2.0 - 1.5 * t))
    return t * t * (-0.5 + 0.5 * t)


@kernel_inlined
def keys_slope(t: float, k: int) -> float:
    """Derivative of `keys`."""
    if k == -1:
        return -0.5 + t * (2.0 - 1.5 * t)
    if k == 0:
        return t * (-5.0 + 4.5 * t)
    if k == 1:
        return 0.5 + t * (4.0 - 4.5 * t)
    return t * (-1.0 + 1.5 * t)


@kernel
def at_points(first: Array, second: Array, table: Array, start: Array, step: Array, out: Array) -> None:
    """Value and both slopes, `out` (N, 3), of `table` (rows, columns) at coordinates `first`, `second` (N,).

    Row i lies at start[0] + i step[0], column j at start[1] + j step[1]; beyond the ends the last cell goes on.
    """
    rows, columns = table.shape
    for n in range(first.shape[0]):
        p, q = (first[n] - start[0]) / step[0], (second[n] - start[1]) / step[1]
        i, j = min(max(int(np.floor(p)), 1), rows - 3), min(max(int(np.floor(q)), 1), columns - 3)
        a, b = min(max(p - i, -1.0), 2.0), min(max(q - j, -1.0), 2.0)
        value = by_first = by_second = 0.0
        for k in range(-1, 3):
            along = slope = 0.0
            for m in range(-1, 3):
                node = table[i + k, j + m]
                along += keys(b, m) * node
                slope += keys_slope(b, m) * node
            value += keys(a, k) * along
            by_first += keys_slope(a, k) * along
            by_second += keys(a, k) * slope
        out[n, 0], out[n, 1], out[n, 2] = value, by_first / step[0], by_second / step[1]
