"""Smooth fields in few bytes: fixed point, differences to the neighbours, and deflate.

A field f over nodes becomes the integers n = round(f / step), so that |f - n step| <= step / 2.  Of these the
mixed differences

    d[i, j] = n[i, j] - n[i - 1, j] - n[i, j - 1] + n[i - 1, j - 1]

are nearly zero where f is smooth; modulo 2^32 they are undone exactly by two cumulative sums.  Their bytes are
sorted by significance, so the high ones deflate to nothing.
"""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.maps.kernels.steps import to_fields, to_steps

LEVEL = 1  # of deflate: higher ones take five times as long for a tenth of the size


def pack(values: NDArray[Any], shown: NDArray[np.bool_], step: float) -> NDArray[np.uint8]:
    """Return the bytes (B,) of fields (..., h, w) to half a step; 0 where nothing is shown."""
    steps = np.empty(values.shape, np.int32)
    to_steps(_flat(values), _flat(shown), step, steps.reshape(-1))
    whole = steps.view(np.uint32)
    for axis in (-1, -2):
        whole = np.diff(whole, axis=axis, prepend=np.uint32(0))
    return deflate(np.ascontiguousarray(whole.reshape(-1, 1).view(np.uint8).T))


def unpack(data: NDArray[np.uint8], shown: NDArray[np.bool_], step: float, hidden: float) -> NDArray[np.float64]:
    """Return the fields that `pack` took, `hidden` where nothing is shown; ValueError if they are not there."""
    parts = inflate(data, 4 * shown.size).reshape(4, -1)
    whole = np.ascontiguousarray(parts.T).view(np.uint32).reshape(shown.shape)
    for axis in (-1, -2):
        whole = np.cumsum(whole, axis=axis, dtype=np.uint32)
    fields = np.empty(shown.shape)
    to_fields(_flat(whole.view(np.int32)), _flat(shown), step, hidden, fields.reshape(-1))
    return fields


def round_to_step(
    values: NDArray[Any], shown: NDArray[np.bool_], step: float, hidden: float, out: NDArray[Any]
) -> None:
    """Write fields (h, w, ...), of which nodes (h, w) are shown, to `out` as `unpack` gives them."""
    flat, shown = _flat(values), np.repeat(shown, values.size // shown.size)
    whole = np.empty(flat.shape, np.int32)
    to_steps(flat, shown, step, whole)
    to_fields(whole, shown, step, hidden, out.reshape(-1))


def _flat(values: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(values).reshape(-1)


def deflate(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an array as deflated bytes (B,)."""
    return np.frombuffer(zlib.compress(values.tobytes(), LEVEL), np.uint8)


def inflate(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Return exactly `size` bytes; ValueError if there are others.  Memory is taken for so many and no more."""
    stream = zlib.decompressobj()
    found = stream.decompress(data.tobytes(), size + 1)
    if len(found) != size or not stream.eof:
        raise ValueError(f"{size} bytes were expected")
    return np.frombuffer(found, np.uint8)
