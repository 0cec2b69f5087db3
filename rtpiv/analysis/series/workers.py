"""Chunks on all cores: processes of one thread each, that end with their parent.

One thread a process costs least: a pair has parts that no second thread can share.  Any `concurrent.futures`
executor will do; what it runs are plain functions of plain data.

A worker that imports and loads by itself takes 1.3 s before its first pair.  Where this process may be forked its
workers share what it has loaded, map and kernels included (`ground.forking`).
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import TypeVar

from daq.errors import RunInterrupted
from ground.errors import RtpivWarning
from ground.forking import begin_child, can_fork
from ground.kept_memory import keep_memory
from ground.rows import thread_count
from ground.terminal import progress
from rtpiv.analysis.series.series_plan import ChunkJob

Job = TypeVar("Job")
R = TypeVar("R")
ONE_THREAD = ("RTPIV_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
LEAVE_S = 10.0  # given to workers to end


@contextmanager
def workers_for(jobs: int, workers: int | None, executor: Executor | None) -> Iterator[Executor | None]:
    """Yield `executor`, else an executor of `workers` processes (default one a core); None where one is enough."""
    count = min(workers or thread_count(), jobs)
    if executor is not None or count < 2:
        yield executor
        return
    with worker_processes(count) as pool:
        yield pool


def run_jobs(
    function: Callable[[Job], R], jobs: Sequence[Job], executor: Executor | None
) -> Iterator[tuple[Job, R]]:
    """Call ``function(job)`` for all jobs; yield each one that is done, and what it gave.

    Parameters
    ----------
    function : callable
        Of a module's top, such as `evaluate_chunk`.
    jobs : sequence
        In the order in which they are begun.
    executor : Executor, optional
        Whose workers do it; without one it is done here, one after the other.

    Raises
    ------
    DiskError, FrameError
        What the function raises; what is not begun by then is not begun.
    RunInterrupted
        A worker was killed.
    """
    if executor is None:
        for job in jobs:
            yield job, function(job)
        return
    futures = {executor.submit(function, job): job for job in jobs}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenExecutor:
        raise RunInterrupted(
            "a process that evaluates was killed, perhaps for want of memory; give the same command again, with"
            " fewer --workers if that was it"
        ) from None
    finally:
        for future in futures:
            future.cancel()


def carry_out_with_progress(
    work: Callable[[ChunkJob], R], jobs: Sequence[ChunkJob], executor: Executor | None
) -> Iterator[R]:
    """Yield the result of each chunk as `run_jobs`, with a bar over pairs."""
    results = _pad_to_pairs(run_jobs(work, jobs, executor))
    for result in progress(results, sum(len(job.pairs) for job in jobs), "pairs"):
        yield from result


def _pad_to_pairs(done: Iterator[tuple[ChunkJob, R]]) -> Iterator[tuple[R, ...]]:
    """Yield (result,) of each chunk, and () for each further pair of it."""
    for job, result in done:
        yield (result,)
        yield from [()] * (len(job.pairs) - 1)


@contextmanager
def worker_processes(count: int) -> Iterator[Executor]:
    """Processes of one thread each; they end at once when the caller fails or this process ends."""
    others = set(multiprocessing.active_children())
    kept = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))  # read by the libraries while a worker starts
    forks = can_fork()
    context = multiprocessing.get_context("fork" if forks else "spawn")
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin_worker, initargs=(forks,))
    if forks:
        pool.submit(os.getpid)  # all are forked now, before any thread begins
    try:
        yield pool
    except BaseException:
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()  # what it has begun is not worth waiting for: it is made anew
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        _await_end(set(multiprocessing.active_children()) - others)
        for name, value in kept.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _await_end(workers: Collection[BaseProcess]) -> None:
    """Wait for workers that have nothing left to do, and end those that do not hear of it.

    An idle worker holds the lock of the queue while it waits; one that is killed then takes the lock with it, and
    the others would wait for ever, and a pool that is just being closed for them.
    """
    end_s = time.monotonic() + LEAVE_S
    for worker in workers:
        worker.join(max(0.0, end_s - time.monotonic()))
    for worker in workers:
        if worker.is_alive():
            worker.terminate()
            worker.join()


def _begin_worker(forked: bool) -> None:
    """Let this worker die of Ctrl-C in silence, and with its parent, which may have been killed.

    Warnings of libraries are for developers, here as in the command itself: Python's option -W shows them.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    keep_memory()
    if forked:
        begin_child()
        if "cv2" in sys.modules:
            sys.modules["cv2"].setNumThreads(1)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        warnings.simplefilter("default", RtpivWarning)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent").start()
