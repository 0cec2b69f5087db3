"""Tasks to workers and back: a few at a time, again where one was lost, until all are done or nothing helps.

Executors differ in how they lose work.  A process pool breaks as a whole when one of its processes is killed: it
is opened again.  A scheduler gives the task to another worker, or says that it cannot.  Both are taken for a task
that was not done.  What can be known for certain stands on the disk, so a task that was done and whose answer was
lost costs a glance.

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
from statistics import median

from daq.errors import RunInterrupted
from rtpiv.analysis.campaign.chunk_task import ChunkTask, Outcome, carry_out
from rtpiv.analysis.campaign.engine import Engine, Work

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
class HandOut:
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
        """Token of a lease that nobody has touched for `patience_s`, by our clock; None if it may be alive."""
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
