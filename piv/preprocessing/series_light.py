"""The background of a whole series of one pulse: the minimum or the mean of every pixel over all its frames.

Simple and common; right where neither laser nor reflections change while the series is taken.  The minimum leaves
particles whole; the mean takes their share of the light off as well, which correlation does not notice.  A frame
more costs no memory.  Whole counts are summed as whole numbers, so no order of adding shows.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError, SeriesError

SERIES_MIN_PAIRS = 2


def series_minimum(frames: Iterable[NDArray[Any]]) -> NDArray[Any]:
    """Minimum of every pixel (H, W) over frames (H, W), at least two; of the kind of number that came in.

    Raises
    ------
    FrameError
        Frames of different size or kind.
    SeriesError
        Fewer than two.
    """
    lowest, count = None, 0
    for frame in frames:
        if lowest is None:
            lowest = frame.copy()
        else:
            np.minimum(lowest, same_kind(frame, lowest), out=lowest)
        count += 1
    return _enough(lowest, count)


def series_mean(frames: Iterable[NDArray[Any]]) -> NDArray[np.float32]:
    """Mean of every pixel (H, W) over frames (H, W), at least two, as float32.

    Raises
    ------
    FrameError
        Frames of different size or kind.
    SeriesError
        Fewer than two.
    """
    total, first, count = None, None, 0
    for frame in frames:
        if total is None or first is None:
            first = frame
            total = frame.astype(np.float64 if frame.dtype.kind == "f" else np.int64)
        else:
            total += same_kind(frame, first)
        count += 1
    return (_enough(total, count) / count).astype(np.float32)


def without_light(frame: NDArray[Any], light: NDArray[Any]) -> NDArray[np.float32]:
    """Frame (H, W) minus a background (H, W), as float32; it may fall below 0.

    Raises
    ------
    FrameError
        They differ in size.
    """
    if frame.shape != light.shape:
        raise FrameError(
            f"the background is {light.shape} and the frame {frame.shape} (rows, columns); "
            "take both with one camera"
        )
    return frame.astype(np.float32) - light.astype(np.float32)


def same_kind(frame: NDArray[Any], first: NDArray[Any]) -> NDArray[Any]:
    """Return the frame; FrameError if its size or kind of number is not that of the first."""
    if frame.shape != first.shape or frame.dtype != first.dtype:
        raise FrameError(
            f"a frame is {frame.dtype} {frame.shape} and those before it {first.dtype} {first.shape} "
            "(rows, columns); a series has one size and one kind of number"
        )
    return frame


def _enough(found: NDArray[Any] | None, count: int) -> NDArray[Any]:
    if found is None or count < SERIES_MIN_PAIRS:
        raise SeriesError(
            f"a background is what several frames share, and there are {count}; take more pairs or none"
        )
    return found
