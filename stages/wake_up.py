"""Hear of signals at once, even while the main thread is in no state to run a handler.

A handler written in Python runs between two instructions of the main thread. While that thread sits in C (the
event loop of a window, a long compiled function, a prompt that waits for a key) the handler waits as long as it
takes. The system's own handler runs at once all the same, and writes the signal's number to a descriptor if it was
given one (`signal.set_wakeup_fd`). A thread of ours reads it there.

A previous owner of such a descriptor (asyncio) still gets its bytes. A forked child must not: a signal that
ends the child would be heard here as one that stops the parent's bench.
"""

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable

NO_DESCRIPTOR = -1


class WakeUp:
    """The descriptor and the thread that reads it; made, opened and closed by the main thread.

    Parameters
    ----------
    hear : callable
        Gets the number of every signal that has a Python handler, from another thread.
    """

    def __init__(self, hear: Callable[[int], None]) -> None:
        self._hear = hear
        self._near: socket.socket | None = None
        self._before = NO_DESCRIPTOR

    def open(self) -> None:
        """Listen from now on."""
        far, self._near = socket.socketpair()
        self._near.setblocking(False)
        self._before = signal.set_wakeup_fd(self._near.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._listen, args=(far, self._before), name="signals", daemon=True).start()

    def close(self) -> None:
        """Listen no more; a descriptor set since by others stays."""
        if self._near is None:
            return
        ours, now = self._near.fileno(), signal.set_wakeup_fd(self._before)
        if now != ours:
            signal.set_wakeup_fd(now)
        self._near.close()
        self._near = None

    def _listen(self, far: socket.socket, before: int) -> None:
        with far:
            while data := far.recv(64):
                if before != NO_DESCRIPTOR:
                    with contextlib.suppress(OSError):  # gone meanwhile, or full: signals are hints
                        os.write(before, data)
                for number in data:
                    self._hear(number)


def _forget() -> None:
    if threading.current_thread() is threading.main_thread():
        signal.set_wakeup_fd(NO_DESCRIPTOR)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
