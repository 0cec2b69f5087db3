"""The command `rtpiv`, also as ``python -m rtpiv``; its verbs are in ``daq.cli``."""

import sys


def main() -> int:
    """Run one verb; return the exit code."""
    from daq.cli import main as run  # found by now, whatever lies beside it: rtpiv has made room

    return run(sys.argv[1:])
