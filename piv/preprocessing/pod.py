"""Background by proper orthogonal decomposition: what few patterns describe in all frames of a pulse.

Frames are columns of D (pixels x N).  The Gram matrix G = D' D = V L V' has one eigenvalue for each pattern u_k =
D v_k / sqrt(l_k).  Reflections, also such as flicker with the laser, are few strong patterns; particles that are
elsewhere in every frame share nothing, so each frame is a pattern of its own and the rest of the spectrum is flat.
A frame loses what lies along the patterns before the flat part (Mendez, Raiola, Masullo, Discetti, Ianiro,
Theunissen, Buchlin, Exp. Therm. Fluid Sci. 80, 181 (2017)):

    clean = f - sum_k (f . u_k) u_k.

It also loses what its own particles put into the patterns: r of N parts of their light, no more.

Where the flat part begins is read off it: above its median by more than three times what its smallest value is
below.  The first pattern is the mean light, so no mean is taken off before.

Frames are read block by block.  Inner products of whole counts are formed in tiles in which float64 is exact, and
then added as whole numbers: no order of adding and no number of threads shows in them.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError, SeriesError
from piv.preprocessing.series_light import same_kind

POD_MIN_FRAMES = 12  # frames, for a spectrum with a flat part
LARGEST_SHARE = 4  # at most one pattern for so many frames: else the spectrum is not flat anywhere
BLOCK = 16  # frames held at once, twice
TILE_PX = 1 << 18  # 2^16 2^16 2^18 = 2^50: sums of products of 16 bit counts are exact in float64
POD_EDGE = 3.0

Frame = NDArray[Any]
Floats = NDArray[np.float64]


def pod_patterns(read: Callable[[int], Frame], count: int) -> NDArray[np.float32]:
    """Patterns that the frames of one pulse share.

    Parameters
    ----------
    read : callable
        Frame (H, W) by its number 0 ... count - 1, uint8 or uint16; called several times for each.
    count : int
        Number N of frames, at least 12; about a hundred that are spread over the series will do.

    Returns
    -------
    ndarray of float32, shape (r, H, W)
        Orthonormal patterns, the strongest first.

    Raises
    ------
    FrameError
        Frames of different size or kind, or not of whole counts.
    SeriesError
        Too few frames, or a spectrum that is nowhere flat.
    """
    if count < POD_MIN_FRAMES:
        raise SeriesError(
            f"patterns of a background need {POD_MIN_FRAMES} frames, there are {count}; take its minimum"
        )
    gram = _gram(read, count)
    values, vectors = np.linalg.eigh(gram / max(float(gram.diagonal().max()), 1.0))
    values, vectors = values[::-1], vectors[:, ::-1]
    rank = rank_before_flat(values)
    if rank > count // LARGEST_SHARE:
        raise SeriesError(
            f"{rank} of {count} patterns stand out of the spectrum, which is flat nowhere; "
            "take frames farther apart in time, or the minimum of the series"
        )
    patterns = np.zeros((rank, *read(0).shape), np.float32)
    for number in range(count):
        frame = read(number).astype(np.float32)
        for pattern, share in zip(patterns, vectors[number, :rank], strict=True):
            pattern += np.float32(share) * frame
    for pattern in patterns:
        pattern /= np.float32(np.sqrt(np.sum(np.square(pattern, dtype=np.float64))))
    return patterns


def rank_before_flat(values: Floats) -> int:
    """Eigenvalues, falling, that stand before the flat part of their spectrum."""
    middle = float(np.median(values))
    return int(np.count_nonzero(values > middle + POD_EDGE * (middle - float(values[-1]))))


def without_patterns(frame: Frame, patterns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Frame (H, W) without what lies along patterns (r, H, W), as float32; it may fall below 0.

    Raises
    ------
    FrameError
        They differ in size.
    """
    if frame.shape != patterns.shape[1:]:
        raise FrameError(
            f"the patterns are {patterns.shape[1:]} and the frame {frame.shape} (rows, columns); "
            "take both with one camera"
        )
    clean = frame.astype(np.float32)
    whole = clean.copy()
    for pattern in patterns:
        clean -= np.float32(np.sum(whole * pattern, dtype=np.float64)) * pattern
    return clean


def _gram(read: Callable[[int], Frame], count: int) -> Floats:
    """Inner products (N, N) of all frames, exact until the last rounding to float64."""
    gram = np.zeros((count, count))
    blocks = [range(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]
    kind: Frame | None = None

    def loaded(block: range) -> list[Frame]:
        nonlocal kind
        found = []
        for number in block:
            frame = read(number)
            if frame.ndim != 2 or frame.dtype not in (np.uint8, np.uint16):
                raise FrameError(
                    f"patterns are made of raw frames of whole counts, not {frame.dtype} {frame.shape}"
                )
            kind = frame if kind is None else kind
            found.append(same_kind(frame, kind))
        return found

    for place, rows in enumerate(blocks):
        first = loaded(rows)
        for columns in blocks[place:]:
            products = _products(first, first if columns is rows else loaded(columns))
            gram[rows.start : rows.stop, columns.start : columns.stop] = products
            gram[columns.start : columns.stop, rows.start : rows.stop] = products.T
    return gram


def _products(left: list[Frame], right: list[Frame]) -> Floats:
    total = np.zeros((len(left), len(right)), np.int64)
    flat = [[frame.reshape(-1) for frame in side] for side in (left, right)]
    for first in range(0, left[0].size, TILE_PX):
        a, b = (np.stack([frame[first : first + TILE_PX] for frame in side]).astype(np.float64) for side in flat)
        total += (a @ b.T).astype(np.int64)
    return total.astype(np.float64)
