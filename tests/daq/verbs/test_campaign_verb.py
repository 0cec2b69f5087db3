"""`rtpiv campaign`: planned, run, looked at and merged by its words; mistakes are one sentence with its code."""

import pytest

from daq.analysis.campaign.engine import LocalProcesses
from daq.analysis.series.marker import marker_path
from daq.analysis.series.series_plan import chunk_path
from daq.cli import DEVICE, DONE, USAGE, main
from tests.daq.analysis.campaign.small_campaign import Threads, two_runs

SMALL = ("--first-window", "32", "--final-window", "16", "--chunk", "4")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return [str(run) for run in two_runs(tmp_path_factory.mktemp("runs"))]


def test_a_campaign_by_its_words(runs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(LocalProcesses, "opened", lambda self: Threads(self.slots).opened())
    out = ("-o", str(tmp_path / "out"))
    assert main(["campaign", "plan", *runs, *out, *SMALL]) == DONE
    assert "GB to read" in capsys.readouterr().out
    for action in ("status", "merge"):
        assert main(["campaign", action, *out]) == DEVICE
        assert "4 chunks are missing" in capsys.readouterr().err
    assert main(["campaign", "run", *out, "--workers", "1"]) == DONE
    said = capsys.readouterr()
    assert "4 chunks made, 0 were there" in said.out
    assert "11/11" in said.err
    assert main(["campaign", "status", *out]) == DONE
    assert main(["campaign", "merge", *out]) == DONE
    assert "11 pairs in the mean, 0 left out" in capsys.readouterr().out
    path = chunk_path(tmp_path / "out" / "runs" / "two", 1)
    marker_path(path).unlink()
    path.with_suffix(".json").mkdir()  # a marker that cannot be written
    assert main(["campaign", "run", *out]) == DEVICE
    said = capsys.readouterr()
    assert "two, chunk 1 failed" in said.out
    assert "1 chunks are missing" in said.err
    path.with_suffix(".json").rmdir()
    assert main(["campaign", "run", *runs, *out, *SMALL]) == DONE  # plans and runs
    assert "1 chunks made, 3 were there" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("plan",), "name the runs"),
        (("status", "RUN"), "status takes no runs"),
        (("run", "--final-window", "16"), "belong to a plan"),
        (("run", "--scene", "scene.yaml"), "belong to a plan"),
        (("run",), "begin with: rtpiv campaign plan"),
        (("plan", "RUN", "--chunk", "100"), "2^m pairs"),
        (("plan", "RUN", "RUN"), "named twice"),
        (("plan", "RUN", "--dewarp-order", "3"), "give both"),
        (("plan", "nowhere"), "nowhere"),
        (("plan", "RUN", "--scene", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(runs, tmp_path, capsys, words, said):
    words = [runs[0] if word == "RUN" else word for word in words]
    assert main(["campaign", *words, "-o", str(tmp_path / "out")]) == USAGE
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
