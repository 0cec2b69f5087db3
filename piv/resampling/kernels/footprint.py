"""Lay out, once, where a corrector looks: the samples of every node, in the order in which they are used.

The view of a node is a parallelogram on the sensor, the image of its square.  It is sampled once a pixel along
each side, symmetric about the centre, and averaged, so no recorded light is lost where a view is magnified and
nothing is shifted; a view that is not magnified is one sample.

A frame needs no more than these samples.  Each is 8 bytes: the flat index of its pixel, and two fractions of
1/65535 px, which round its place by 8e-6 px.  Nodes side by side with equally many samples form a span of a row;
a node with several views is a span of its own for each, the later ones adding to the first.
"""

import math
from typing import Any

import numpy as np

from ground.jit import Array, kernel

MAX_SAMPLES = 16  # a side; the largest magnification that a correction map keeps
FRACTIONS = 65535  # steps a pixel: both ends of a pixel's side are among them
COLUMN, NODES, SAMPLES, ADDS, FIRST = 0, 1, 2, 3, 4  # numbers of a span: its nodes, samples a node, first sample
SPAN = 5


@kernel
def samples_along(du: float, dv: float) -> int:
    """Samples needed along a footprint side (du, dv) [px]: one a pixel; a quarter too much is no reason."""
    return int(min(MAX_SAMPLES, max(1.0, math.ceil(math.sqrt(du * du + dv * dv) - 0.25))))


@kernel
def place_sample(
    u: float, v: float, width: int, height: int, stride: int, k: int, anchor: Array, fraction: Array
) -> None:
    """Store sample k at the pixel position (u, v), taken into the frame, in rows of `stride` pixels."""
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    i, j = min(int(u), width - 2), min(int(v), height - 2)
    anchor[k] = j * stride + i
    fraction[k] = int((u - i) * FRACTIONS + 0.5) + (int((v - j) * FRACTIONS + 0.5) << 16)


@kernel
def lay_rows(
    views: Any, recovered: Array, size: Array, store: bool, first: int, last: int, samples: Array,  # noqa: ANN401
    footprints: Any,  # noqa: ANN401
) -> None:  # fmt: skip
    """Samples and spans of the rows first..last-1: their number, or, if `store`, themselves.

    `views` and `footprints` are those of ``piv.resampling.footprints``; ``recovered`` (h, w) bool; ``size`` (3,):
    width and height of the frame and the length of its rows in memory.  ``samples`` and ``footprints.begin``
    (h + 1,) receive the numbers of row r in [r + 1]; if `store` they hold where row r begins in [r].
    """
    (position, jacobian, weight), (anchor, fraction, spans, span, share) = views, footprints
    layers, _, columns = weight.shape
    width, height, stride = size[0], size[1], size[2]
    for row in range(first, last):
        k, number = (samples[row], spans[row]) if store else (0, 0)
        before, run_end = 0, -1  # samples a node of the span that may go on, and the column where it does
        for column in range(columns):
            if not recovered[row, column]:
                continue
            views = 0
            for layer in range(layers):
                views += weight[layer, row, column] > 0.0
            done = 0
            for layer in range(layers):
                part = weight[layer, row, column]
                if not part > 0.0:
                    continue
                uc, ur = jacobian[layer, row, column, 0], jacobian[layer, row, column, 1]
                vc, vr = jacobian[layer, row, column, 2], jacobian[layer, row, column, 3]
                n_c, n_r = samples_along(uc, vc), samples_along(ur, vr)
                count = n_c * n_r
                if views > 1 or count != before or column != run_end:
                    if store:
                        span[number, COLUMN], span[number, NODES], span[number, SAMPLES] = column, 0, count
                        span[number, ADDS], span[number, FIRST] = 1 if done > 0 else 0, k
                        share[number] = (part if views > 1 else 1.0) / count
                    number += 1
                before, run_end = (count if views == 1 else 0), column + 1
                done += 1
                if store:
                    span[number - 1, NODES] += 1
                    u, v = position[layer, row, column, 0], position[layer, row, column, 1]
                    for i in range(n_r):
                        r = (i + 0.5) / n_r - 0.5
                        for j in range(n_c):
                            c = (j + 0.5) / n_c - 0.5
                            x, y, at = u + uc * c + ur * r, v + vc * c + vr * r, k + i * n_c + j
                            place_sample(x, y, width, height, stride, at, anchor, fraction)
                k += count
        if not store:
            samples[row + 1], spans[row + 1] = k, number


@kernel
def mark_tiles(
    stride: int, rows: int, columns: int, tile_rows: int, tile_columns: int, anchor: Array, wanted: Array
) -> None:
    """Mark in wanted (tiles down, across) uint8 those with one of the rows x columns pixels behind an anchor."""
    for k in range(anchor.shape[0]):
        j, i = anchor[k] // stride, anchor[k] % stride
        top, bottom = j // tile_rows, (j + rows - 1) // tile_rows
        left, right = i // tile_columns, (i + columns - 1) // tile_columns
        wanted[top, left], wanted[top, right] = np.uint8(1), np.uint8(1)
        wanted[bottom, left], wanted[bottom, right] = np.uint8(1), np.uint8(1)
