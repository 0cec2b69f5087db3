"""B-spline coefficients of a frame, tile by tile.

A frame f[k] is the sampled sum of B-splines f(x) = sum_k c[k] beta5(x - k).  Its coefficients c follow
from f by the inverse of the filter (1, 26, 66, 26, 1)/120, which factors into two poles,

    z = -0.4305753471, -0.0430962882      (roots of z^4 + 26 z^3 + 66 z^2 + 26 z + 1 inside the unit circle)
    c = prod_z (1 - z)^2 / ((1 - z q^-1) (1 - z q)) f,       q = shift by one pixel,

(Unser, Aldroubi, Eden, IEEE Trans. Signal Process. 41, 821 (1993)).  The frame continues by mirroring at its
outermost pixel centres.  Down the columns the poles are the usual recursions, one sweep down and one up with
neighbouring columns side by side.  Along a row a recursion is serial; there the pole is unrolled by doubling,

    1/(1 - z q) = (1 + z q) (1 + z^2 q^2) (1 + z^4 q^4) ...
    (1 + a q)(1 + a q^-1) = (1 + a^2) (1 + b (q + q^-1)),       a = z^m,  b = a / (1 + a^2),

five symmetric passes of a line (m = 1, 2, 4, 8, 16; those of the small pole end at 4 and are merged with the
others), each a plain vector loop.

The memory of the filter is short: what lies `REACH` pixels away counts 2e-9, below float32.  So a tile with a
margin stands for itself, fits the second-level cache in one go from raw pixels to coefficients, has the same bits
whoever computes it and whenever, and tiles that nobody reads need no work.
"""

import numpy as np

from ground.jit import Array, kernel

Z_1, Z_2 = -0.43057534709997814, -0.04309628820326465
REACH = 24  # rows of margin above and below: 0.43^24 = 2e-9
SPREAD = 38  # columns of margin: what the passes along a row reach, 2 (1 + 2 + 4) + 8 + 16
RATIOS_1 = tuple(Z_1**m / (1.0 + Z_1 ** (2 * m)) for m in (1, 2, 4, 8, 16))
RATIOS_2 = tuple(Z_2**m / (1.0 + Z_2 ** (2 * m)) for m in (1, 2, 4))

_POLE_1, _POLE_2 = np.float32(Z_1), np.float32(Z_2)
_COLUMN_GAIN = (1.0 - Z_1) ** 2 * (1.0 - Z_2) ** 2
_ROW_GAIN = (
    _COLUMN_GAIN
    * float(np.prod([1.0 + Z_1 ** (2 * m) for m in (1, 2, 4, 8, 16)]))
    * float(np.prod([1.0 + Z_2 ** (2 * m) for m in (1, 2, 4)]))
)
_GAIN = np.float32(_COLUMN_GAIN * _ROW_GAIN)
_CENTRE = tuple(np.float32(1.0 + 2.0 * a * b) for a, b in zip(RATIOS_1, RATIOS_2, strict=False))
_NEAR = tuple(np.float32(a + b) for a, b in zip(RATIOS_1, RATIOS_2, strict=False))
_FAR = tuple(np.float32(a * b) for a, b in zip(RATIOS_1, RATIOS_2, strict=False))
_EIGHTH, _SIXTEENTH = np.float32(RATIOS_1[3]), np.float32(RATIOS_1[4])


@kernel
def mirrored(index: int, size: int) -> int:
    """Index into 0..size-1 of a line continued by mirroring at its outermost pixel centres."""
    period = 2 * (size - 1)
    index = abs(index) % period
    return period - index if index >= size else index


@kernel
def copy_line(line: Array, out: Array) -> None:
    """Copy the beginning of a line (N,) to out (n,): assigned as a slice it would need memory of its own."""
    for k in range(out.shape[0]):
        out[k] = line[k]


@kernel
def take_line(line: Array, first: int, out: Array) -> None:
    """out[k] = gain * line[first + k], the line (W,) of any real dtype continued by mirroring."""
    width, count = line.shape[0], out.shape[0]
    begin, end = min(count, max(0, -first)), min(count, max(0, width - first))
    inner, target = line[first + begin : first + end], out[begin:end]
    for k in range(target.shape[0]):
        target[k] = np.float32(inner[k]) * _GAIN
    for k in range(begin):
        out[k] = np.float32(line[mirrored(first + k, width)]) * _GAIN
    for k in range(end, count):
        out[k] = np.float32(line[mirrored(first + k, width)]) * _GAIN


@kernel
def five_taps(x: Array, m: int, centre: np.float32, near: np.float32, far: np.float32, y: Array) -> None:
    """Symmetric filter of five taps, m apart: y (n,) from x (n + 4 m,)."""
    a, b, c, d = x[m:], x[2 * m :], x[3 * m :], x[4 * m :]
    for k in range(y.shape[0]):
        y[k] = centre * b[k] + near * (a[k] + c[k]) + far * (x[k] + d[k])


@kernel
def three_taps(x: Array, m: int, near: np.float32, y: Array) -> None:
    """Symmetric filter of three taps, m apart, 1 in the middle: y (n,) from x (n + 2 m,)."""
    a, b = x[m:], x[2 * m :]
    for k in range(y.shape[0]):
        y[k] = a[k] + near * (x[k] + b[k])


@kernel
def filter_line(x: Array, y: Array, out: Array) -> None:
    """Both poles along a line: out (n,) from x (n + 2 SPREAD,), which is spoilt; y scratch as long as x."""
    n = x.shape[0]
    five_taps(x, 1, _CENTRE[0], _NEAR[0], _FAR[0], y[: n - 4])
    five_taps(y, 2, _CENTRE[1], _NEAR[1], _FAR[1], x[: n - 12])
    five_taps(x, 4, _CENTRE[2], _NEAR[2], _FAR[2], y[: n - 28])
    three_taps(y, 8, _EIGHTH, x[: n - 44])
    three_taps(x, 16, _SIXTEENTH, out)


@kernel
def sweep(state: Array, previous: Array, line: Array) -> None:
    """One row of both recursions, in place; state (n,) that of the first pole, previous (n,) the row before."""
    for k in range(line.shape[0]):
        value = line[k] + _POLE_1 * state[k]
        state[k] = value
        line[k] = value + _POLE_2 * previous[k]


@kernel
def filter_tile(
    frame: Array, rim: int, tile: tuple[int, int, int, int], scratch: tuple[Array, Array], out: Array
) -> None:
    """Coefficients out[top:bottom, left:right] of frame (H, W), any real dtype.

    ``out`` may be wider than the frame by mirrored pixels, `rim` of them above and left; `scratch`, float32:
    lines (2, columns + 2 SPREAD) and rows (rows + 2 REACH + 1, columns), its last row for the state.
    """
    (top, left, bottom, right), (lines, kept) = tile, scratch
    height = frame.shape[0]
    rows, columns = bottom - top + 2 * REACH, right - left
    x, y = lines[0, : columns + 2 * SPREAD], lines[1, : columns + 2 * SPREAD]
    state = kept[rows, :columns]
    for k in range(rows):
        take_line(frame[mirrored(top + k - REACH - rim, height)], left - SPREAD - rim, x)
        filter_line(x, y, kept[k, :columns])
    copy_line(kept[0], state)
    for k in range(1, rows):
        sweep(state, kept[k - 1, :columns], kept[k, :columns])
    copy_line(kept[rows - 1], state)
    for k in range(rows - 2, REACH - 1, -1):
        sweep(state, kept[k + 1, :columns], kept[k, :columns])
    for k in range(bottom - top):
        copy_line(kept[REACH + k], out[top + k, left:right])
