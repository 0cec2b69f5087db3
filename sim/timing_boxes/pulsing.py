"""Base of boxes that give pulses by themselves: periods that begin, pulses on their way, and the outputs.

A period begins at its moment on the world's clock, with or without a listener and a living host; what
falls into it is put on its way then, and leaves at its own moment, in order.  A device connected to an output
receives each:

    outputs = line.emulator.outputs
    outputs.listen(lambda pulse: ...)        # a Pulse(output, rises_s, falls_s), in the order in which they rise
    outputs.count["C"], outputs.is_high("D", time_s)

A listener is called in the thread in which the box lives, with no lock of ours but that of the line.
"""

import heapq
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from sim.emulators.device import Clock, Emulator

MAX_KEPT_PULSES = 10_000  # pulses that can be looked back at


class Pulse(NamedTuple):
    """One pulse of one output, on the clock of the world."""

    output: str
    rises_s: float
    falls_s: float


class Outputs:
    """Every output of a box."""

    def __init__(self) -> None:
        self.count: Counter[str] = Counter()
        self.recent: deque[Pulse] = deque(maxlen=MAX_KEPT_PULSES)
        self._listeners: list[Callable[[Pulse], object]] = []

    def listen(self, hear: Callable[[Pulse], object]) -> None:
        """Add a listener; called with every pulse from now on, when it rises."""
        self._listeners.append(hear)

    def emit(self, pulse: Pulse) -> None:
        """Give a pulse."""
        self.count[pulse.output] += 1
        self.recent.append(pulse)
        for hear in self._listeners:
            hear(pulse)

    def is_high(self, output: str, time_s: float) -> bool:
        """Return whether an output was high at a moment that is not too long ago."""
        for pulse in reversed(self.recent):
            if pulse.output == output and pulse.rises_s <= time_s:
                return time_s < pulse.falls_s
        return False


class PulsingEmulator(Emulator, ABC):
    """Base of the emulators of timing units.

    Parameters
    ----------
    clock : Clock
        Time of the world.
    """

    def __init__(self, clock: Clock) -> None:
        super().__init__({}, clock)  # nothing of it moves
        self.outputs = Outputs()
        self._period_begins_s: float | None = None  # None: nothing runs
        self._coming: list[tuple[float, int, Pulse]] = []

    @property
    def is_running(self) -> bool:
        """Return whether it gives pulses."""
        return self._period_begins_s is not None

    @property
    def has_something_to_stop(self) -> bool:
        """Return whether a key that stops it, or an off, would end something."""
        return self.is_running

    def switch_off(self) -> None:
        """Power fails: no pulse."""
        super().switch_off()
        self._end_periods()

    @property
    def next_s(self) -> float | None:
        """Next moment at which a period or pulse is due."""
        moments = [self._coming[0][0]] if self._coming else []
        moments += self._due_s[:1]
        if self._period_begins_s is not None:
            moments.append(self._period_begins_s)
        return min(moments, default=None)

    def advance(self) -> None:
        """Give every pulse that is due by now, period by period."""
        now_s = self._clock.now_s()
        while self._is_on and (due_s := self.next_s) is not None and due_s <= now_s:
            self.event_s = due_s
            if self._coming and self._coming[0][0] <= due_s:
                pulse = heapq.heappop(self._coming)[2]
                if self._lets_out():
                    self.outputs.emit(pulse)
            elif self._period_begins_s is not None and self._period_begins_s <= due_s:
                self._begin_period(due_s)
            else:
                break  # power comes back; the base knows
        super().advance()

    def _send(self, time_s: float, number: int, pulse: Pulse) -> None:
        """Put a pulse of output `number` on its way; of those of one moment the lower number leaves first."""
        heapq.heappush(self._coming, (time_s, number, pulse))

    def _withdraw(self, number: int) -> None:
        """Take back what output `number` has not given yet."""
        self._coming = [each for each in self._coming if each[1] != number]
        heapq.heapify(self._coming)

    def _lets_out(self) -> bool:
        """Return whether a pulse that leaves now gets out of the box."""
        return True

    def _end_periods(self) -> None:
        """Begin no period any more, and take back what has not been given yet."""
        self._period_begins_s = None
        self._coming.clear()

    @abstractmethod
    def _begin_period(self, time_s: float) -> None:
        """Send the pulses of a period that begins now, and say when the next one does."""
