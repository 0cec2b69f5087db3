"""Every verb ends orderly on request: by SIGTERM, or by SIGHUP when the window it runs in is closed.

Both would end a program where it stands, with temporary files and locks left behind.  Here each is raised in the
main thread as SystemExit(128 + number), so that everything is put away as after an error.  Benches that are open
stop what moves first (`stages.stop_signals`), and a run finishes its step (`runner.interrupts`); both put their
own handlers in place of these for as long as they need them.

A second signal is ignored: those who close a session send several in a row.  One that comes later than
END_PATIENCE_S ends the program as it always did.  Under nohup a SIGHUP stays ignored.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALLED = 128  # exit code of a program that a signal has ended, plus its number
END_PATIENCE_S = 5.0


@contextmanager
def handle_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into SystemExit within the block; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    terminals = terminals_of()
    first_s: list[float] = []

    def end(number: int, frame: FrameType | None) -> None:
        if number == getattr(signal, "SIGHUP", None):
            leave_terminals(terminals)
        if not first_s:
            first_s.append(time.monotonic())
            raise SystemExit(SIGNALLED + number)
        if time.monotonic() - first_s[0] > END_PATIENCE_S:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    before = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:  # others decide for themselves
            before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is end:  # a program that ends must not be torn apart late
                signal.signal(number, signal.SIG_IGN if first_s else handler)


def terminals_of() -> list[int]:
    """Descriptors of the standard output and error that are terminals now."""
    return [number for number in (1, 2) if os.isatty(number)]


def leave_terminals(terminals: list[int]) -> None:
    """Let what would be written to a terminal that has gone go nowhere, instead of ending in an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in terminals:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def flush_or_leave() -> OSError | None:
    """Write what is still to be said; return why that failed, and let the rest go nowhere."""
    failed = None
    for number, stream in ((1, sys.stdout), (2, sys.stderr)):
        try:
            if stream is not None:
                stream.flush()
        except OSError as error:
            failed = error
            leave_terminals([number])
    return failed
