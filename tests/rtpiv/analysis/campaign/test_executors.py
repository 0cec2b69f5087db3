"""Executors of other computers: the same bytes by Dask and by submitit; a missing library is one sentence."""

import importlib.util
import sys
import time
from concurrent.futures import CancelledError

import pytest

from daq.errors import RunInterrupted, RunUsageError
from rtpiv.analysis.campaign import executors
from rtpiv.analysis.campaign.executors import JobThreads, dask_workers, evaluate_elsewhere, slurm_jobs
from rtpiv.analysis.campaign.merge import merge_campaign
from rtpiv.analysis.campaign.run_campaign import run_campaign
from tests.rtpiv.analysis.campaign.small_campaign import carried_out, content_of, planned, two_runs

needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="distributed: not installed"
)
needs_submitit = pytest.mark.skipif(importlib.util.find_spec("submitit") is None, reason="submitit: not installed")
pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries that are not ours


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return two_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def whole(runs, tmp_path_factory):
    folder = planned(tmp_path_factory.mktemp("whole"), runs)
    carried_out(folder)
    merge_campaign(folder)
    return content_of(folder.path)


@needs_submitit
@pytest.mark.slow
def test_jobs_of_submitit_write_the_same_bytes(runs, whole, tmp_path):
    folder = planned(tmp_path / "out", runs)
    with slurm_jobs(tmp_path / "slurm", 2, {}, cluster="local") as executor:
        assert run_campaign(folder, executor, evaluate_elsewhere)[1] == 6
    merge_campaign(folder)
    assert content_of(folder.path) == whole


@needs_dask
def test_a_scheduler_that_is_not_there_is_one_sentence(monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_TIMEOUT_S", 0.3)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(RunUsageError, match="no Dask scheduler answers there"), dask_workers(address):
            pass


class Jobs:
    """In place of submitit's executor: a job runs until it has been asked three times."""

    def __init__(self):
        self.running, self.most, self.begun, self.cancelled = [], 0, 0, 0

    def submit(self, function, *arguments):
        job = Job(self, function, arguments)
        self.running.append(job)
        self.begun += 1
        self.most = max(self.most, len(self.running))
        return job


class Job:
    def __init__(self, jobs, function, arguments):
        self.jobs, self.function, self.arguments, self.asked = jobs, function, arguments, 0

    def done(self):
        self.asked += 1
        if self.asked == 3:
            self.jobs.running.remove(self)
        return self.asked >= 3

    def result(self):
        return self.function(*self.arguments)

    def cancel(self):
        self.jobs.cancelled += 1


@pytest.fixture
def jobs(monkeypatch):
    monkeypatch.setattr(executors, "POLL_INTERVAL_S", 0.01)
    return Jobs()


@pytest.mark.parametrize("slots", [1, 3])
def test_no_more_jobs_run_than_there_are_slots(jobs, slots):
    with JobThreads(jobs, slots) as executor:
        futures = [executor.submit(abs, -number) for number in range(7)]
        assert [future.result(timeout=30.0) for future in futures] == list(range(7))
    assert (jobs.begun, jobs.most, jobs.cancelled) == (7, slots, 0)


def test_running_jobs_are_cancelled_and_queued_ones_never_submitted(jobs, monkeypatch):
    monkeypatch.setattr(Job, "done", lambda self: False)
    with JobThreads(jobs, 2) as executor:
        futures = [executor.submit(abs, -number) for number in range(7)]
        while jobs.begun < 2:
            time.sleep(0.001)
    assert (jobs.begun, jobs.cancelled) == (2, 2)
    assert [future.cancelled() for future in futures] == [False] * 2 + [True] * 5


def test_an_error_of_the_executor_itself_is_an_interrupted_campaign():
    """The command can be given again; errors of the program keep their own classes."""
    with pytest.raises(RunInterrupted, match="CancelledError"), executors._raise_interrupted():
        raise CancelledError
    with pytest.raises(RunUsageError), executors._raise_interrupted():
        raise RunUsageError("given twice")


@needs_submitit
def test_a_computer_without_slurm_is_one_sentence(tmp_path):
    for options, cluster in (({}, "slurm"), ({"nonsense": 1}, "local")):
        jobs = slurm_jobs(tmp_path / "slurm", 2, options, cluster)
        with pytest.raises(RunUsageError, match="Slurm does not take this"), jobs:
            pass


@pytest.mark.parametrize("library", ["distributed", "submitit"])
def test_a_library_that_is_not_installed_is_one_sentence(tmp_path, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    executor = dask_workers("tcp://127.0.0.1:9") if library == "distributed" else slurm_jobs(tmp_path, 1, {})
    with pytest.raises(RunUsageError, match=r"install rtpiv\[cluster\]"), executor:
        pass
