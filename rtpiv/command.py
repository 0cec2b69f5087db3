"""The command `rtpiv`, also as ``python -m rtpiv``; its verbs are in ``rtpiv.command_line.cli``."""

import gc
import signal
import sys

GARBAGE = 50_000  # new objects before Python looks for rings among them; modules and kernels bring five times that


def main() -> int:
    """Run one verb; return the exit code."""
    try:
        gc.set_threshold(GARBAGE)  # by Python's own threshold a tenth of a short command's time was such looking
        sys.excepthook = sys.__excepthook__  # from here on it is answered below
        from rtpiv.command_line.cli import (
            main as run,  # found by now, whatever lies beside it: rtpiv has made room
        )

        return run(sys.argv[1:])
    except KeyboardInterrupt:  # before a verb has begun, or after its end: modules load
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it may be pressed twice
        from rtpiv.command_line.exit_codes import INTERRUPTED

        print("interrupted", file=sys.stderr)
        return INTERRUPTED
