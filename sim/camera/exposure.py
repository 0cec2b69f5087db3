"""Timing of exposure and readout: trigger in, exposures out, in nanoseconds and without a clock of its own.

A global-shutter sensor may expose one image while it reads out the one before, but a new exposure must not end
before that readout has.  Hence a trigger at t is taken if no exposure is running at t and t + exposure is not
earlier than the end of the readout; any other trigger is ignored and counted, as SFNC's FrameTriggerMissed.

Double-frame (one trigger, two images): B starts `interval` after A and cannot end before A is read out, so B is
exposed for about a readout time, however short A was.  Its background is brighter; real cameras do this too.

Beside it stand the camera's input lines: which was high when, and how often it was exposed since a pulse on one.
"""

from collections import deque
from dataclasses import dataclass

LINES = 4
RESET_LINE = 2  # a pulse on it sets the exposure counter to 0
KEPT_EDGES = 256


class Lines:
    """Levels of the input lines over the last pulses."""

    def __init__(self) -> None:
        self._pulses: dict[int, deque[tuple[int, int]]] = {line: deque(maxlen=KEPT_EDGES) for line in range(LINES)}
        self._exposed: deque[int] = deque(maxlen=KEPT_EDGES)

    def note(self, line: int, rise_ns: int, fall_ns: int) -> None:
        """Take a pulse; one on a line that the camera has not is lost."""
        if line in self._pulses:
            self._pulses[line].append((rise_ns, fall_ns))

    def expose(self, start_ns: int) -> None:
        """Take an exposure."""
        self._exposed.append(start_ns)

    def status(self, at_ns: int) -> int:
        """Level of every line then, one bit each (SFNC LineStatusAll)."""
        high = (
            line for line, pulses in self._pulses.items() if any(rise <= at_ns < fall for rise, fall in pulses)
        )
        return sum(1 << line for line in high)

    def exposures_since(self, line: int, at_ns: int) -> int:
        """Exposures from the last rising edge of a line until then, that of `at_ns` included."""
        last_ns = max((rise for rise, _ in self._pulses[line] if rise <= at_ns), default=0)
        return sum(last_ns <= start_ns <= at_ns for start_ns in self._exposed)


@dataclass(frozen=True, slots=True)
class Exposure:
    """One exposure: start, end, and when the last row has left the sensor."""

    start_ns: int
    end_ns: int
    read_ns: int


class Shutter:
    """The exposure state of one sensor."""

    def __init__(self) -> None:
        self.missed = 0
        self._exposed_ns = 0
        self._read_ns = 0

    def earliest_ns(self, exposure_ns: int) -> int:
        """Earliest time at which a trigger would be taken."""
        return max(self._exposed_ns, self._read_ns - exposure_ns)

    def fire(
        self, now_ns: int, exposure_ns: int, readout_ns: int, interval_ns: int | None = None, burst: int = 1
    ) -> tuple[Exposure, ...]:
        """Take a trigger.

        Parameters
        ----------
        now_ns : int
            Time of the trigger.
        exposure_ns, readout_ns : int
            Exposure time, and time to read the sensor out.
        interval_ns : int, optional
            Time from the start of A to the start of B; None for single images.
        burst : int
            Images of one trigger that follow each other as soon as the sensor can.

        Returns
        -------
        tuple of Exposure
            Exposures of this trigger; empty if it was ignored.
        """
        if now_ns < self.earliest_ns(exposure_ns):
            self.missed += 1
            return ()
        first_end = now_ns + exposure_ns
        first = Exposure(now_ns, first_end, max(first_end, self._read_ns) + readout_ns)
        last = first
        if interval_ns is not None:
            start = max(now_ns + interval_ns, first_end)
            last = Exposure(start, first.read_ns, first.read_ns + readout_ns)
        self._exposed_ns, self._read_ns = last.end_ns, last.read_ns
        taken: tuple[Exposure, ...] = (first,) if interval_ns is None else (first, last)
        for _ in range(burst - 1):
            taken += self.fire(self.earliest_ns(exposure_ns), exposure_ns, readout_ns)
        return taken
