"""Writing and bars that a program put into the files of frames.

They have the very same numbers in all frames, which light with its noise has not, however slow the flow is.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

AREAS = 8  # along each axis
LETTER_PX2 = 5  # side of a square, and pixels of a stroke or plateau that it must hold
LETTER_PX, HALO_PX = 15, 7  # side of gaps between letters, and of what an edge reaches
OVERLAY_QUANTILE, MOST_SAME = 0.9, 0.3  # of the pixels, which are darker; share of bright pixels that are alike
OVERLAY_PX2, OVERLAY_PX, UNWRITTEN = 20, 24, 0.7  # of what is written: pixels, length of its line; areas without
WRITTEN = 0.75  # of what is as bright as writing in either frame: share in both


def find_overlays(same: NDArray[Any], brightest: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) of bright writing and bars that a program put into the files of frames; see `same_numbers`.

    Nothing is said where bright pixels are alike all over the frame, as those of saturated particles at rest are.
    """
    import cv2

    letters, gaps = (np.ones((side, side), np.uint8) for side in (LETTER_PX2, LETTER_PX))

    def strokes(which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        around = cv2.boxFilter(which.view(np.uint8), -1, letters.shape, normalize=False)
        return np.asarray(which & (around >= LETTER_PX2))

    def lines(which: NDArray[np.bool_]) -> tuple[int, NDArray[np.int32], NDArray[np.int32]]:
        closed = cv2.morphologyEx(which.view(np.uint8), cv2.MORPH_CLOSE, gaps)
        number, parts, sizes, _ = cv2.connectedComponentsWithStats(closed)
        return number, np.asarray(parts), np.asarray(sizes)

    lit = (brightest > np.quantile(brightest[::3, ::3], OVERLAY_QUANTILE)) & valid
    core = strokes(lit & (same == brightest))
    if not core.any():
        return core
    shares = [(same == brightest)[area][lit[area]].mean() for area in areas_of(lit.shape) if lit[area].any()]
    if np.quantile(shares, UNWRITTEN) > MOST_SAME:
        return np.zeros_like(core)
    number, parts, sizes = lines(core)
    known_px = np.bincount(parts[core], minlength=number)
    kept = (known_px >= OVERLAY_PX2) & (sizes[:, 2:4].max(axis=1) >= OVERLAY_PX)
    kept[0] = False
    core &= kept[parts]
    if not core.any():
        return core
    # Digits that change between frames are as bright as the others. Light that saturates now and then, as that of
    # particles before bright lines, seldom does so in both frames.
    values, times = np.unique(brightest[core], return_counts=True)
    usual = (brightest == values[times.argmax()]) & valid
    number, parts, _ = lines(core | strokes(usual))
    known_px, same_px, usual_px = (
        np.bincount(parts[which], minlength=number) for which in (core, usual & (same == brightest), usual)
    )
    kept = (known_px > 0) & (same_px >= WRITTEN * usual_px)
    kept[0] = False
    bright = (core | usual) & kept[parts]
    return np.asarray(cv2.dilate(bright.view(np.uint8), np.ones((HALO_PX, HALO_PX), np.uint8)) > 0)


def areas_of(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Parts of a frame, `AREAS` along each axis."""
    edges = [np.linspace(0, side, AREAS + 1).astype(int) for side in shape]
    return [
        np.s_[top:bottom, left:right] for top, bottom in pairwise(edges[0]) for left, right in pairwise(edges[1])
    ]


def same_numbers(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Pixels that are the same in two frames, number by number, and the lowest number of a frame elsewhere."""
    return np.where(one == other, one, min(one.min(), other.min()))
