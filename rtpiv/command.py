"""The command `rtpiv`, also as ``python -m rtpiv``; its verbs are in ``rtpiv.command_line.cli``."""

import signal
import sys


def main() -> int:
    """Run one verb; return the exit code."""
    try:
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
