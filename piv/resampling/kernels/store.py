"""Corrected values to what is stored."""

import numpy as np

from ground.jit import Array, kernel

LARGEST = np.float32(65535.0)
ZERO, ONE = np.float32(0.0), np.float32(1.0)


@kernel
def to_offset_uint16(values: Array, offset: np.float32, first: int, last: int, out: Array) -> int:
    """Round values (N,) float32 + offset to 1..65535 in out (N,) uint16, NaN and infinity to 0; count the cut."""
    cut = 0
    for index in range(first, last):
        value = np.rint(values[index] + offset)
        kept = min(max(value, ONE), LARGEST)
        is_number = value - value == ZERO  # false for NaN and infinity, and no branch
        cut += int(is_number and kept != value)
        out[index] = np.uint16(kept if is_number else ZERO)
    return cut
