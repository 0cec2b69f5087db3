"""A campaign carried out: what is missing is made, what is sound is kept, whoever works on it.

Whatever ends this program, its workers or their scheduler, the same command goes on: chunks are believed by
marker, key and hash, and everything else is made anew, with the same bytes.

Tasks are handed out a few at a time, again where one was lost, until all are done or nothing helps.  Executors
differ in how they lose work: a process pool breaks as a whole when one of its processes is killed, and is opened
again; a scheduler gives the task to another worker, or says that it cannot.  Both count as a task that was not
done.  What can be known for certain stands on the disk, so a task that was done and whose answer was lost costs a
glance.

Tried again    a task that failed, TRIES times, behind all others; three failures in a row without a success end it
               all, for a full disk will not become empty by trying
               a task of a broken pool, until the pool breaks TRIES times with nothing done in between
Busy           its lease belongs to somebody else: asked again, and taken over once it has been silent for
               `patience_s`, by this process's own clock that no one sets
Stragglers     when nothing is left to begin, what takes SLOW times as long as usual is begun by a second worker
"""

import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from statistics import median

from daq.atomic_write import why
from daq.errors import DiskError, RunInterrupted
from ground.terminal import progress
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder, write_progress
from rtpiv.analysis.campaign.campaign_plan import PlannedRun, planned_runs
from rtpiv.analysis.campaign.chunk_task import ChunkTask, Outcome, Work, carry_out
from rtpiv.analysis.campaign.engines import Engine
from rtpiv.analysis.campaign.worker_setup import carry_out_elsewhere, pack_kernels
from rtpiv.analysis.series.chunk import correction_of, results_of
from rtpiv.analysis.series.series_folder import SeriesFolder, marker_of
from rtpiv.analysis.series.series_plan import ChunkJob

TRIES = 3
IN_A_ROW = 3  # failures
AHEAD = 2  # tasks given out for each slot: a worker never waits for its next one
ASK_S = 1.0  # between two looks at whoever is busy
PATIENCE_S = 300.0  # a pair takes seconds, and compiling at first use about a minute
SLOW = 3.0
SLOW_S = 30.0  # below that nothing is slow

Name = tuple[str, int]


@dataclass(frozen=True)
class _Given:
    """A task in the hands of a worker."""

    task: ChunkTask
    since_s: float


