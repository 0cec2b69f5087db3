"""A third-party library in a thread of its own: a call that never returns costs an error, not the program.

Vendors' libraries may block for ever (a cable that was pulled, a controller that is off), and few of them allow
two threads. So each is loaded, asked and closed by ONE thread; everybody else hands calls over and waits for the
answer as long as `longest_s`. What has not come back by then is given up: `stuck` says in which call, any caller
that asked gets `DeviceLost`, nothing that waited is ever begun, and no second thread is sent after the first. The
thread is a daemon without locks of ours, so the program goes on and can end.

A stop overtakes everything that waits: it is the next call after the one in progress (`next`). Into that one it
cannot reach; that would need a second thread in the library. After a stop a call is therefore given up
already after `AFTER_STOP_S`, and if it comes back at all, the stop is said then.

A library that keeps the interpreter's lock while it blocks stops every thread of the program; nothing in this
process can help against that.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from stages.errors import DeviceLost

STOP_POLL_S = 0.02  # how often a wait looks whether the bench was stopped
AFTER_STOP_S = 2.0  # patience with a call once the bench was stopped
SAID_S = 0.05  # time given to a stop to be said before its sayer goes on

T = TypeVar("T")


class _Call(Generic[T]):
    """One call: waiting, begun, done, or given up before it began."""

    def __init__(self, words: str, function: Callable[[], T]) -> None:
        self.words = words
        self.function = function
        self.done = threading.Event()
        self.given_up = False
        self.result: T
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self.function()
        except BaseException as error:  # it belongs to who asked
            self.error = error
        self.done.set()


class Calls:
    """The thread of one library.

    Parameters
    ----------
    name : str
        What the bench file calls it.
    longest_s : float
        Patience with a call, in real time whatever clock the bench has.
    hurried : callable
        Whether the bench has been stopped, so that patience is short.
    last : callable
        What the thread calls at its end, also if that comes long after the library was given up.
    """

    def __init__(self, name: str, longest_s: float, hurried: Callable[[], bool], last: Callable[[], None]) -> None:
        self._name = name
        self._longest_s = longest_s
        self._hurried = hurried
        self._last = last
        self._changed = threading.Condition()
        self._waiting: deque[_Call[Any]] = deque()
        self._next: _Call[None] | None = None
        self._present: _Call[Any] | None = None
        self._stuck = ""
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=f"library of {name}", daemon=True)
        self._thread.start()

    @property
    def stuck(self) -> str:
        """Call that the library has not answered in time; "" if there is none."""
        return self._stuck

    @property
    def alive(self) -> bool:
        """True if the thread is still in the library, or may enter it."""
        return self._thread.is_alive()

    def ask(self, words: str, function: Callable[[], T]) -> T:
        """Let the thread call something, and return what it returned.

        Parameters
        ----------
        words : str
            What is asked, as part of a sentence.
        function : callable
            The call; what it raises is raised here.

        Raises
        ------
        DeviceLost
            It has not returned in time, or an earlier one has not.
        """
        call = _Call(words, function)
        with self._changed:
            if self._stuck or self._ended:
                raise self._device_lost()
            self._waiting.append(call)
            self._changed.notify()
        try:
            self._await(call)
        except BaseException:
            call.given_up = True  # what has not begun will not
            raise
        if call.error is not None:
            raise call.error
        return call.result

    def next(self, function: Callable[[], None]) -> None:
        """Call something before all that waits; harmless when said twice.

        It is waited for shortly. Where it takes longer it is still said, as soon as the library comes back.
        """
        call = _Call("to stop", function)
        with self._changed:
            if self._ended:
                return
            self._next = call
            self._changed.notify()
        is_ours = threading.current_thread() is self._thread
        if not is_ours and not self._stuck and call.done.wait(SAID_S) and call.error is not None:
            raise call.error

    @property
    def has_ended(self) -> bool:
        """True if nothing is asked any more."""
        return self._ended

    def end(self) -> None:
        """Let the thread end when what waits has been called, and wait for it as for a call."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join(self._longest_s)

    def _await(self, call: _Call[Any]) -> None:
        end_s, hurried = time.monotonic() + self._longest_s, False
        while not call.done.wait(STOP_POLL_S):
            if not hurried and self._hurried():
                hurried, end_s = True, min(end_s, time.monotonic() + AFTER_STOP_S)
            if time.monotonic() >= end_s:
                with self._changed:
                    if call.done.is_set():
                        return
                    self._stuck = (self._present or call).words
                raise self._device_lost()

    def _device_lost(self) -> DeviceLost:
        if not self._stuck:
            return DeviceLost(f"{self._name} is closed; open it again and home its axes")
        return DeviceLost(
            f"{self._name}: its library was asked {self._stuck} and has not answered; it may move still: use the "
            "hardware stop, end this program and begin anew"
        )

    def _run(self) -> None:
        while (call := self._fetch()) is not None:
            call.run()
            with self._changed:
                self._present = None
        with contextlib.suppress(Exception):
            self._last()

    def _fetch(self) -> _Call[Any] | None:
        """Wait for the next call; None at the end."""
        with self._changed:
            while True:
                if self._next is not None:
                    self._present, self._next = self._next, None
                elif self._stuck or (self._ended and not self._waiting):
                    return None
                elif self._waiting:
                    self._present = self._waiting.popleft()
                    if self._present.given_up:
                        continue
                else:
                    self._changed.wait()
                    continue
                return self._present


def first_line(error: BaseException) -> str:
    """First line of what a library has said."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:300]
