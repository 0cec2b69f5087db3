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

NO_NUMBER, MOST = -(2**31), 2**31 - 1
LEVEL = 1  # of deflate: higher ones take five times as long for a tenth of the size


def pack(values: NDArray[Any], shown: NDArray[np.bool_], step: float) -> NDArray[np.uint8]:
    """Return the bytes (B,) of fields (..., h, w) to half a step; 0 where nothing is shown."""
    whole = _whole(values, shown, step).view(np.uint32)
    for axis in (-1, -2):
        whole = np.diff(whole, axis=axis, prepend=np.uint32(0))
    return deflate(np.ascontiguousarray(whole.reshape(-1, 1).view(np.uint8).T))


def unpack(data: NDArray[np.uint8], shown: NDArray[np.bool_], step: float, hidden: float) -> NDArray[np.float64]:
    """Return the fields that `pack` took, `hidden` where nothing is shown; ValueError if they are not there."""
    parts = inflate(data, 4 * shown.size).reshape(4, -1)
    whole = np.ascontiguousarray(parts.T).view(np.uint32).reshape(shown.shape)
    for axis in (-1, -2):
        whole = np.cumsum(whole, axis=axis, dtype=np.uint32)
    return _fields(whole.view(np.int32), shown, step, hidden)


def round_to_step(
    values: NDArray[Any], shown: NDArray[np.bool_], step: float, hidden: float
) -> NDArray[np.float64]:
    """Return fields as `unpack` gives them."""
    return _fields(_whole(values, shown, step), shown, step, hidden)


def _whole(values: NDArray[Any], shown: NDArray[np.bool_], step: float) -> NDArray[np.int32]:
    """Fields in steps; NO_NUMBER where they are not finite."""
    steps = np.rint(np.where(shown, values, 0.0) / step)
    return np.where(np.isfinite(steps), np.clip(steps, NO_NUMBER + 1, MOST), NO_NUMBER).astype(np.int32)


def _fields(steps: NDArray[np.int32], shown: NDArray[np.bool_], step: float, hidden: float) -> NDArray[np.float64]:
    return np.where(shown, np.where(steps == NO_NUMBER, np.nan, steps * step), hidden)


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
