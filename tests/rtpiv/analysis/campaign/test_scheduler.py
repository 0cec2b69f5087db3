"""Handing out: workers that die, hang, dawdle, or find the disk full; every task is answered once."""

import threading
import time
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest

from daq.errors import RunInterrupted
from rtpiv.analysis.campaign import run_campaign
from rtpiv.analysis.campaign.chunk_task import ChunkTask, LeaseInfo, Outcome
from rtpiv.analysis.campaign.run_campaign import Scheduler


def tasks(count):
    return [ChunkTask("run", SimpleNamespace(number=n), Path("lease")) for n in range(count)]


@dataclass
class Pool:
    """Threads that carry out what a test says; `opened` is counted."""

    slots: int = 2
    opens: int = 0
    executor: object = None

    @contextmanager
    def opened(self):
        self.opens += 1
        if self.executor is not None:
            yield self.executor
            return
        with ThreadPoolExecutor(4 * self.slots) as pool:
            yield pool


@dataclass
class Script:
    """What becomes of each task at its first, second ... try; then it is made."""

    answers: dict
    asked: list = field(default_factory=list)

    def __call__(self, task):
        number = task.job.number
        tried = sum(1 for each in self.asked if each.job.number == number)
        self.asked.append(task)
        answers = self.answers.get(number, ())
        answer = answers[tried] if tried < len(answers) else Outcome("made")
        if isinstance(answer, Exception):
            raise answer
        return answer() if callable(answer) else answer


def carried(monkeypatch, script, count, **given):
    monkeypatch.setattr(run_campaign, "ASK_S", 0.01)
    pool = given.pop("pool", Pool())
    hands = Scheduler(pool, script, **given)
    results = list(hands.results(iter(tasks(count))))
    names = [task.name for task, _ in results]
    assert len(set(names)) == len(names)
    return hands, {task.job.number: outcome for task, outcome in results}


FAILED = Outcome("failed", "no room")


def test_every_task_is_answered_once(monkeypatch):
    _, found = carried(monkeypatch, Script({3: (Outcome("kept"),)}), 40)
    assert sorted(found) == list(range(40))
    assert [number for number, outcome in found.items() if outcome.what == "kept"] == [3]


def test_what_fails_is_tried_three_times_and_then_named(monkeypatch):
    script = Script({1: (FAILED,), 2: (FAILED, FAILED, FAILED), 5: (ValueError("lost on the way"),)})
    monkeypatch.setattr(run_campaign, "IN_A_ROW", 100)
    hands, found = carried(monkeypatch, script, 9)
    assert {number for number, outcome in found.items() if outcome.what == "failed"} == {2}
    assert sum(task.job.number == 2 for task in script.asked) == 3
    assert found[5].what == "made"
    assert not hands.stopped


def test_a_full_disk_ends_it_at_once(monkeypatch):
    script = Script(dict.fromkeys(range(4, 200), (FAILED,) * 9))
    hands, found = carried(monkeypatch, script, 200)
    assert hands.stopped == "no room"
    assert [found[number].what for number in range(4)] == ["made"] * 4
    assert len(script.asked) < 20


@dataclass
class Breaks:
    """An executor that breaks when a task of `bad` is given for the n-th time, n in its tuple."""

    bad: dict
    given: list = field(default_factory=list)

    def submit(self, function, task):
        self.given.append(task.job.number)
        if self.given.count(task.job.number) in self.bad.get(task.job.number, ()):
            raise BrokenExecutor
        future = Future()
        future.set_result(function(task))
        return future


def test_a_broken_pool_is_opened_again_and_nothing_is_lost(monkeypatch):
    pool = Pool(executor=Breaks({2: (1,), 5: (1, 2)}))
    _, found = carried(monkeypatch, Script({}), 8, pool=pool)
    assert sorted(found) == list(range(8))
    assert pool.opens == 4


def test_a_pool_that_breaks_again_and_again_is_one_sentence(monkeypatch):
    pool = Pool(executor=Breaks({2: range(100)}))
    with pytest.raises(RunInterrupted, match="fewer --workers"):
        carried(monkeypatch, Script({}), 8, pool=pool)
    assert pool.opens < 6


def test_a_lease_that_is_alive_is_waited_for(monkeypatch):
    """It beats, so it is never void, however long it takes; then its chunk is there."""
    beats = [Outcome("busy", held=LeaseInfo("t", number)) for number in range(10)]
    script = Script({0: (*beats, Outcome("kept"))})
    _, found = carried(monkeypatch, script, 2, patience_s=0.03)
    assert found[0].what == "kept"
    assert {task.over for task in script.asked} == {None}


def test_a_lease_that_is_silent_is_void_after_a_while_by_our_own_clock(monkeypatch):
    asked_s = []

    def answer(task):
        asked_s.append((time.monotonic(), task.over))
        return Outcome("made") if task.over == "t" else Outcome("busy", held=LeaseInfo("t", 7))

    _, found = carried(monkeypatch, answer, 1, patience_s=0.2)
    assert found[0].what == "made"
    assert asked_s[-1][0] - asked_s[0][0] >= 0.2
    assert {over for _, over in asked_s[:-1]} == {None}


def test_what_dawdles_at_the_end_is_begun_a_second_time(monkeypatch):
    """The first worker hangs for as long as the test: nobody waits for it."""
    ends = threading.Event()
    script = Script({3: (lambda: ends.wait(60.0) and Outcome("made"),)})
    monkeypatch.setattr(run_campaign, "SLOW_S", 0.1)
    monkeypatch.setattr(run_campaign, "ASK_S", 0.01)
    found = {}
    for task, outcome in Scheduler(Pool(), script).results(iter(tasks(4))):
        found[task.job.number] = outcome.what
        if len(found) == 4:
            ends.set()  # the threads of a test must end
    assert found == dict.fromkeys(range(4), "made")
    assert [task.beside for task in script.asked if task.job.number == 3] == [False, True]
