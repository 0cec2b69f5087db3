"""Similarity of frames: tells how a sequence is paired, and what a file holds.

Two exposures of one flow are alike in most places but for a shift, frames of two pairs are not: correlations of
small tiles are 0.4 to 0.9 for public pairs, vortices included, and 0.03 to 0.1 for unlike frames.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from daq.frames.double_frames import PARTS, Layout, part_of
from daq.frames.named_frame import read_named
from daq.frames.pairing import FramePlaces
from piv.errors import FrameError, PairError

TILE_PX, TILES = 96, 4  # side of what is correlated, and how many lie along each side of a frame
LEAST_PX = 16  # of a side that can be correlated
ALIKE = 0.2  # correlation, median of the tiles, of frames of a pair at least
MORE_ALIKE = 2.0  # times that of two frames that are no pair, at least
LEAST_MOVED_PX = 1.5  # between neighbouring rows: particles of one exposure lie in both
UNEVEN_PX = 15  # light that is uneven over more than this is alike in all frames, and is taken off

Pixels = NDArray[Any]


def likeness(one: Pixels, other: Pixels) -> tuple[float, float]:
    """Return how well tiles of two pictures correlate, and how far apart they are [px]; medians of the tiles."""
    import cv2  # most commands read no external frames

    height, width = (min(one.shape[k], other.shape[k]) for k in (0, 1))
    sides = min(TILE_PX, height), min(TILE_PX, width)
    found = []
    for top in np.linspace(0, height - sides[0], TILES).astype(int):
        for left in np.linspace(0, width - sides[1], TILES).astype(int):
            spectra = []
            for picture in (one, other):
                tile = picture[top : top + sides[0], left : left + sides[1]].astype(np.float32)
                tile = tile - cv2.blur(tile, (UNEVEN_PX, UNEVEN_PX))
                spectra.append(np.fft.rfft2(tile / max(float(np.linalg.norm(tile)), 1e-9)))
            plane = np.fft.irfft2(spectra[0].conj() * spectra[1], s=sides)
            place = np.unravel_index(int(plane.argmax()), plane.shape)
            moved = [min(int(at), side - int(at)) for at, side in zip(place, sides, strict=True)]
            found.append((float(plane.max()), float(np.hypot(*moved))))
    value, moved_px = np.median(found, axis=0)
    return float(value), float(moved_px)


def layout_of(one: Pixels, other: Pixels, across: float) -> Layout | None:
    """Return how the exposures of a pair lie in each of two pictures, if they do.

    Parameters
    ----------
    one, other : ndarray (H, W)
        Two pictures that follow each other in the order of their names.
    across : float
        How well one correlates with the other.
    """
    found: dict[Layout, float] = {}
    for layout in get_args(Layout):
        if layout == "interlaced":  # as recorded: rows that are filled in between are alike
            halves = [(picture[0::2][: len(picture) // 2], picture[1::2]) for picture in (one, other)]
        else:
            halves = [
                (part_of(picture, PARTS[layout][0]), part_of(picture, PARTS[layout][1]))
                for picture in (one, other)
            ]
        if min(halves[0][0].shape) < LEAST_PX:
            continue
        measured = [likeness(*both) for both in halves]
        if layout != "interlaced" or min(moved_px for _, moved_px in measured) >= LEAST_MOVED_PX:
            found[layout] = min(value for value, _ in measured)
    best = max(found, key=lambda layout: found[layout], default=None)
    return best if best is not None and found[best] > max(ALIKE, MORE_ALIKE * across) else None


def require_pairs(path: Path, pairs: Sequence[FramePlaces]) -> None:
    """Refuse a sequence that is paired in the wrong way, where its first frames show the right one.

    Parameters
    ----------
    path : Path
        The name of the sequence, for the message.
    pairs : sequence of (int, Path, Path)
        Its pairs.

    Raises
    ------
    PairError
        Each file holds both frames of a pair, or the second frames belong to the first ones that follow them.
    """
    try:
        first, second, *later = (read_named(place) for place in (*pairs[0][1:], *(pair[1] for pair in pairs[1:2])))
    except FrameError:  # reported where the pair is left out
        return
    if first.shape != second.shape or min(first.shape) < LEAST_PX:
        return
    across, _ = likeness(first, second)
    if across >= ALIKE:
        return
    if (layout := layout_of(first, second, across)) is not None:
        raise PairError(
            f"each file holds both exposures of a pair: its halves are alike, the files {pairs[0][1].name} and"
            f" {pairs[0][2].name} are not",
            place=path,
            cure=f"give --both {layout}",
        )
    if not later or later[0].shape != second.shape:
        return
    follows, _ = likeness(second, later[0])
    if follows > max(ALIKE, MORE_ALIKE * across):
        raise PairError(
            f"{pairs[0][2].name} belongs to {pairs[1][1].name}, and {pairs[0][1].name} to neither: its partner was"
            " lost",
            place=path,
            cure=f'give "{path}@2-3,4-5"',
        )
