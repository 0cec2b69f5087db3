"""Run a kernel over the rows of an image on all cores.

Kernels are compiled without the GIL, so plain threads suffice.  Blocks of rows lie in one queue, and every core
takes the next as soon as it is done with its last: off-centre scenes are balanced by themselves.  The first
blocks are long, the last ones short (guided self-scheduling, Polychronopoulos and Kuck 1987): a call costs some
30 us before the kernel begins, a sixth of a whole map in equal blocks short enough to balance.  Blocks never share
an output row, hence the result has the same bits for any number of threads and any block size.
"""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

LEAST_ROWS = 16  # of a block whose length is not prescribed
SHARES = 3  # a block is at most this part of what is left, for each core


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
    function: Callable[[int, int], object], rows: int, block: int | None = None, threads: int | None = None
) -> None:
    """Call ``function(first, last)`` for consecutive row blocks until all `rows` are done.

    Parameters
    ----------
    function : callable
        Works on rows ``first <= row < last``; releases the GIL inside (a compiled kernel).
    rows : int
        Number of rows.
    block : int, optional
        Rows of every call, where the kernel's scratch or bits ask for it; by default as said at the top.
    threads : int, optional
        Threads to use; default `thread_count()`.
    """
    threads = threads or thread_count()
    queue = deque(_blocks(rows, block, threads))

    def work() -> None:
        while True:
            try:
                first, last = queue.popleft()
            except IndexError:
                return
            function(first, last)

    others = [_pool(threads).submit(work) for _ in range(min(threads, len(queue)) - 1)]
    try:
        work()
    finally:
        queue.clear()  # after an error or Ctrl-C nobody begins another block
        for future in others:
            if not future.cancel():  # cancelled: other work held the pool, and nothing was left for this thread
                future.result()


def _blocks(rows: int, block: int | None, threads: int) -> list[tuple[int, int]]:
    """Cut rows into (first, last), the longest first."""
    blocks, first = [], 0
    while first < rows:
        last = min(rows, first + (block or max(LEAST_ROWS, (rows - first) // (SHARES * threads))))
        blocks.append((first, last))
        first = last
    return blocks
