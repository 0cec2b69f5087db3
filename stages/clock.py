"""Time as the stages see it, so that a simulated bench can run it faster than the wall clock."""

import time
from typing import Protocol


class Clock(Protocol):
    """A clock that never goes back."""

    def now_s(self) -> float:
        """Seconds since an arbitrary start."""

    def sleep_s(self, duration_s: float) -> None:
        """Return after `duration_s` on this clock."""


class SystemClock:
    """The computer's monotonic clock."""

    def now_s(self) -> float:
        """Seconds since an arbitrary start."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Sleep for real."""
        time.sleep(max(duration_s, 0.0))


SYSTEM_CLOCK = SystemClock()
