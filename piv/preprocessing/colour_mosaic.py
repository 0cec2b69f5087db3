"""Raw frames of sensors whose pixels differ in gain by a pattern of 2 x 2: colour filters, two readout channels.

Light of one colour is seen by all of them, by each as its filter lets through, and a pattern that stands still is
left on all particles: it draws their images to every second pixel. All four kinds of pixels look at the same
scene, so their standard deviations are as their gains. These are compared block by block, in both frames: where
they differ by more than `DIFFERS` and by more than chance, each kind is divided by its own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCKS, SIDE_PX = 4, 64  # blocks along each axis, and their side
DIFFERS, CLEAR = 0.08, 6.0  # logarithm of a gain; deviations of its mean
KINDS = [(slice(row, None, 2), slice(column, None, 2)) for row in range(2) for column in range(2)]


def without_mosaic(frames: Sequence[NDArray[Any]], seen: NDArray[np.bool_]) -> tuple[NDArray[Any], ...]:
    """Both frames (H, W) with equal gains of all four kinds of pixels; as they are if that is so.

    `seen` (H, W) is True where both are numbers that count.
    """
    rows, columns = (np.linspace(0, side - SIDE_PX, BLOCKS).astype(np.int64) // 2 * 2 for side in seen.shape)
    logs = []
    for row, column in np.ndindex(BLOCKS, BLOCKS) if min(seen.shape) >= SIDE_PX else ():
        here = slice(rows[row], rows[row] + SIDE_PX), slice(columns[column], columns[column] + SIDE_PX)
        if not seen[here].all():
            continue
        for frame in frames:
            deviations = np.array([frame[here][kind].std(dtype=np.float64) for kind in KINDS])
            if deviations.min() > 0.0:
                logs.append(np.log(deviations) - np.log(deviations).mean())
    if len(logs) < 2 * BLOCKS:
        return tuple(frames)
    gains, chance = np.mean(logs, axis=0), np.std(logs, axis=0) / np.sqrt(len(logs))
    if not (np.abs(gains) > np.maximum(DIFFERS, CLEAR * chance)).any():
        return tuple(frames)
    return tuple(_equalise(frame, np.exp(gains), seen) for frame in frames)


def _equalise(frame: NDArray[Any], gains: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[Any]:
    """Frame (H, W) whose four kinds of pixels have level 0 and gain 1."""
    exact = frame.dtype.kind in "iu" and frame.dtype.itemsize <= 2
    found: Any = frame.astype(np.float32 if exact else np.float64)
    for kind, gain in zip(KINDS, gains, strict=True):
        known = found[kind][seen[kind]]
        found[kind] = (found[kind] - (np.median(known) if known.size else 0.0)) / gain
    return np.asarray(found)
