"""Workers of a Dask scheduler, on other computers.

Any `concurrent.futures.Executor` carries out a campaign; on this computer that is
`rtpiv.analysis.series.workers.worker_processes`.  Workers must see the folders of the campaign and of its runs
under the same names.  Start Dask's with ``--nthreads 1``: two chunks in two threads are both held in memory.
"""

import logging
import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import lru_cache

from daq.errors import RunInterrupted, RunUsageError
from ground.errors import RtpivError
from ground.kept_memory import keep_memory
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.series_plan import ChunkJob
from rtpiv.analysis.series.workers import ONE_THREAD

CONNECT_TIMEOUT_S = 10
DASK_RETRIES = 2  # of a chunk whose worker was lost


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


def evaluate_elsewhere(job: ChunkJob) -> None:
    """Evaluate a chunk in a process that this program has not started."""
    _set_up_process()
    evaluate_chunk(job)


@lru_cache(maxsize=1)
def _set_up_process() -> None:
    """Use one thread, and keep freed memory; once in a process."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    keep_memory()