@dataclass
class Scheduler:
    """Hands out the tasks of a campaign.

    Parameters
    ----------
    engine : Engine
        Who does them.
    work : callable
        What workers call with each.
    patience_s : float
        How long the lease of a chunk may be silent.

    Attributes
    ----------
    stopped : str
        Why tasks were left, in a sentence; empty if none were.
    """

    engine: Engine
    work: Work = carry_out
    patience_s: float = PATIENCE_S
    stopped: str = ""
    _again: deque[ChunkTask] = field(default_factory=deque)
    _busy: list[tuple[float, ChunkTask]] = field(default_factory=list)
    _seen: dict[Name, tuple[str, int, float]] = field(default_factory=dict)
    _tries: dict[Name, int] = field(default_factory=dict)
    _done: set[Name] = field(default_factory=set)
    _twice: set[Name] = field(default_factory=set)
    _took_s: list[float] = field(default_factory=list)
    _in_a_row: int = 0

    def results(self, tasks: Iterator[ChunkTask]) -> Iterator[tuple[ChunkTask, Outcome]]:
        """Yield each task with what became of it, "kept", "made" or, after the last try, "failed".

        Raises
        ------
        RunInterrupted
            The workers ended again and again, with nothing done in between.
        """
        broken = 0
        while True:
            before = len(self._done)
            running: dict[Future[Outcome], _Given] = {}
            try:
                with self.engine.opened() as executor:
                    yield from self._until_done(tasks, executor, running)
                    if running:
                        raise _Hanging
                return
            except _Hanging:  # somebody else has done what they do: they are not waited for
                return
            except BrokenExecutor:
                self._again.extendleft(given.task for given in running.values() if not self._is_done(given.task))
                broken = 1 if len(self._done) > before else broken + 1
                if broken >= TRIES:
                    raise RunInterrupted(
                        "workers are killed again and again, perhaps for want of memory; give the same command"
                        " again, with fewer --workers if that was it"
                    ) from None

    def _until_done(
        self, tasks: Iterator[ChunkTask], executor: Executor, running: dict[Future[Outcome], _Given]
    ) -> Iterator[tuple[ChunkTask, Outcome]]:
        while True:
            while len(running) < AHEAD * self.engine.slots and (task := self._next(tasks)) is not None:
                self._give(task, executor, running)
            full = len(running) >= AHEAD * self.engine.slots
            if not full and all(self._is_done(given.task) for given in running.values()):
                if not self._busy:
                    return
                time.sleep(ASK_S)
                continue
            done, _ = wait(running, ASK_S, FIRST_COMPLETED)
            for future in done:
                given = running[future]
                outcome = _outcome(future)
                del running[future]
                found = self._after(given.task, outcome)
                if found is not None:
                    yield given.task, found
            if not done:
                self._second_worker(executor, running)

    def _give(self, task: ChunkTask, executor: Executor, running: dict[Future[Outcome], _Given]) -> None:
        """Give a task to a worker; one that a broken pool does not take is kept."""
        try:
            running[executor.submit(self.work, task)] = _Given(task, time.monotonic())
        except BrokenExecutor:
            self._again.appendleft(task)
            raise

    def _next(self, tasks: Iterator[ChunkTask]) -> ChunkTask | None:
        """The next task to be given out: what comes, then what failed, then what was busy."""
        if self.stopped:
            return None
        while self._again and self._tries.get(self._again[0].name, 0) == 0:  # lost with its worker
            if not self._is_done(task := self._again.popleft()):
                return task
        fresh = next(tasks, None)
        if fresh is not None:
            return fresh
        if self._again:
            return self._again.popleft()
        now_s = time.monotonic()
        for place, (asked_s, task) in enumerate(self._busy):
            if now_s - asked_s >= ASK_S:
                del self._busy[place]
                return task
        return None

    def _after(self, task: ChunkTask, outcome: Outcome) -> Outcome | None:
        """Take an answer; return it if it is the last word on its task."""
        name = task.name
        if self._is_done(task):
            return None
        if outcome.what == "busy" and outcome.held is not None:
            self._busy.append((time.monotonic(), replace(task, over=self._void(name, outcome))))
            return None
        if outcome.what == "failed":
            self._tries[name] = self._tries.get(name, 0) + 1
            self._in_a_row += 1
            if self._in_a_row >= IN_A_ROW:
                self.stopped = self.stopped or outcome.reason
                self._again.clear()
                self._busy.clear()
            elif self._tries[name] < TRIES:
                self._again.append(task)
                return None
        else:
            self._in_a_row = 0
            if outcome.what == "made":
                self._took_s.append(outcome.seconds)
        self._done.add(name)
        return outcome

    def _void(self, name: Name, outcome: Outcome) -> str | None:
        """Token of a lease that has not been touched for `patience_s`, by our clock; None if it may be alive."""
        held, now_s = outcome.held, time.monotonic()
        assert held is not None
        token, beat_ns, since_s = self._seen.get(name, ("", -1, now_s))
        if (token, beat_ns) != (held.token, held.beat_ns):
            self._seen[name] = held.token, held.beat_ns, now_s
            return None
        return held.token if now_s - since_s >= self.patience_s else None

    def _second_worker(self, executor: Executor, running: dict[Future[Outcome], _Given]) -> None:
        """Begin what takes too long a second time, if there is nothing else to do."""
        if not self._took_s or len(running) >= self.engine.slots or self._again or self.stopped:
            return
        limit_s = max(SLOW_S, SLOW * median(self._took_s))
        for given in list(running.values()):
            name = given.task.name
            if time.monotonic() - given.since_s > limit_s and name not in self._twice:
                self._twice.add(name)
                self._give(replace(given.task, beside=True), executor, running)

    def _is_done(self, task: ChunkTask) -> bool:
        return task.name in self._done


class _Hanging(Exception):  # noqa: N818
    """Tasks are left in workers that need not be waited for."""


def _outcome(future: Future[Outcome]) -> Outcome:
    """Answer of a worker; what an engine says in its place is a failure."""
    try:
        return future.result()
    except BrokenExecutor:
        raise
    except Exception as error:  # engines have errors of their own, and none of them is ours to know
        return Outcome("failed", f"its worker was lost ({type(error).__name__}: {error})"[:1000])


KERNELS = "kernels.zip"


