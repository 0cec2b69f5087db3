"""Memory that a worker gets back from one pair and needs for the next is kept, whoever has started the worker.

glibc hands large blocks back to the system as soon as they are freed unless a program shows that it wants them
again, and the system clears every page that it gives out anew.  In a process of its own the program shows it by
itself.  Dask's workers it does not: they are started with a fixed threshold (``MALLOC_TRIM_THRESHOLD_``), which
ends that adaptation, and call tasks in a second thread, whose memory lies in small pieces that are unmapped when
they are empty.  A chunk took twice as long there.  So once a process says what it wants (mallopt(3)).
"""

import ctypes
import sys
from contextlib import suppress

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # malloc.h of glibc
KEPT_BYTES = 1 << 30  # free at the top of the memory before any of it is given back
MAPPED_BYTES = 32 << 20  # what is larger is asked of the system alone; glibc takes no more than this


def keep_memory() -> bool:
    """Ask the C library of this process to keep what is freed; whether it does."""
    if sys.platform != "linux":
        return False
    with suppress(OSError, AttributeError):  # another C library than glibc may have no such function
        wishes = (M_TRIM_THRESHOLD, KEPT_BYTES), (M_MMAP_THRESHOLD, MAPPED_BYTES), (M_ARENA_MAX, 1)
        granted = [ctypes.CDLL(None).mallopt(*wish) == 1 for wish in wishes]
        return all(granted)
    return False
