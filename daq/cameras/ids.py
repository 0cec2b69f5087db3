"""Identity of frames: ids as a sequence without wraps, the count of missing ones, the camera's clock.

GigE Vision 1.x ids have 16 bits, never take 0 and go 65535 -> 1; GigE Vision 2 and USB3 ids have 64 bits.  A
producer of another type may pass either on, and CoaXPress tags go 65535 -> 0, so a wrap is seen by the ids alone.
An id need not start at 0 and is not reset by arming, so only differences mean anything.  Incomplete frames and
underruns used up ids too, and are subtracted from the gaps so that nothing is counted twice.

The clock that stamps frames is the camera's own.  SFNC 2 names the command `TimestampLatch` and its result
`TimestampLatchValue` [ns].  GigE Vision cameras of SFNC 1 call them `GevTimestampControlLatch` and
`GevTimestampValue`, in ticks of `GevTimestampTickFrequency` [Hz].  What is read is latched on the camera, so it is
the time of the command, not that of the answer.
"""

from dataclasses import dataclass, field

from daq.cameras.camera import Setting
from daq.cameras.sfnc import Nodes

LONGEST_GAP = 1_000_000  # ids; a camera that jumps further has begun to count anew
LONGEST_GAP_AT_WRAP = 1000  # ids; a camera that falls back from elsewhere has begun to count anew


@dataclass(slots=True)
class IdTracker:
    """Follow one camera's ids from arming to disarming.

    Parameters
    ----------
    bits : int
        16 for ids that wrap at 65535, 64 for others; an id above 65535 makes it 64, and a wrap makes it 16.
    """

    bits: int = 64
    repeated: int = 0
    sequence: int = -1
    _last: int | None = None
    _has_zero: bool = False
    _open: set[int] = field(default_factory=set)

    @property
    def gaps(self) -> int:
        """Ids that were skipped and have not come since."""
        return len(self._open)

    def note(self, frame_id: int) -> int:
        """Take the id of a frame; return its sequence number, 0 for the first.

        A frame that comes behind a later one fills its gap and gets its own number; one whose id is no gap gets
        the last number once more.  Neither moves the count.
        """
        self._has_zero = self._has_zero or frame_id == 0
        if frame_id > 0xFFFF:
            self.bits = 64
        elif self._last is not None and 0 < self._last - frame_id >= 0x10000 - LONGEST_GAP_AT_WRAP:
            self.bits = 16
        if self._last is None:
            self.sequence = 0
        else:
            step = self._difference(frame_id, self._last)
            if step <= 0:
                late = self.sequence + step
                if late in self._open:
                    self._open.remove(late)
                    return late
                self.repeated += 1
                return self.sequence
            self._open.update(range(self.sequence + 1, self.sequence + min(step, LONGEST_GAP)))
            self.sequence += step
        self._last = frame_id
        return self.sequence

    def missing(self, accounted: int) -> int:
        """Ids that came in no form at all, given how many of the gaps are known to be incomplete or underrun."""
        return max(0, self.gaps - accounted)

    def _difference(self, new: int, old: int) -> int:
        if self.bits == 64:
            return new - old
        values = 0x10000 if self._has_zero else 0xFFFF  # 1 to 65535: the wrap skips 0
        step = (new - old) % values
        return step if step < 0x8000 else step - values


NEW = ("TimestampLatch", "TimestampLatchValue")
OLD = ("GevTimestampControlLatch", "GevTimestampValue")
OLD_TICKS_PER_S = "GevTimestampTickFrequency"


class CameraClock:
    """The clock of one open camera; which of the names it knows is looked up once.

    Parameters
    ----------
    nodes : Nodes
        Its features.
    """

    def __init__(self, nodes: Nodes) -> None:
        self._ns_per_tick = 1.0
        self._names: tuple[str, str] | None = None
        for names in (NEW, OLD):
            if nodes.can_execute(names[0]) and nodes.has(names[1]):
                self._names = names
                break
        if self._names == OLD:
            per_s = _positive(nodes.get(OLD_TICKS_PER_S)) if nodes.has(OLD_TICKS_PER_S) else 0
            self._names = OLD if per_s else None
            self._ns_per_tick = 1e9 / per_s if per_s else 1.0

    def read_ns(self, nodes: Nodes) -> int | None:
        """Time on the camera's clock now; None if it has none to be read."""
        if self._names is None:
            return None
        latch, value = self._names
        nodes.execute(latch)
        ticks = _positive(nodes.get(value))
        return ticks if self._ns_per_tick == 1.0 else round(ticks * self._ns_per_tick)


def _positive(value: Setting) -> int:
    return max(0, int(value))
