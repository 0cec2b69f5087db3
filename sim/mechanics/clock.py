"""Clocks of the simulated world.

A `VirtualClock` moves only when a thread waits on it: a campaign of hours takes milliseconds and is the same
every time. Several threads may use it, but each of them then moves it on for all, so what they do at the same time
happens in an order that differs from run to run. A `PacedClock` is one that keeps pace with the wall clock while
a camera looks. A `ScaledClock` runs some times faster than the wall clock; emulators on pseudo-terminals use it.
All satisfy `stages.clock.Clock`.
"""

import heapq
import threading
import time
from collections.abc import Callable
from itertools import count


class VirtualClock:
    """Time that passes by waiting."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._lock = threading.Lock()
        self._due: list[tuple[float, int, Callable[[], object]]] = []  # a heap; the number keeps the order
        self._numbers = count()

    def now_s(self) -> float:
        """Seconds of the simulated world."""
        return self._now_s

    def at(self, time_s: float, action: Callable[[], object]) -> None:
        """Call something when a moment comes, in the thread that lets it come; at once it is not called."""
        with self._lock:
            heapq.heappush(self._due, (time_s, next(self._numbers), action))

    def forget(self) -> None:
        """Call nothing any more of what waits for a moment."""
        with self._lock:
            self._due.clear()

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass, at once."""
        with self._lock:
            end_s = self._now_s + max(duration_s, 0.0)
            if not self._due:
                self._now_s = end_s
                return
        self._pass(end_s)

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to a moment; the past changes nothing."""
        self._pass(time_s)

    def _pass(self, end_s: float) -> None:
        """Come to a moment, and call on the way what waits for one before it; without the lock."""
        while True:
            with self._lock:
                if not self._due or self._due[0][0] > end_s:
                    self._now_s = max(self._now_s, end_s)
                    return
                time_s, _, action = heapq.heappop(self._due)
                self._now_s = max(self._now_s, time_s)
            action()


class PacedClock(VirtualClock):
    """A virtual clock that is as slow as the wall clock while it has to be, for cameras live on that one.

    Parameters
    ----------
    start_s : float
        Seconds of the simulated world at the beginning.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        super().__init__(start_s)
        self.is_paced: Callable[[], bool] = lambda: False  # called at every look and wait
        self._keeps_pace = False
        self._ahead_s = 0.0  # of the wall's clock before the world's, while it keeps pace and since

    def now_s(self) -> float:
        """Seconds of the simulated world."""
        with self._lock:
            self._follow()
            return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Let time pass, at once or in real time."""
        with self._lock:
            is_paced = self._follow()
        if not is_paced:
            super().sleep_s(duration_s)
            return
        time.sleep(max(duration_s, 0.0))
        self._pass(self.now_s())

    def advance_to(self, time_s: float) -> None:
        """Let time pass up to a moment; the past changes nothing."""
        self.sleep_s(time_s - self.now_s())

    def wall_ns(self, time_s: float) -> int:
        """Moment on the wall's monotonic clock, by the pace that is kept or was kept last."""
        with self._lock:
            self._follow()
            return round(1e9 * (time_s + self._ahead_s))

    def _follow(self) -> bool:
        """Take over the wall's time if it is to be kept pace with; whether it is."""
        if not self.is_paced():
            self._keeps_pace = False
            return False
        wall_s = time.monotonic()
        if not self._keeps_pace:
            self._keeps_pace, self._ahead_s = True, wall_s - self._now_s
        self._now_s = max(self._now_s, wall_s - self._ahead_s)
        return True


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

    def wall_ns(self, time_s: float) -> int:
        """Moment on the wall's monotonic clock."""
        wall_s, world_s, speed = self._last
        return round(1e9 * (wall_s + (time_s - world_s) / speed))

    def set_speed(self, speed: float) -> None:
        """Go on from now at another speed."""
        self._last = (time.monotonic(), self.now_s(), speed)

    def sleep_s(self, duration_s: float) -> None:
        """Sleep until that much simulated time has passed."""
        time.sleep(max(duration_s, 0.0) / self._last[2])
