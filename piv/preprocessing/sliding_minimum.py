"""The background of a pulse: the smallest value that a pixel takes a few time steps before and after.

Reflections of the sheet in the balls stand still, particles do not: in nine frames nearly every pixel is dark
once.  Both lasers differ, so the frames of pulse A and of pulse B are two series.  It is done to raw frames,
before the one resampling, because there a reflection covers the same pixels in every frame; counts stay whole.

    clean_t = frame_t - min(frame_(t - reach), ..., frame_(t + reach)),       fewer at both ends of the series.

A flash that fails leaves a dark frame, and a plain minimum would then give the background back to all frames
within reach.  So a frame can be left out of the others' minimum: one whose light above the minimum of all,
averaged over the picture, is less than a share of what is usual (the median over the frames within reach).

At most 2 reach + 1 frames are held, whatever the length of the series.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError

REACH_STEPS = 4
DARK_SHARE = 0.5

Frame = NDArray[Any]


def without_sliding_minimum(
    frames: Iterable[Frame | None], reach_steps: int = REACH_STEPS, dark_share: float = 0.0
) -> Iterator[Frame | None]:
    """Take the sliding minimum off the frames of one pulse, one after the other.

    Parameters
    ----------
    frames : iterable of ndarray, shape (H, W), or None
        Frames of pulse A, or of pulse B, in their order in time, of one size and one kind of number; None stands
        for a frame that was lost: time goes on without it.
    reach_steps : int
        Time steps before and after that are looked at; fewer at both ends of the series.
    dark_share : float
        Frames with less than this share of the usual light are left out of the minimum of the others; 0 for the
        plain minimum.

    Yields
    ------
    ndarray, shape (H, W), or None
        Frames without their background, not negative, of the kind that came in; NaN where any frame within reach
        is NaN. None for None, and for a frame without others within reach: its background is not known.

    Raises
    ------
    FrameError
        A frame of another size or kind than those before it.
    """
    if reach_steps < 1:
        raise FrameError(f"the time minimum needs a reach of at least 1 step, got {reach_steps}")
    near: deque[tuple[Frame, float] | None] = deque()
    place, kind = 0, None  # of the frame within `near` that is next
    source, ended = iter(frames), False
    while True:
        while not ended and len(near) <= place + reach_steps:
            try:
                frame = next(source)
            except StopIteration:
                ended = True
                break
            if frame is not None:
                kind = kind or _kind(frame)
                _check(frame, kind)
            near.append(None if frame is None else (frame, _light(frame)))
        if place >= len(near):
            return
        here = near[place]
        yield None if here is None else _clean(here[0], [each for each in near if each is not None], dark_share)
        if place == reach_steps:
            near.popleft()
        else:
            place += 1


def _clean(frame: Frame, near: list[tuple[Frame, float]], dark_share: float) -> Frame | None:
    """Frame minus the minimum of those near it; itself always counts. None if it is alone."""
    if len(near) < 2:
        return None
    lowest = _minimum([each for each, _ in near])
    if dark_share > 0.0:
        floor = _light(lowest)
        usual = float(np.median([light - floor for _, light in near]))
        bright = [each for each, light in near if each is frame or light - floor >= dark_share * usual]
        if len(bright) < len(near):
            lowest = _minimum(bright)
    clean: Frame = frame - lowest
    return clean


def _minimum(frames: list[Frame]) -> Frame:
    lowest = frames[0].copy()
    for each in frames[1:]:
        np.minimum(lowest, each, out=lowest)
    return lowest


def _light(frame: Frame) -> float:
    """Mean of a frame; of whole numbers the exact sum is taken first, so that no order of adding shows."""
    total = frame.sum(dtype=np.float64 if frame.dtype.kind == "f" else np.int64)
    return float(total) / max(frame.size, 1)


def _kind(frame: Frame) -> tuple[tuple[int, ...], np.dtype[Any]]:
    return frame.shape, frame.dtype


def _check(frame: Frame, kind: tuple[tuple[int, ...], np.dtype[Any]]) -> None:
    shape, dtype = kind
    if frame.ndim != 2 or frame.dtype.kind not in "uif":
        raise FrameError(f"a frame is a 2-D array of real numbers, this one is {frame.dtype} {frame.shape}")
    if _kind(frame) != kind:
        raise FrameError(
            f"a frame is {frame.dtype} {frame.shape} and those before it {dtype} {shape} (rows, columns); "
            "a series has one size and one kind of number"
        )
