"""A finished shift run that tests copy and damage."""

import shutil

import pytest

from daq.acquisition.runner.runner import Runner
from daq.acquisition.runner.session import Request, begin
from daq.acquisition.runs.run_folder import RunFolder
from tests.daq.small_bench import FILES_CAMERA, SHIFT, files_bench, load, write_frames


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory):
    """Eight frames of two times two displacements over byte protocols, 96 px a side."""
    place = tmp_path_factory.mktemp("whole_run")
    files = write_frames(place / "frames_in", 40)
    bench, plan = load(place, SHIFT, camera=FILES_CAMERA)
    folder = begin(Request(bench.path, plan.path, correct=False), bench, plan, place / "runs")
    with files_bench(bench, files) as hardware:
        Runner(hardware, folder, plan.steps).run()
    return folder


@pytest.fixture
def done_run(whole_run, tmp_path):
    """A copy of it."""
    return RunFolder(shutil.copytree(whole_run.path, tmp_path / "run"))


@pytest.fixture
def open_run(done_run):
    """A copy that was killed right before its end was written."""
    (done_run.path / "done.json").unlink()
    return done_run
