"""Memory that is freed stays with the process, which soon takes as much again."""

import ctypes
import sys
from contextlib import suppress

# malloc.h of glibc: free memory at the top that is kept, size from which a block is mapped alone, number of arenas
MALLOC_OPTIONS = ((-1, 1 << 30), (-3, 32 << 20), (-8, 1))


def keep_memory() -> bool:
    """Ask the C library of this process to keep freed memory; return whether it does.

    glibc returns large blocks to the system when they are freed, and the system clears every page that it hands
    out (mallopt(3)).  It learns from blocks that are freed, but late, and not in Dask's workers: they are started
    with a fixed threshold (``MALLOC_TRIM_THRESHOLD_``), and call tasks in a second thread, whose arena is unmapped
    when it is empty.
    """
    if sys.platform != "linux":
        return False
    with suppress(OSError, AttributeError):  # another C library than glibc may have no such function
        accepted = [ctypes.CDLL(None).mallopt(*option) == 1 for option in MALLOC_OPTIONS]
        return all(accepted)
    return False
