"""News of kernels being compiled: once on each computer, about a minute in all, in which nothing else is said.

Whoever talks to a person sets `watch` and `complain`; without them nobody is told.  Kernels from the cache are
no news.
"""

import threading
import time
from collections.abc import Callable

SAY_EVERY_S = 5.0

complain: Callable[[str], None] | None = None  # gets what is wrong with the folder of compiled code
watch: Callable[[int, float], None] | None = None  # gets how many functions are compiled, and the seconds since


class CompileCount:
    """Counts functions while they are compiled, in any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._functions = 0
        self._begun_s = self._said_s = 0.0

    def begun(self) -> None:
        """One is about to be compiled; the first one is news."""
        with self._lock:
            now_s, first = time.monotonic(), self._begun_s == 0.0
            if first:
                self._begun_s = self._said_s = now_s
        if first and watch is not None:
            watch(0, 0.0)

    def done(self) -> None:
        """One is compiled; from time to time it is news."""
        with self._lock:
            self._functions += 1
            now_s, functions, begun_s = time.monotonic(), self._functions, self._begun_s
            tells = now_s - self._said_s >= SAY_EVERY_S
            if tells:
                self._said_s = now_s
        if tells and watch is not None:
            watch(functions, now_s - begun_s)
