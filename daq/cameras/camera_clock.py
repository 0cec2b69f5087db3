"""Reading a camera's own clock: the one that stamps its frames.

SFNC 2 names the command `TimestampLatch` and its result `TimestampLatchValue` [ns].  GigE Vision cameras of SFNC 1
call them `GevTimestampControlLatch` and `GevTimestampValue`, in ticks of `GevTimestampTickFrequency` [Hz].  What
is read is latched on the camera, so it is the time of the command, not that of the answer.
"""

from daq.cameras.camera import Setting
from daq.cameras.sfnc import Nodes

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
