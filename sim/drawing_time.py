"""Time that a simulated bench spends drawing pictures: time of this computer, and none of any camera's.

A real camera has its picture when the shutter closes; ours has to draw it first, with rays, for a second or for
minutes. A timeout of a wait for a frame takes this off what has passed.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class DrawingTime:
    """Seconds in which at least one picture was drawn; the worlds of several cameras share one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._drawing, self._since_s, self._sum_s = 0, 0.0, 0.0

    @contextmanager
    def count(self) -> Iterator[None]:
        """Count the block as drawing."""
        with self._lock:
            if not self._drawing:
                self._since_s = time.monotonic()
            self._drawing += 1
        try:
            yield
        finally:
            with self._lock:
                self._drawing -= 1
                if not self._drawing:
                    self._sum_s += time.monotonic() - self._since_s

    @property
    def so_far_s(self) -> float:
        """All of it until now, what is being drawn included."""
        with self._lock:
            return self._sum_s + (time.monotonic() - self._since_s if self._drawing else 0.0)
