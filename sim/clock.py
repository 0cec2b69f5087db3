"""Clocks of the simulated world.

A `VirtualClock` moves only when somebody waits on it: a campaign of hours takes milliseconds and is the same
every time. Several threads may use it, but each of them then moves it on for all, so what they do at the same time
happens in an order that differs from run to run. A `ScaledClock` runs some times faster than the wall clock;
emulators on pseudo-terminals use it. Both satisfy `stages.clock.Clock`.
"""

import threading
import time


class VirtualClock:
    """Time that passes by waiting."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._lock = threading.Lock()

    def now_s(self) -> float:
        """Seconds of the simulated world."""
        return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass, at once."""
        with self._lock:
            self._now_s += max(duration_s, 0.0)

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to a moment; the past changes nothing."""
        with self._lock:
            self._now_s = max(self._now_s, time_s)


class ScaledClock:
    """The wall clock, faster.

    Parameters
    ----------
    speed : float
        Simulated seconds per second.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self._last = (time.monotonic(), 0.0, speed)  # wall, world, speed since then: replaced as one

    def now_s(self) -> float:
        """Seconds of the simulated world."""
        wall_s, world_s, speed = self._last
        return world_s + (time.monotonic() - wall_s) * speed

    def set_speed(self, speed: float) -> None:
        """Go on from now at another speed."""
        self._last = (time.monotonic(), self.now_s(), speed)

    def sleep_s(self, duration_s: float) -> None:
        """Sleep until that much simulated time has passed."""
        time.sleep(max(duration_s, 0.0) / self._last[2])
