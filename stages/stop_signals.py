"""Signals stop what moves, then end the program as they always did.

    end of the process                       who stops what moves
    ---------------------------------------  ------------------------------------------------------------------
    end of the block, exception, SystemExit  `Stage.__exit__`
    SIGINT, SIGTERM, SIGHUP, SIGQUIT         this file, at once; then the program unwinds through `Stage.__exit__`
    kill -9, segfault, os._exit, no memory   `stages.watchdog`, a process of its own
    SIGSTOP, power failure                   none: what has begun goes to its target, which was judged before

A handler runs between two instructions of the main thread, perhaps inside the very call that holds a port's lock,
so it never writes to a port. It puts a word into a queue (`SimpleQueue.put` may interrupt itself), and a thread of
its own says stop: at once, and again after 30, 80 and 200 ms, because a stop that overtakes an unread command
(Grbl's jog cancel, a line still in a converter) stops nothing. Every further signal does it all again.

The thread need not wait for a handler: it hears of the signal from the system's own (`stages.wake_up`), also while
the main thread is busy in C. What the handler adds is the end of the program.

While the main thread moves something, the signal does not tear it out of the conversation with the controller: the
stop ends the motion, the call waits until the axis rests and the line is clear, and then KeyboardInterrupt
(SIGINT) or SystemExit(128 + number) is raised in place of MotionStopped. A second signal is not that patient: it
is raised where the thread stands. So positions survive one Ctrl-C wherever the controller keeps them.

SIGTSTP (Ctrl-Z) while the main thread moves something counts as Ctrl-C: a sleeping program could not be made to
stop. At rest it suspends the program as usual. A SIGHUP that was ignored before (nohup) stays ignored. Handlers
belong to the main thread; a bench that is opened in another one has the watchdog alone.
"""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any

from stages.wake_up import WakeUp

AGAIN_S = (0.03, 0.08, 0.2)  # after the first
SIGNALLED = 128  # exit code of a program that a signal has ended, plus its number

Handler = Callable[[int, FrameType | None], Any] | int | None


class StopThread:
    """Says stop from a thread of its own, several times for each `press`.

    Parameters
    ----------
    stop_now : callable
        Stops everything; what it raises is dropped, because the next saying may succeed.
    """

    def __init__(self, stop_now: Callable[[], None]) -> None:
        self._stop_now = stop_now
        self._words: SimpleQueue[bool] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="stop", daemon=True)
        self._thread.start()

    def press(self) -> None:
        """Stop now; may be called by a signal handler."""
        self._words.put(True)

    def end(self) -> None:
        """End the thread once everything due has been said."""
        self._words.put(False)
        self._thread.join()

    def _run(self) -> None:
        due_s: list[float] = []
        goes_on = True
        while goes_on or due_s:
            pressed = False
            try:
                left_s = max(0.0, due_s[0] - time.monotonic()) if due_s else None
                pressed = self._words.get(timeout=left_s)
                goes_on = goes_on and pressed
            except Empty:
                del due_s[0]
                self._say()
            if pressed:
                begun_s = time.monotonic()
                self._say()
                due_s = [begun_s + after_s for after_s in AGAIN_S]

    def _say(self) -> None:
        with contextlib.suppress(Exception):
            self._stop_now()


