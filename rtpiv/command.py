"""The command `rtpiv`, also as ``python -m rtpiv``; its verbs are in ``rtpiv.command_line.cli``."""

import atexit
import gc
import os
import signal
import sys

# New objects before Python looks for rings among them; modules and kernels bring five times that
GARBAGE = 50_000
NO_DEVICES = (  # verbs that open none, whose libraries might have an end of their own
    "init",
    "setup",
    "compare",
    "trace",
    "calibrate",
    "correct",
    "evaluate",
    "focus",
    "sheet",
    "mean",
    "report",
    "export",
    "check",
)


def run() -> int:
    """Run one verb as the whole process, and end at once when it is done; return the exit code.

    At its end Python destroys every object, which takes a third of a second after kernels or pictures.
    Only that is left out: threads are joined, exit functions are called, streams are flushed.
    """
    if atexit._ncallbacks() or not set(NO_DEVICES).intersection(sys.argv[1:2]):  # coverage is there before us
        return main()
    done: list[int] = []
    atexit.register(_leave, done)  # first in, last called
    done.append(main())
    return done[0]


def _leave(done: list[int]) -> None:
    """End the process with the exit code of a verb that is done; otherwise let Python end it."""
    if not done:
        return
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except (OSError, ValueError):  # Python reports it
        return
    os._exit(done[0])


def _restart_in_utf8() -> None:
    """Restart with UTF-8 as the encoding of names where the locale (LC_ALL=C) has another."""
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def main() -> int:
    """Run one verb; return the exit code."""
    _restart_in_utf8()
    try:
        gc.set_threshold(GARBAGE)  # by Python's own threshold a tenth of a short command's time was such looking
        sys.excepthook = sys.__excepthook__  # from here on it is answered below
        from rtpiv.command_line.cli import (
            main as carry_out,  # found by now, whatever lies beside it: rtpiv has made room
        )

        return carry_out(sys.argv[1:])
    except KeyboardInterrupt:  # before a verb has begun, or after its end: modules load
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it may be pressed twice
        from rtpiv.command_line.exit_codes import INTERRUPTED

        print("interrupted", file=sys.stderr)
        return INTERRUPTED
