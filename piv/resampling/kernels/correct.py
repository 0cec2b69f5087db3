"""Correct a frame: values at the samples laid out by ``footprint``, means over the nodes.

Samples are taken `CHUNK` at a time, in steps of which each is a plain loop: fractions and the spline's weights for
all of them (vectors across samples), the sums over their pixels (vectors along a row of the footprint), the
means.  `to_offset_uint16` makes of them what is stored.
"""

from typing import Any

import numpy as np

from ground.jit import Array, kernel, kernel_inlined
from piv.resampling.kernels.bspline import weight_inner, weight_middle, weight_outer
from piv.resampling.kernels.footprint import ADDS, COLUMN, FIRST, FRACTIONS, NODES, SAMPLES
from piv.resampling.kernels.lanes import copy_pair, footprint_sum

LARGEST_STORED = np.float32(65535.0)
ZERO, ONE = np.float32(0.0), np.float32(1.0)
CHUNK = 256  # samples at a time; a node has no more
WEIGHTS = 7  # lines of scratch for the spline: the fraction along a row, the weights of six rows
_ONE = np.float32(1.0)
_STEP = np.float32(1.0 / FRACTIONS)
_LOW, _HIGH = np.uint32(0xFFFF), np.uint32(16)
outer_inlined = kernel_inlined(weight_outer.py_func)  # type: ignore[attr-defined]
middle_inlined = kernel_inlined(weight_middle.py_func)  # type: ignore[attr-defined]
inner_inlined = kernel_inlined(weight_inner.py_func)  # type: ignore[attr-defined]


@kernel
def to_offset_uint16(values: Array, offset: np.float32, first: int, last: int, out: Array) -> int:
    """Round values (N,) float32 + offset to 1..65535 in out (N,) uint16, NaN and infinity to 0; count the cut."""
    cut = 0
    for index in range(first, last):
        value = np.rint(values[index] + offset)
        kept = min(max(value, ONE), LARGEST_STORED)
        is_number = value - value == ZERO  # false for NaN and infinity, and no branch
        cut += int(is_number and kept != value)
        out[index] = np.uint16(kept if is_number else ZERO)
    return cut


@kernel_inlined
def along(fraction: np.uint32) -> np.float32:
    """Fraction of a pixel along u."""
    return np.float32(np.int32(fraction & _LOW)) * _STEP


@kernel_inlined
def down(fraction: np.uint32) -> np.float32:
    """Fraction of a pixel along v."""
    return np.float32(np.int32(fraction >> _HIGH)) * _STEP


@kernel
def spline_weights(fraction: Array, s: Array, y: Array) -> None:
    """Fractions along u (n,), and y (6, CHUNK) the weights of the rows of the footprint, of samples (n,)."""
    y0, y1, y2, y3, y4, y5 = y[0], y[1], y[2], y[3], y[4], y[5]
    for k in range(fraction.shape[0]):
        s[k] = along(fraction[k])
    for k in range(fraction.shape[0]):
        t = down(fraction[k])
        y0[k], y1[k], y2[k] = outer_inlined(t), middle_inlined(t), inner_inlined(t)
    for k in range(fraction.shape[0]):
        t = _ONE - down(fraction[k])
        y3[k], y4[k], y5[k] = inner_inlined(t), middle_inlined(t), outer_inlined(t)


@kernel
def spline_values(flat: Array, stride: int, anchor: Array, fraction: Array, scratch: Array, out: Array) -> None:
    """Spline values out (n,) of n <= CHUNK samples from flat coefficients; an anchor is a footprint's first."""
    s, y = scratch[0], scratch[1:]
    y0, y1, y2, y3, y4, y5 = y[0], y[1], y[2], y[3], y[4], y[5]
    spline_weights(fraction, s, y)
    for k in range(out.shape[0]):
        out[k] = footprint_sum(flat, anchor[k], stride, s[k], (y0[k], y1[k], y2[k], y3[k], y4[k], y5[k]))


@kernel
def bilinear_values(flat: Array, stride: int, anchor: Array, fraction: Array, scratch: Array, out: Array) -> None:
    """Bilinear values out (n,) of n <= CHUNK samples from a flat frame; an anchor is their pixel above and left.

    ``scratch`` (2, 2 CHUNK) has the dtype of the frame: pixels are collected first, then all is one vector loop.
    """
    above, below = scratch[0], scratch[1]
    for k in range(out.shape[0]):
        copy_pair(flat, anchor[k], above, 2 * k)
        copy_pair(flat, anchor[k] + stride, below, 2 * k)
    for k in range(out.shape[0]):
        s, t = along(fraction[k]), down(fraction[k])
        left, right = np.float32(above[2 * k]), np.float32(above[2 * k + 1])
        upper = left + s * (right - left)
        left, right = np.float32(below[2 * k]), np.float32(below[2 * k + 1])
        out[k] = upper + t * (left + s * (right - left) - upper)


@kernel
def place_means(values: Array, samples: int, share: np.float32, adds: bool, line: Array) -> None:
    """Store in, or add to, line (n,) the share of the sum over each node's samples; values (n samples,)."""
    for k in range(line.shape[0]):
        total = 0.0
        for i in range(samples):
            total += values[k * samples + i]
        value = np.float32(total * share)
        line[k] = line[k] + value if adds else value


@kernel
def correct_rows(
    image: tuple[Array, int], quintic: bool, footprints: Any, fill: float, first: int, last: int,  # noqa: ANN401
    scratch: tuple[Array, Array], out: Array,
) -> None:  # fmt: skip
    """Correct rows first..last-1 into out (h, w) float32; nodes without a span get `fill`.

    `image` is flat, spline coefficients if `quintic`, else the frame, with the length of its rows; `footprints` a
    ``Footprints``.  `scratch`: that of `spline_values` or `bilinear_values`, and (CHUNK,) float32.
    """
    (flat, stride), (anchor, fraction, begin, span, share), (work, values) = image, footprints, scratch
    for row in range(first, last):
        out[row, :] = fill
        for number in range(begin[row], begin[row + 1]):
            samples, adds, part = span[number, SAMPLES], span[number, ADDS] != 0, share[number]
            plain = samples == 1 and not adds and part == _ONE
            step = CHUNK // samples
            for low in range(0, span[number, NODES], step):
                nodes = min(step, span[number, NODES] - low)
                a = span[number, FIRST] + low * samples
                b = a + nodes * samples
                line = out[row, span[number, COLUMN] + low : span[number, COLUMN] + low + nodes]
                result = line if plain else values[: b - a]
                if quintic:
                    spline_values(flat, stride, anchor[a:b], fraction[a:b], work, result)
                else:
                    bilinear_values(flat, stride, anchor[a:b], fraction[a:b], work, result)
                if not plain:
                    place_means(result, samples, part, adds, line)
