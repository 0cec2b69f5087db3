"""Input lines of a camera: which was high when, and how often it was exposed since a pulse on one of them."""

from collections import deque

LINES = 4
RESET_LINE = 2  # a pulse on it sets the exposure counter to 0
KEPT = 256


class Lines:
    """Levels of the input lines over the last pulses."""

    def __init__(self) -> None:
        self._pulses: dict[int, deque[tuple[int, int]]] = {line: deque(maxlen=KEPT) for line in range(LINES)}
        self._exposed: deque[int] = deque(maxlen=KEPT)

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
