"""Slurm arrays through submitit, as an executor: what is submitted within half a second becomes one array.

Tasks and answers go over the shared disk, into ``slurm/`` of the campaign.  A task that Slurm ends (preempted, out
of time or memory, its node gone) comes back as an error, and is tried again.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from daq.errors import RunUsageError
from rtpiv.analysis.campaign.engine import Work
from rtpiv.analysis.campaign.kernels_at_hand import work_elsewhere

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

    @property
    def is_elsewhere(self) -> bool:
        """They are."""
        return True

    def work(self, kernels: Path) -> Work:
        """Make the chunk, with kernels and threads of its own."""
        return work_elsewhere(kernels)

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
        with _Arrays(jobs) as executor:
            yield executor


class _Arrays(Executor):
    """Submits to submitit, and asks for answers."""

    def __init__(self, jobs: Any) -> None:  # noqa: ANN401 - submitit's executor
        self._jobs = jobs
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
                new, self._new = self._new, []
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
