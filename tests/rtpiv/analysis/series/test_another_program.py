"""Vectors of two programs never meet: an updated checkout has the same version, and other numbers."""

import pickle
import re

import pytest

from piv.errors import SeriesError
from rtpiv.analysis.series.chunk import evaluate_chunk
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_plan import chunk_path, jobs_of
from tests.rtpiv.analysis.series.small_series import flow_run, given_of, method_of, series_of

PAIRS, CHUNK = 3, 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("flow")


@pytest.fixture(scope="module")
def given(folder):
    return given_of(flow_run(folder, PAIRS))


@pytest.fixture
def updated(monkeypatch):
    """Replace the program, as an update of its checkout does."""
    return lambda: monkeypatch.setattr(
        "rtpiv.analysis.series.series_plan.code_digest", lambda *parts: "of an update"
    )


def test_finished_chunks_of_an_older_program_are_made_again(folder, given, tmp_path, updated, capsys):
    for _ in range(2):
        run_series(series_of(tmp_path, given, method_of(folder)), 1, CHUNK)
    assert "made again" not in capsys.readouterr().out
    times = {file: file.stat().st_mtime_ns for file in (tmp_path / "chunks").iterdir()}
    updated()
    run_series(series_of(tmp_path, given, method_of(folder)), 1, CHUNK)
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(
        "2 finished chunks will be made again: code of rtpiv [0-9a-f]{16} there, of an update now", said
    )
    assert all(file.stat().st_mtime_ns > before for file, before in times.items())


@pytest.mark.parametrize("knew", [True, False], ids=["", "planned by one that did not say it"])
def test_a_worker_of_another_program_makes_no_chunk(folder, given, tmp_path, updated, knew):
    """Planned here, carried out after somebody has replaced the program, or on a computer that has another."""
    [job, *_] = jobs_of(tmp_path, given.pairs, method_of(folder), None, CHUNK)
    assert job.key
    if not knew:
        del job.method.recipe["versions"]["code of rtpiv"]
    updated()
    planned = "[0-9a-f]{16}" if knew else "unknown"
    with pytest.raises(SeriesError, match=rf"code of rtpiv {planned} where it was planned, of an update here"):
        evaluate_chunk(pickle.loads(pickle.dumps(job)))
    assert not chunk_path(tmp_path, 0).exists()
