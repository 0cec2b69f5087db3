"""Sums over small blocks of what makes a correlation lean to one side, for the uncertainty of its peak.

See `piv.correlation.uncertainty`.
"""

import numpy as np

from ground.jit import Array, kernel

KINDS = 4  # asymmetry along u, v; what a displacement of 1 px along u, v would make of it


@kernel
def lean(a0: Array, a1: Array, b0: Array, b1: Array, out: Array) -> None:
    """Out += a0 b1 - a1 b0, all (n,) float32: products of neighbours, forwards minus backwards."""
    for k in range(out.size):
        out[k] += a0[k] * b1[k] - a1[k] * b0[k]


@kernel
def lean_of_shift(
    a_before: Array, a0: Array, a1: Array, a2: Array, b_before: Array, b0: Array, b1: Array, b2: Array, out: Array
) -> None:
    """Out += m'(0) m(1) - m(0) m'(1), all (n,) float32, with the mean frame m and its central difference m'."""
    eighth = np.float32(0.125)
    for k in range(out.size):
        before, here, there, beyond = a_before[k] + b_before[k], a0[k] + b0[k], a1[k] + b1[k], a2[k] + b2[k]
        out[k] += eighth * ((there - before) * there - here * (beyond - here))


@kernel
def block_sums(a: Array, b: Array, block: int, first: int, last: int, lines: Array, out: Array) -> None:
    """Sum over blocks of `block` x `block` px, for rows first..last-1 of blocks.

    a, b (H, W) float32; lines (KINDS, W) float32 is scratch; out (KINDS, rows, columns) float32. Pixels that
    have not all their neighbours in the frame count nothing.
    """
    height, width = a.shape
    end = width - 2
    for j in range(first, last):
        for kind in range(KINDS):
            for k in range(width):
                lines[kind, k] = np.float32(0.0)
        for y in range(max(1, j * block), min(height - 2, (j + 1) * block)):
            a0, b0, a1, b1 = a[y], b[y], a[y + 1], b[y + 1]
            lean(a0[1:end], a0[2 : end + 1], b0[1:end], b0[2 : end + 1], lines[0, 1:end])
            lean(a0[1:end], a1[1:end], b0[1:end], b1[1:end], lines[1, 1:end])
            lean_of_shift(
                a0[: end - 1], a0[1:end], a0[2 : end + 1], a0[3 : end + 2],
                b0[: end - 1], b0[1:end], b0[2 : end + 1], b0[3 : end + 2], lines[2, 1:end],
            )  # fmt: skip
            lean_of_shift(
                a[y - 1, 1:end], a0[1:end], a1[1:end], a[y + 2, 1:end],
                b[y - 1, 1:end], b0[1:end], b1[1:end], b[y + 2, 1:end], lines[3, 1:end],
            )  # fmt: skip
        for kind in range(KINDS):
            line, sums = lines[kind], out[kind, j]
            for i in range(sums.size):
                total = np.float32(0.0)
                for k in range(i * block, (i + 1) * block):
                    total += line[k]
                sums[i] = total
