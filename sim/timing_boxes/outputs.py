"""The plugs at the back of a simulated timing unit: pulses go out here, and whoever hangs on them hears each.

    outputs = line.emulator.outputs
    outputs.listen(lambda pulse: ...)        # a Pulse(output, rises_s, falls_s), in the order in which they rise
    outputs.count["C"], outputs.is_high("D", time_s)

A listener is called in the thread in which the box lives, with no lock of ours but that of the line.
"""

from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

KEPT = 10_000  # pulses that can be looked back at


class Pulse(NamedTuple):
    """One pulse of one output, on the clock of the world."""

    output: str
    rises_s: float
    falls_s: float


class Outputs:
    """Every output of a box."""

    def __init__(self) -> None:
        self.count: Counter[str] = Counter()
        self.recent: deque[Pulse] = deque(maxlen=KEPT)
        self._listeners: list[Callable[[Pulse], object]] = []

    def listen(self, hear: Callable[[Pulse], object]) -> None:
        """Hang somebody on; called with every pulse from now on, when it rises."""
        self._listeners.append(hear)

    def emit(self, pulse: Pulse) -> None:
        """Give a pulse."""
        self.count[pulse.output] += 1
        self.recent.append(pulse)
        for hear in self._listeners:
            hear(pulse)

    def is_high(self, output: str, time_s: float) -> bool:
        """Whether an output was high at a moment that is not too long ago."""
        for pulse in reversed(self.recent):
            if pulse.output == output and pulse.rises_s <= time_s:
                return time_s < pulse.falls_s
        return False
