"""Who does the work of a campaign: whatever gives an executor and says how many tasks it takes at once.

LocalProcesses   processes of one thread each on this computer
DaskWorkers      a scheduler somewhere, and `dask worker` processes that see the campaign's folder; started with
                 ``--nthreads 1``, as a worker that runs two chunks in two threads holds both in its memory
SlurmArrays      arrays of jobs through submitit: what is submitted within half a second becomes one array.  Tasks
                 and answers go over the shared disk, into ``slurm/`` of the campaign.  A task that Slurm ends
                 (preempted, out of time or memory, its node gone) comes back as an error, and is tried again
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

from daq.errors import RunInterrupted, RunUsageError
from rtpiv.analysis.series.workers import worker_processes


class Engine(Protocol):
    """Workers.

    `opened` may be entered again after its executor broke.
    """

    @property
    def slots(self) -> int:
        """Tasks that are worked on at the same time."""
        ...

    @property
    def is_elsewhere(self) -> bool:
        """Whether its workers are no children of this process, and need compiled code that is brought to them."""
        ...

    def opened(self) -> AbstractContextManager[Executor]:
        """Its executor, and its end."""
        ...


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of one thread each on this computer.

    Parameters
    ----------
    slots : int
        How many.
    """

    slots: int
    is_elsewhere: ClassVar[bool] = False

    def opened(self) -> AbstractContextManager[Executor]:
        """Start them; they end with this process, however it ends."""
        return worker_processes(self.slots)


CONNECT_S = 10
COUNT_S = 5.0  # between two looks at how many workers there are


@dataclass
class DaskWorkers:
    """Workers of a scheduler.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    """

    address: str
    is_elsewhere: ClassVar[bool] = True
    _client: Any = field(default=None, repr=False)
    _counted: tuple[float, int] = field(default=(-1e9, 1), repr=False)

    @property
    def slots(self) -> int:
        """Threads of all workers that are there now; 1 while there are none, so that tasks wait for the first."""
        at_s, count = self._counted
        if self._client is not None and time.monotonic() - at_s > COUNT_S:
            try:
                count = max(1, sum(self._client.nthreads().values()))
            except (OSError, TimeoutError) as error:
                raise _lost(self.address) from error
            self._counted = time.monotonic(), count
        return count

    @contextmanager
    def opened(self) -> Iterator[Executor]:
        """Connect.

        Raises
        ------
        RunUsageError
            Dask is not installed, or no scheduler answers at this address.
        """
        try:
            from distributed import Client
        except ImportError:
            raise RunUsageError("--scheduler needs Dask; install rtpiv[cluster]") from None
        for name in [
            name for name in logging.root.manager.loggerDict if name.startswith(("distributed", "tornado"))
        ]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what they meet comes back in our one sentence
        try:
            client = Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            text = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise RunUsageError(f"{self.address}: no Dask scheduler answers there ({text})") from None
        try:
            self._client = client
            with client.get_executor(pure=False, retries=0) as executor:
                yield executor
        finally:
            self._client = None
            client.close(timeout=CONNECT_S)


def _lost(address: str) -> RunInterrupted:
    return RunInterrupted(f"the scheduler at {address} is gone; start it, then give the same command again")


GATHER_S = 0.5


@dataclass(frozen=True)
class SlurmArrays:
    """Jobs of a Slurm cluster.

    Parameters
    ----------
    folder : Path
        For scripts, logs, tasks and answers; all nodes see it.
    slots : int
        Jobs that may run at the same time.
    options : mapping
        Of `submitit.AutoExecutor.update_parameters`, such as ``slurm_partition`` or ``timeout_min``.
    cluster : {"slurm", "local"}
        Jobs of Slurm, or processes of this computer in their place, to try it.
    """

    folder: Path
    slots: int
    options: Mapping[str, Any] = field(default_factory=dict)
    cluster: Literal["slurm", "local"] = "slurm"
    is_elsewhere: ClassVar[bool] = True

    @contextmanager
    def opened(self) -> Iterator[Executor]:
        """Submit what comes.

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
            jobs = submitit.AutoExecutor(self.folder, cluster=self.cluster)
            usual = {"name": "rtpiv", "timeout_min": 240, "cpus_per_task": 1, "mem_gb": 4}
            here = {"slurm_array_parallelism": self.slots} if self.cluster == "slurm" else {}
            jobs.update_parameters(**usual | here | dict(self.options))
        except (RuntimeError, NameError, ValueError, TypeError) as error:
            raise RunUsageError(f"Slurm does not take this: {str(error).splitlines()[0]}") from None
        # Slurm counts what runs of an array; processes of this computer nobody counts but who starts them.
        with _Arrays(jobs, None if self.cluster == "slurm" else self.slots) as executor:
            yield executor


class _Arrays(Executor):
    """Submits to submitit, no more than so many jobs `at_once`, and asks for answers."""

    def __init__(self, jobs: Any, at_once: int | None) -> None:  # noqa: ANN401 - submitit's executor
        self._jobs, self._at_once = jobs, at_once
        self._lock = threading.Lock()
        self._new: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]] = []
        self._given: list[tuple[Future[Any], Any]] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="slurm")
        self._thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        """Take a task into the next array."""
        future: Future[Any] = Future()
        with self._lock:
            self._new.append((future, fn, args))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel what is still queued or running; nothing is lost by that but time."""
        self._ends.set()
        self._thread.join()
        for _, job in self._given:
            with suppress(Exception):  # it may have ended, and Slurm may be gone
                job.cancel()

    def _watch(self) -> None:
        while not self._ends.wait(GATHER_S):
            with self._lock:
                room = len(self._new) if self._at_once is None else self._at_once - len(self._given)
                new, self._new = self._new[:room], self._new[room:]
            for future, job in zip([each[0] for each in new], self._submitted(new), strict=False):
                self._given.append((future, job))
            left = []
            for future, job in self._given:
                if not _answered(future, job):
                    left.append((future, job))
            self._given = left

    def _submitted(self, new: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]]) -> list[Any]:
        """One array for all of them; if Slurm refuses it, that is their answer."""
        if not new:
            return []
        try:
            with self._jobs.batch():
                return [self._jobs.submit(function, *arguments) for _, function, arguments in new]
        except Exception as error:  # sbatch has errors of its own
            for future, _, _ in new:
                future.set_exception(error)
            return []


def _answered(future: Future[Any], job: Any) -> bool:  # noqa: ANN401 - submitit's job
    """Pass on the answer of a job that has ended."""
    try:
        if not job.done():
            return False
        future.set_result(job.result())
    except Exception as error:  # what the job died of
        future.set_exception(error)
    return True