@dataclass(frozen=True)
class CampaignProgress:
    """What became of the chunks of a campaign in one call.

    Parameters
    ----------
    kept, made : int
        Chunks that were there and sound, and those made now.
    failed : dict of (str, int) to str
        Those that could not be made, by run and number, and why.
    stopped : str
        Why others were not tried any more; empty if all were.
    """

    kept: int
    made: int
    failed: dict[tuple[str, int], str]
    stopped: str


def run_campaign(folder: CampaignFolder, engine: Engine, patience_s: float = PATIENCE_S) -> CampaignProgress:
    """Make what is missing of a campaign.

    Parameters
    ----------
    folder : CampaignFolder
        A planned one.
    engine : Engine
        Whose workers do it.
    patience_s : float
        How long the lease of a chunk may be silent before somebody else makes it.

    Raises
    ------
    RunUnsuitable
        Another client works on this campaign, or it is none.
    RunInterrupted
        The workers end again and again.
    DiskError
        A file of the campaign itself cannot be written.
    PairError, RunDamaged, ConfigError, ...
        As `planned_runs`.
    """
    with SeriesFolder(folder.path).alone():
        kept, made, failed = 0, 0, dict[tuple[str, int], str]()
        kernels = folder.path / KERNELS
        work = partial(carry_out_elsewhere, kernels) if engine.is_elsewhere else carry_out
        scheduler = Scheduler(engine, work, patience_s)
        pairs = sum(folder.series(asked["name"]).about["pairs"] for asked in folder.about["runs"])
        results = _recorded(folder, scheduler.results(_tasks(folder, kernels if engine.is_elsewhere else None)))
        for task, outcome in _pair_by_pair(results, pairs):
            kept, made = kept + (outcome.what == "kept"), made + (outcome.what == "made")
            if outcome.what == "failed":
                failed[task.name] = outcome.reason
        return CampaignProgress(kept, made, failed, scheduler.stopped)


def _tasks(folder: CampaignFolder, kernels: Path | None) -> Iterator[ChunkTask]:
    """Every chunk as a task, run by run; what the workers of a run share is made before its first chunk."""
    is_warm = False
    for planned in planned_runs(folder):
        missing = [job for job in planned.jobs if marker_of(job.path, job.key) is None]
        if missing:
            _make_shared(planned)
            is_warm = is_warm or _warmed(missing[0], kernels)
        for job in planned.jobs:
            yield ChunkTask(planned.name, job, folder.lease(planned.name, job.number))


def _make_shared(planned: PlannedRun) -> None:
    """Trace the scene once and gather the light of the series once, before any worker asks for them."""
    planned.given.light()
    planned.given.still()
    correction_of(planned.jobs[0].maps, planned.given.method)


def _warmed(job: ChunkJob, kernels: Path | None) -> bool:
    """Let this process compile, by one pair, what workers would all compile at once; pack it for those elsewhere.

    What is not ready because that pair cannot be evaluated, workers compile themselves.
    """
    for _ in results_of(job, 1):
        pass
    try:
        if kernels is not None:
            pack_kernels(kernels)
    except OSError as error:
        raise DiskError(why(error), place=kernels, cure="make room, then give the same command again") from error
    return True


def _recorded(
    folder: CampaignFolder, results: Iterator[tuple[ChunkTask, Outcome]]
) -> Iterator[tuple[ChunkTask, Outcome]]:
    for task, outcome in results:
        if outcome.what == "made" or outcome.what == "failed":
            write_progress(
                folder.books,
                {
                    "utc": datetime.now(UTC).isoformat(timespec="seconds"),
                    "run": task.run,
                    "chunk": task.job.number,
                    "key": task.job.key,
                    "what": outcome.what,
                    "pairs": len(task.job.pairs),
                    "seconds": round(outcome.seconds, 3),
                    "host": outcome.host,
                    "pid": outcome.pid,
                    "reason": outcome.reason[:1000],
                },
            )
        yield task, outcome


def _pair_by_pair(results: Iterator[tuple[ChunkTask, Outcome]], pairs: int) -> Iterator[tuple[ChunkTask, Outcome]]:
    """The same with a bar over pairs."""

    def each() -> Iterator[tuple[ChunkTask, Outcome] | None]:
        for result in results:
            yield result
            yield from [None] * (len(result[0].job.pairs) - 1)

    for result in progress(each(), pairs, "pairs"):
        if result is not None:
            yield result
