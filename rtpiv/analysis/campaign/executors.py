"""Executors on other computers: workers of a Dask scheduler, and jobs of a Slurm cluster by submitit.

Any `concurrent.futures.Executor` carries out a campaign; on this computer that is
`rtpiv.analysis.series.workers.worker_processes`.  Workers must see the folders of the campaign and of its runs
under the same names.  Start Dask's with ``--nthreads 1``: two chunks in two threads are both held in memory.
"""

import logging
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from daq.errors import RunInterrupted, RunUsageError
from ground.errors import RtpivError
from ground.kept_memory import keep_memory
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_plan import ChunkJob
from rtpiv.analysis.series.workers import ONE_THREAD

CONNECT_TIMEOUT_S = 10
POLL_INTERVAL_S = 0.5  # of a Slurm job
DASK_RETRIES = 2  # of a chunk whose worker was lost
SLURM_DEFAULTS = {"name": "rtpiv", "timeout_min": 240, "cpus_per_task": 1, "mem_gb": 4}


@contextmanager
def dask_workers(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    RunUsageError
        Dask is not installed, or no scheduler answers at this address.
    """
    try:
        from distributed import Client
    except ImportError:
        raise RunUsageError("--scheduler needs Dask; install rtpiv[cluster]") from None
    for name in list(logging.root.manager.loggerDict):
        if name.startswith(("distributed", "tornado")):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are reported once, by the command
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RunUsageError(f"{address}: no Dask scheduler answers there ({text})") from None
    try:
        with client.get_executor(pure=False, retries=DASK_RETRIES) as executor, _raise_interrupted():
            yield executor
    finally:
        client.close(timeout=CONNECT_TIMEOUT_S)


@contextmanager
def slurm_jobs(
    folder: Path, slots: int, options: Mapping[str, Any], cluster: Literal["slurm", "local"] = "slurm"
) -> Iterator[Executor]:
    """Submit each task as a Slurm job.

    Parameters
    ----------
    folder : Path
        For scripts, logs, tasks and results; all nodes see it.
    slots : int
        Jobs that are queued or running at the same time.
    options : mapping
        Of `submitit.AutoExecutor.update_parameters`, such as ``slurm_partition`` or ``timeout_min``.
    cluster : {"slurm", "local"}
        Jobs of Slurm, or processes of this computer in their place, for a trial.

    Raises
    ------
    RunUsageError
        Submitit is not installed, there is no Slurm, or it does not know an option.
    """
    try:
        import submitit
    except ImportError:
        raise RunUsageError("--slurm needs submitit; install rtpiv[cluster]") from None
    try:
        jobs = submitit.AutoExecutor(folder, cluster=cluster)
        jobs.update_parameters(**SLURM_DEFAULTS | dict(options))
    except (RuntimeError, NameError, ValueError, TypeError) as error:
        raise RunUsageError(f"Slurm does not take this: {str(error).splitlines()[0]}") from None
    with JobThreads(jobs, slots) as executor, _raise_interrupted():
        yield executor


@contextmanager
def _raise_interrupted() -> Iterator[None]:
    """Raise RunInterrupted for the errors that an executor has of its own."""
    try:
        yield
    except RtpivError:
        raise
    except Exception as error:
        raise RunInterrupted(
            f"a worker was lost ({type(error).__name__}: {error}); give the same command again"
        ) from error


class JobThreads(ThreadPoolExecutor):
    """A thread for each running job: it submits the job, waits for it and returns its result.

    Parameters
    ----------
    jobs : submitit.Executor
        Takes the jobs.
    slots : int
        Jobs at the same time.
    """

    def __init__(self, jobs: Any, slots: int) -> None:  # noqa: ANN401 - submitit's executor
        super().__init__(slots, thread_name_prefix="slurm")
        self._jobs, self._lock, self._closes = jobs, threading.Lock(), threading.Event()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        """Queue a task."""
        return super().submit(self._await_job, fn, args, kwargs)

    def __exit__(self, *_: object) -> None:
        """Cancel queued and running jobs; their chunks are made at the next call."""
        self._closes.set()
        self.shutdown(cancel_futures=True)

    def _await_job(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> object:
        with self._lock:  # submitit's executor and its cache of job states are shared by all threads
            job = self._jobs.submit(fn, *args, **kwargs)
        while not self._closes.wait(POLL_INTERVAL_S):
            with self._lock:
                is_done = job.done()
            if is_done:
                return job.result()
        with suppress(Exception):  # it may have ended, and Slurm may be gone
            job.cancel()
        return None


def evaluate_elsewhere(job: ChunkJob) -> None:
    """Evaluate a chunk in a process that this program has not started."""
    _set_up_process()
    evaluate_chunk(job)


@lru_cache(maxsize=1)
def _set_up_process() -> None:
    """Use one thread, and keep freed memory; once in a process."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    keep_memory()