class StopSignals:
    """One open bench, as far as signals are concerned; see the module's text.

    Parameters
    ----------
    stop_now : callable
        Stops everything that moves, and holds it; called from another thread with the reason.
    """

    def __init__(self, stop_now: Callable[[str], None]) -> None:
        self._stop_now = stop_now
        self._why = ""
        self._thread: StopThread | None = None
        self._turns = 0
        self._leaves = False
        self._pending: int | None = None

    def enter(self) -> None:
        """Listen to signals from now on."""
        self._leaves = False
        self._thread = StopThread(lambda: self._stop_now(self._why))
        _PROCESS.join(self)

    @contextmanager
    def leaving(self, stop: bool) -> Iterator[None]:
        """Wrap the end: every stop that is due is said before the block, and no signal tears it apart.

        Parameters
        ----------
        stop : bool
            Whether something may still move.
        """
        self._leaves = True
        try:
            if stop:
                self.press("the program has left the bench")
            if self._thread is not None:
                thread, self._thread = self._thread, None
                thread.end()
            yield
        finally:
            number, self._pending, self._leaves = self._pending, None, False
            _PROCESS.part(self, number)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Hold a first signal back while the main thread talks to controllers; then raise what it asks for."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        self._turns += 1
        try:
            yield
        finally:
            self._turns -= 1
            if self._turns == 0 and not self._leaves and self._pending is not None:
                number, self._pending = self._pending, None
                _PROCESS.raise_for(number)

    def press(self, why: str) -> None:
        """Stop now; for the handlers."""
        self._why = why
        if self._thread is not None:
            self._thread.press()

    def holds_back(self, number: int) -> bool:
        """Return whether a signal waits: for the end of a motion, if it is the first, or for that of the bench."""
        waits = self._leaves or (self._turns > 0 and self._pending is None)
        if waits:
            self._pending = number
        return waits

    @property
    def moves(self) -> bool:
        """True if the main thread moves something."""
        return self._turns > 0


class _Process:
    """The handlers of this process, shared by every bench that it has open."""

    def __init__(self) -> None:
        self._open: list[StopSignals] = []
        self._before: dict[int, Handler] = {}
        self._wake_up: WakeUp | None = None

    def join(self, bench: StopSignals) -> None:
        self._open.append(bench)
        if threading.current_thread() is not threading.main_thread():
            return
        if self._wake_up is None:
            self._wake_up = WakeUp(self._hear)
            self._wake_up.open()
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK", "SIGTSTP"):
            number = getattr(signal, name, None)
            if number is None or number in self._before:
                continue
            before = signal.getsignal(number)
            if not (name == "SIGHUP" and before is signal.SIG_IGN):
                signal.signal(number, self._on_suspend if name == "SIGTSTP" else self._on_signal)
                self._before[number] = before

    def part(self, bench: StopSignals, pending: int | None) -> None:
        if bench in self._open:
            self._open.remove(bench)
        before = self._before.get(pending) if pending is not None else None
        if not self._open and threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if getattr(signal.getsignal(number), "__self__", None) is self:  # others, put there since, stay
                    signal.signal(number, signal.SIG_DFL if handler is None else handler)
            self._before.clear()
            if self._wake_up is not None:
                self._wake_up.close()
                self._wake_up = None
        if pending is not None:
            _act(pending, before, None)

    def forget(self) -> None:
        """In a forked child: the bench is its parent's, and what ends the child must not touch it."""
        if threading.current_thread() is threading.main_thread():
            for number, handler in self._before.items():
                if getattr(signal.getsignal(number), "__self__", None) is self:
                    signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._open.clear()
        self._before.clear()
        self._wake_up = None

    def _hear(self, number: int) -> None:
        """Stop, as a thread: the handler follows when the main thread is free to run it."""
        if signal.getsignal(number) == self._on_signal:  # others, such as those of a run, decide for themselves
            self._press(number)

    def _press(self, number: int) -> None:
        for bench in list(self._open):
            bench.press("Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._press(number)
        benches = list(self._open)
        held_back = [bench.holds_back(number) for bench in benches]  # every one is asked
        if not any(held_back):
            self.raise_for(number, frame)

    def _on_suspend(self, number: int, frame: FrameType | None) -> None:
        if any(bench.moves for bench in self._open):
            self._on_signal(signal.SIGINT, frame)
        else:
            os.kill(os.getpid(), signal.SIGSTOP)

    def raise_for(self, number: int, frame: FrameType | None = None) -> None:
        """Do what the signal did before."""
        _act(number, self._before.get(number), frame)


def _act(number: int, before: Handler, frame: FrameType | None) -> None:
    """Call the handler that was there before; by default KeyboardInterrupt, or the end of the program."""
    if callable(before):
        before(number, frame)
    elif before is not signal.SIG_IGN:
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(SIGNALLED + number)


_PROCESS = _Process()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_PROCESS.forget)
