"""Other people's engines: the same bytes by Dask workers and by submitit; what is missing is one sentence."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from daq.errors import RunUsageError
from rtpiv.analysis.campaign import engines
from rtpiv.analysis.campaign.engines import DaskWorkers, SlurmArrays
from rtpiv.analysis.campaign.merge import merge_campaign
from rtpiv.analysis.campaign.run_campaign import run_campaign
from rtpiv.analysis.campaign.worker_setup import _made_ready, pack_kernels
from tests.rtpiv.analysis.campaign.small_campaign import Threads, content_of, planned, two_runs

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
    run_campaign(folder, Threads(1))
    merge_campaign(folder)
    return content_of(folder.path)


@contextmanager
def dask_cluster(workers):
    """Address of a scheduler with worker processes, by TCP on this computer."""
    from distributed import LocalCluster

    where = {"host": "127.0.0.1", "dashboard_address": None, "worker_dashboard_address": None}
    with LocalCluster(workers, threads_per_worker=1, processes=True, protocol="tcp", **where) as cluster:
        yield cluster.scheduler_address


@needs_dask
@pytest.mark.slow
def test_dask_workers_write_the_same_bytes(runs, whole, tmp_path):
    folder = planned(tmp_path / "out", runs)
    with dask_cluster(2) as address:
        assert address.startswith("tcp://127.0.0.1:")
        assert run_campaign(folder, DaskWorkers(address)).made == 6
        assert run_campaign(folder, DaskWorkers(address)).kept == 6
    merge_campaign(folder)
    assert content_of(folder.path) == whole


@needs_submitit
@pytest.mark.slow
def test_jobs_of_submitit_write_the_same_bytes(runs, whole, tmp_path):
    folder = planned(tmp_path / "out", runs)
    assert run_campaign(folder, SlurmArrays(tmp_path / "slurm", 2, cluster="local")).made == 6
    merge_campaign(folder)
    assert content_of(folder.path) == whole


@needs_dask
def test_a_scheduler_that_is_not_there_is_one_sentence(runs, tmp_path, monkeypatch):
    monkeypatch.setattr("rtpiv.analysis.campaign.engines.CONNECT_S", 0.3)
    folder = planned(tmp_path / "out", runs)
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(RunUsageError, match="no Dask scheduler answers there"):
            run_campaign(folder, DaskWorkers(address))


class Processes:
    """In place of submitit's local executor: what is submitted runs until it is ended."""

    def __init__(self):
        self.running, self.most, self.begun = [], 0, 0

    @contextmanager
    def batch(self):
        yield

    def submit(self, function, *arguments):
        job = Process(self, function, arguments)
        self.running.append(job)
        self.begun += 1
        self.most = max(self.most, len(self.running))
        return job


class Process:
    """Asked three times, it has ended."""

    def __init__(self, processes, function, arguments):
        self.processes, self.function, self.arguments, self.asked = processes, function, arguments, 0

    def done(self):
        self.asked += 1
        if self.asked == 3:
            self.processes.running.remove(self)
        return self.asked >= 3

    def result(self):
        return self.function(*self.arguments)


@pytest.mark.parametrize("slots", [1, 3])
def test_no_more_jobs_run_on_this_computer_than_it_was_told(monkeypatch, slots):
    monkeypatch.setattr(engines, "GATHER_S", 0.01)
    processes = Processes()
    with engines._Arrays(processes, slots) as executor:
        futures = [executor.submit(abs, -number) for number in range(7)]
        assert [future.result(timeout=30.0) for future in futures] == list(range(7))
    assert (processes.begun, processes.most) == (7, slots)


@needs_submitit
def test_a_computer_without_slurm_is_one_sentence(runs, tmp_path):
    folder = planned(tmp_path / "out", runs)
    for options, cluster in (({}, "slurm"), ({"nonsense": 1}, "local")):
        with pytest.raises(RunUsageError, match="Slurm does not take this"):
            run_campaign(folder, SlurmArrays(tmp_path / "slurm", 2, options, cluster))


@pytest.mark.parametrize(
    ("library", "engine"),
    [
        ("distributed", lambda path: DaskWorkers("tcp://127.0.0.1:9")),
        ("submitit", lambda path: SlurmArrays(path, 1)),
    ],
)
def test_an_engine_that_is_not_installed_is_one_sentence(runs, tmp_path, monkeypatch, library, engine):
    monkeypatch.setitem(sys.modules, library, None)
    folder = planned(tmp_path / "out", runs)
    with pytest.raises(RunUsageError, match=r"install rtpiv\[cluster\]"):
        run_campaign(folder, engine(tmp_path / "slurm"))


ELSEWHERE = """
import os, sys
from pathlib import Path
from rtpiv.analysis.campaign.campaign_folder import CampaignFolder
from rtpiv.analysis.campaign.campaign_plan import planned_runs
from rtpiv.analysis.campaign.chunk_task import ChunkTask
from rtpiv.analysis.campaign.worker_setup import carry_out_elsewhere
folder, kernels = Path(sys.argv[1]), Path(sys.argv[2])
run = next(planned_runs(CampaignFolder(folder)))
run.given.still()
job = run.jobs[0]
found = carry_out_elsewhere(kernels, ChunkTask("one", job, folder / "lease.json"))
place = Path(os.environ["RTPIV_CACHE"])
print(found.what, place, sum(1 for file in place.rglob("*.nb*")), os.environ["OMP_NUM_THREADS"])
"""


def test_a_worker_elsewhere_compiles_nothing_and_leaves_nothing(runs, whole, tmp_path):
    """It unpacks what the client has compiled, into a folder of its own that goes with it."""
    count = pack_kernels(tmp_path / "kernels.zip")
    with zipfile.ZipFile(tmp_path / "kernels.zip") as archive:
        names = archive.namelist()
    assert len(names) == count > 20
    assert all(name.startswith("rtpiv/") and name.endswith((".nbi", ".nbc")) for name in names)
    folder = planned(tmp_path / "out", runs)
    command = [sys.executable, "-c", ELSEWHERE, folder.path, tmp_path / "kernels.zip"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert (said[0], int(said[2]), said[3]) == ("made", count, "1")
    assert not Path(said[1]).exists()


@pytest.mark.parametrize("content", [None, b"PK", b""])
def test_a_worker_without_packed_kernels_compiles_into_a_folder_of_its_own(tmp_path, monkeypatch, content):
    monkeypatch.setattr("os.environ", dict(os.environ))
    if content is not None:
        (tmp_path / "kernels.zip").write_bytes(content)
    _made_ready.cache_clear()
    _made_ready(tmp_path / "kernels.zip")
    place = Path(os.environ["RTPIV_CACHE"])
    assert place.is_dir()
    assert not list(place.iterdir())
    shutil.rmtree(place)
