"""Run a kernel over the rows of an image on all cores.

Kernels are compiled without the GIL, so plain threads suffice.  Rows go out in small blocks from one
queue: a core that meets a block without glass comes back for the next one, so off-centre scenes are
balanced by themselves.  Blocks never share an output row, hence the result has the same bits for any
number of threads and any block size.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

BLOCK_ROWS = 24  # small enough to balance, large enough that the hand-over (tens of us) does not show


def thread_count() -> int:
    """Threads used by kernels: RTPIV_THREADS, else the cores this process may run on."""
    asked = os.environ.get("RTPIV_THREADS")
    if asked:
        return max(1, int(asked))
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="rtpiv-rows")


def run_rows(
    function: Callable[[int, int], object], rows: int, block: int = BLOCK_ROWS, threads: int | None = None
) -> None:
    """Call ``function(first, last)`` for consecutive row blocks until all `rows` are done.

    Parameters
    ----------
    function : callable
        Works on rows ``first <= row < last``; releases the GIL inside (a compiled kernel).
    rows : int
        Number of rows.
    block : int
        Rows per call.
    threads : int, optional
        Threads to use; default `thread_count()`.
    """
    threads = threads or thread_count()
    spans = [(first, min(first + block, rows)) for first in range(0, rows, block)]
    if threads == 1 or len(spans) < 2:
        for first, last in spans:
            function(first, last)
        return
    for future in [_pool(threads).submit(function, *span) for span in spans]:
        future.result()
