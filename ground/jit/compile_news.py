"""News of kernels being compiled: once on each computer, about a minute in all, in which nothing else is said.

A program that talks to a person sets `watch` and `complain`; without them nothing is said.  Kernels from the
cache are no news.
"""

import threading
import time
from collections.abc import Callable
from typing import Protocol

SAY_EVERY_S = 5.0

complain: Callable[[str], None] | None = None  # gets what is wrong with the folder of compiled code


class Helper(Protocol):
    """Hears of every kernel that is compiled for a call of its own, not of those that it calls itself."""

    def start(self, place: str, form: object) -> None:
        """Hear that "module:name" is missing for arguments of these types, see `ground.jit.signatures`."""

    def finish(self, place: str) -> None:
        """Hear that it is compiled."""


make_helper: Callable[[], Helper] | None = None  # called when the first kernel is missing
helper: Helper | None = None  # what it made
watch: Callable[[int, float], None] | None = None  # gets how many functions are compiled, and the seconds since


class CompileCount:
    """Counts functions while they are compiled, in any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._functions = 0
        self._begun_s = self._said_s = 0.0

    def start(self) -> None:
        """One is about to be compiled; the first one is news."""
        with self._lock:
            now_s, first = time.monotonic(), self._begun_s == 0.0
            if first:
                self._begun_s = self._said_s = now_s
        if first and watch is not None:
            watch(0, 0.0)

    def finish(self) -> None:
        """One is compiled; from time to time it is news."""
        with self._lock:
            self._functions += 1
            now_s, functions, begun_s = time.monotonic(), self._functions, self._begun_s
            tells = now_s - self._said_s >= SAY_EVERY_S
            if tells:
                self._said_s = now_s
        if tells and watch is not None:
            watch(functions, now_s - begun_s)


def missing(place: str, form: object) -> None:
    """Notify the helper, if one is wanted, of a kernel that is about to be compiled."""
    global helper
    if helper is None and make_helper is not None:
        helper = make_helper()
    if helper is not None:
        helper.start(place, form)


def report_compiled(place: str) -> None:
    """Notify the helper that it is compiled."""
    if helper is not None:
        helper.finish(place)
