"""A finished shift run that tests copy and damage."""

import shutil

import pytest

from daq.runs.run_folder import RunFolder
from tests.daq.whole_run import make_whole_run


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory):
    """Eight frames of two times two displacements over byte protocols, 96 px a side."""
    return make_whole_run(tmp_path_factory.mktemp("whole_run"))


@pytest.fixture
def done_run(whole_run, tmp_path):
    """A copy of it."""
    return RunFolder(shutil.copytree(whole_run.path, tmp_path / "run"))


@pytest.fixture
def open_run(done_run):
    """A copy that was killed right before its end was written."""
    (done_run.path / "done.json").unlink()
    return done_run
