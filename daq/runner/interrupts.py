"""Ctrl-C that behaves: once finishes the step, twice stops the axes now; Ctrl-Z pauses between steps.

The handlers only count; what has to be said to controllers is said by a thread of its own, because a handler may
interrupt the very call that holds the port's lock.  SIGTERM counts as one Ctrl-C.
"""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self


class Interrupts:
    """Signals of the terminal while a run goes on.

    Parameters
    ----------
    stop_now : callable
        Called at the second Ctrl-C, from another thread.
    """

    def __init__(self, stop_now: Callable[[], None]) -> None:
        self._stop_now = stop_now
        self._presses = 0
        self._wake = threading.Event()
        self._ended = False
        self._go = threading.Event()
        self._go.set()
        self._before: dict[int, Any] = {}

    @property
    def wanted(self) -> bool:
        """Whether the run shall end after this step, or has been stopped already."""
        return self._presses > 0

    @property
    def paused(self) -> bool:
        """Whether the run shall wait before the next step."""
        return not self._go.is_set()

    def press(self) -> None:
        """Ask for the end after this step; asked twice, stop now."""
        self._presses += 1
        self._go.set()
        if self._presses >= 2:
            self._wake.set()

    def pause(self) -> None:
        """Wait before the next step until `go_on`."""
        self._go.clear()

    def go_on(self) -> None:
        """End the pause."""
        self._go.set()

    def wait(self) -> None:
        """Return when there is no pause."""
        while not self._go.wait(0.1):
            continue

    def __enter__(self) -> Self:
        threading.Thread(target=self._watch, name="stop watch", daemon=True).start()
        if threading.current_thread() is threading.main_thread():
            for number, handler in (
                (signal.SIGINT, self._on_press),
                (signal.SIGTERM, self._on_press),
                (getattr(signal, "SIGTSTP", None), self._on_pause),
            ):
                if number is not None:
                    self._before[number] = signal.signal(number, handler)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._ended = True
        self._wake.set()

    def _watch(self) -> None:
        self._wake.wait()
        if not self._ended:
            self._stop_now()

    def _on_press(self, number: int, frame: FrameType | None) -> None:
        self.press()

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        if self.paused:
            self.go_on()
        else:
            self.pause()
