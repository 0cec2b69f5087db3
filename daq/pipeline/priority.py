"""Thread priorities: work that must not be late keeps its own, work that may be late gets a lower one."""

import os
import threading
from contextlib import suppress
from pathlib import Path

NICENESS = 5


def lower_priority(steps: int = 1) -> None:
    """Lower the priority of the calling thread, where the system can do that for a thread (Linux).

    Parameters
    ----------
    steps : int
        1 for what a frame waits for, 2 for what is only displayed.
    """
    if hasattr(os, "setpriority") and os.path.exists("/proc/self/task"):  # noqa: PTH110 - not a file to open
        try:
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, 0) + steps * NICENESS)
        except OSError:
            return  # a matter of comfort only


def lower_process() -> None:
    """Lower the priority of this process, which is the first of a session of its own, below every thread's.

    Linux may share the processor by sessions first (autogroup; sched(7)): there a niceness counts among processes
    of one session, and the session has one of its own.
    """
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    if hasattr(os, "getsid") and os.getsid(0) == os.getpid():
        with suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(NICENESS))
