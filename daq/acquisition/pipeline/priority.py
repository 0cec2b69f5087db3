"""Which threads come first: what must not be late runs as it is, what may be late steps back."""

import os
import threading

NICENESS = 5


def lower_priority() -> None:
    """Lower the priority of the calling thread, where the system can do that for a thread (Linux)."""
    if hasattr(os, "setpriority") and os.path.exists("/proc/self/task"):  # noqa: PTH110 - not a file to open
        try:
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, 0) + NICENESS)
        except OSError:
            return  # a matter of comfort only
