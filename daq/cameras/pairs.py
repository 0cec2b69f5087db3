"""Two frames to a pair, by id and time stamp.

One lost frame would swap A and B for the rest of a run if frames were paired in the order of arrival.  Here a
pair is two frames whose sequence numbers are neighbours and whose time stamps lie within `max_separation_us`;
the frames of neighbouring pairs are further apart.  A frame without partner is returned as such, not shifted.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from daq.cameras.frame import Frame


@dataclass(frozen=True, slots=True)
class Pair:
    """First and second exposure; one of them is None where the partner was lost."""

    first: Frame | None
    second: Frame | None

    @property
    def separation_us(self) -> float:
        """Time between the exposures on the camera's clock [us]; NaN for a broken pair."""
        if self.first is None or self.second is None:
            return float("nan")
        return (self.second.meta.timestamp_ns - self.first.meta.timestamp_ns) / 1e3


def pairs(frames: Iterable[Frame], max_separation_us: float, first_is_even: bool = True) -> Iterator[Pair]:
    """Group double-frame images.

    Parameters
    ----------
    frames : iterable of Frame
        In rising sequence, as a camera delivers them.
    max_separation_us : float
        Upper bound of the time between the exposures of one pair; must be below half the trigger period [us].
    first_is_even : bool
        Parity of the sequence number of a first exposure; used only for frames that lost their partner.

    Yields
    ------
    Pair
        In order; a lone frame is yielded in the place its parity gives it.
    """
    waiting: Frame | None = None
    for frame in frames:
        if waiting is not None:
            step = frame.meta.sequence - waiting.meta.sequence
            apart_us = (frame.meta.timestamp_ns - waiting.meta.timestamp_ns) / 1e3
            if step == 1 and 0 < apart_us <= max_separation_us:
                yield Pair(waiting, frame)
                waiting = None
                continue
            yield _lone(waiting, first_is_even)
        waiting = frame
    if waiting is not None:
        yield _lone(waiting, first_is_even)


def _lone(frame: Frame, first_is_even: bool) -> Pair:
    is_first = (frame.meta.sequence % 2 == 0) == first_is_even
    return Pair(frame, None) if is_first else Pair(None, frame)
