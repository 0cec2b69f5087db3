r"""Signals of a run that behave: once finishes the step, twice stops the axes now, and so does every further one.

    Ctrl-C, SIGTERM, SIGHUP     the first finishes the step, the second stops; they count together
    Ctrl-\ (SIGQUIT)            stops at once
    Ctrl-Z (SIGTSTP)            pauses between steps, and goes on

A SIGTERM that wants the program gone soon comes again, or is followed by a kill; what moves is then stopped by the
watchdog. SIGHUP means that the terminal has gone: what would be written there goes nowhere from then on, instead
of ending the run with an error. Under nohup a SIGHUP stays ignored.

The handlers only count; what has to be said to controllers is said by a thread of its own (`StopThread`), because
a handler may interrupt the very call that holds a port's lock, or a lock of the standard library.
"""

import signal
import threading
import time
from collections.abc import Callable
from typing import Any, Self

from daq.signal_handling import leave_terminals, terminals_of
from stages.stop_signals import StopThread

PAUSE_POLL_S = 0.05
STOPS_AT = 2  # presses


class Interrupts:
    """Signals while a run goes on.

    Parameters
    ----------
    stop_now : callable
        Called at the second press and at every further one, a few times each, from another thread.
    """

    def __init__(self, stop_now: Callable[[], None]) -> None:
        self._stop_now = stop_now
        self._presses = 0
        self._paused = False
        self._thread: StopThread | None = None
        self._terminals: list[int] = []
        self._before: dict[int, Any] = {}

    @property
    def is_end_wanted(self) -> bool:
        """True if the run shall end after this step, or has been stopped already."""
        return self._presses > 0

    @property
    def is_stopped(self) -> bool:
        """True if everything was to stop at once."""
        return self._presses >= STOPS_AT

    @property
    def is_paused(self) -> bool:
        """True if the run shall wait before the next step."""
        return self._paused

    def press(self) -> None:
        """Ask for the end after this step; asked again, stop now."""
        self._presses += 1
        self._paused = False
        if self.is_stopped and self._thread is not None:
            self._thread.press()

    def stop(self) -> None:
        """Stop now, whatever was asked before."""
        self._presses = max(self._presses, STOPS_AT - 1)
        self.press()

    def pause(self) -> None:
        """Wait before the next step until `go_on`."""
        self._paused = True

    def go_on(self) -> None:
        """End the pause."""
        self._paused = False

    def wait(self) -> None:
        """Return when there is no pause."""
        while self._paused:  # no Event: its lock is not made for signal handlers
            time.sleep(PAUSE_POLL_S)

    def __enter__(self) -> Self:
        self._thread = StopThread(lambda: self._stop_now())
        if threading.current_thread() is threading.main_thread():
            self._terminals = terminals_of()
            for name, act in (
                ("SIGINT", self.press),
                ("SIGTERM", self.press),
                ("SIGHUP", self._hang_up),
                ("SIGQUIT", self.stop),
                ("SIGTSTP", self._turn_pause),
            ):
                number = getattr(signal, name, None)
                if number is not None and not (name == "SIGHUP" and signal.getsignal(number) is signal.SIG_IGN):
                    self._before[number] = signal.signal(number, lambda *_, act=act: act())
        return self

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            thread, self._thread = self._thread, None
            thread.end()  # says what is due
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: not made by Python
        self._before.clear()

    def _hang_up(self) -> None:
        leave_terminals(self._terminals)
        self.press()

    def _turn_pause(self) -> None:
        self._paused = not self._paused
