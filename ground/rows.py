"""Run a kernel over the rows of an image on all cores.

Kernels are compiled without the GIL, so plain threads suffice.  Blocks of rows lie in one queue, and every core
takes the next as soon as it is done with its last: off-centre scenes are balanced by themselves.  The first
blocks are long, the last ones short (guided self-scheduling, Polychronopoulos and Kuck 1987): a call costs some
30 us before the kernel begins, a sixth of a whole map in equal blocks short enough to balance.  Blocks never share
an output row, hence the result has the same bits for any number of threads and any block size.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
LEAST_ROWS = 16  # of a block whose length is not prescribed
NAME = "rtpiv-rows"
SHARES = 3  # a block is at most this part of what is left, for each core
_pools: dict[int, ThreadPoolExecutor] = {}
_one_at_a_time = threading.Lock()


def thread_count() -> int:
    """Threads used by kernels: RTPIV_THREADS, else the cores this process may run on."""
    asked = os.environ.get("RTPIV_THREADS")
    if asked:
        return max(1, int(asked))
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _pool(threads: int) -> ThreadPoolExecutor:
    with _one_at_a_time:
        if threads not in _pools:
            _pools[threads] = ThreadPoolExecutor(threads, thread_name_prefix=NAME)
        return _pools[threads]


def end_idle_threads() -> None:
    """End the threads of a program that has no others beside its first, the caller; they begin anew later."""
    if all(each.name.startswith(NAME) for each in threading.enumerate() if each is not threading.main_thread()):
        while _pools:
            _pools.popitem()[1].shutdown()


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
        queue.clear()  # after an error or Ctrl-C no thread begins another block
        for future in others:
            # Cancelled: other work held the pool, and nothing was left for this thread
            if not future.cancel():
                future.result()


def run_parts(function: Callable[[T], object], parts: Iterable[T], threads: int | None = None) -> None:
    """Call ``function(part)`` for all parts on all cores, the first ones while later ones are still being made.

    Parts are made by the caller's own thread, only a few more than threads before one is done.  That thread also
    works on what no other has begun, and on the last: a single part is not handed over.
    """
    threads = threads or thread_count()
    waiting: deque[tuple[T, Future[object]]] = deque()

    def end_first() -> None:
        part, future = waiting.popleft()
        if future.cancel():
            function(part)
        else:
            future.result()

    held: list[T] = []
    try:
        for part in parts:
            for earlier in held:
                if threads == 1:
                    function(earlier)
                    continue
                if len(waiting) > threads:
                    end_first()
                waiting.append((earlier, _pool(threads).submit(function, earlier)))
            held = [part]
        for last in held:
            function(last)
        while waiting:
            end_first()
    finally:
        # After an error or Ctrl-C no thread begins another part
        for _, future in waiting:
            future.cancel()
        wait([future for _, future in waiting])


def map_parts(function: Callable[[T], R], parts: Iterable[T], threads: int | None = None) -> list[R]:
    """Return ``function(part)`` of all parts, in their order, computed as `run_parts` does.

    Of several that fail the error of the first is raised, whatever the number of threads.
    """
    found: dict[int, R] = {}
    failed: dict[int, Exception] = {}

    def keep(numbered: tuple[int, T]) -> None:
        number, part = numbered
        try:
            found[number] = function(part)
        except Exception as error:
            failed[number] = error

    run_parts(keep, enumerate(parts), threads)
    if failed:
        raise failed[min(failed)]
    return [found[number] for number in sorted(found)]


def _blocks(rows: int, block: int | None, threads: int) -> list[tuple[int, int]]:
    """Cut rows into (first, last), the longest first."""
    blocks, first = [], 0
    while first < rows:
        last = min(rows, first + (block or max(LEAST_ROWS, (rows - first) // (SHARES * threads))))
        blocks.append((first, last))
        first = last
    return blocks
