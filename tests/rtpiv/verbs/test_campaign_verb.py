"""`rtpiv campaign`: planned, run, looked at and merged by its words; mistakes are one sentence with its code."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rtpiv.analysis.series import series_plan
from rtpiv.analysis.series.series_folder import marker_path
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.command_line.cli import DEVICE, DONE, USAGE, main
from rtpiv.verbs import campaign
from tests.loops import loop_over
from tests.rtpiv.analysis.campaign.small_campaign import two_runs
from tests.rtpiv.analysis.series.small_series import SCENE, flow_run

SMALL = ("--first-window", "32", "--final-window", "16", "--chunk", "4")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return [str(run) for run in two_runs(tmp_path_factory.mktemp("runs"))]


def test_a_campaign_by_its_words(runs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(campaign, "worker_processes", ThreadPoolExecutor)
    out = ("-o", str(tmp_path / "out"))
    assert main(["campaign", "plan", *runs, *out, *SMALL]) == DONE
    assert "GB to read" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    assert main(["campaign", "run", *runs, *out, *SMALL, "--workers", "1"]) == DONE
    said = capsys.readouterr()
    assert "4 chunks made, 0 were there" in said.out
    assert "11/11" in said.err
    assert main(["campaign", "status", *out]) == DONE
    assert main(["campaign", "merge", *out]) == DONE
    assert "11 pairs in the mean, 0 left out" in capsys.readouterr().out
    path = chunk_path(tmp_path / "out" / "runs" / "two", 1)
    marker_path(path).unlink()
    path.with_suffix(".json").mkdir()  # a marker that cannot be written
    for action in ("status", "merge"):
        assert main(["campaign", action, *out]) == DEVICE
        assert "1 chunk is missing" in capsys.readouterr().err
    assert main(["campaign", "run", *out]) == DEVICE
    assert str(path.with_suffix(".json")) in capsys.readouterr().err.replace("\n", "")
    path.with_suffix(".json").rmdir()
    assert main(["campaign", "run", *runs, *out, *SMALL]) == DONE  # plans and runs
    assert "1 chunk made, 3 were there" in capsys.readouterr().out


def state_of(folder):
    """Bytes and time of every file below a folder."""
    return {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.rglob("*") if file.is_file()}


@pytest.fixture(scope="module")
def finished(runs, tmp_path_factory):
    """A campaign with all its chunks, merged."""
    out = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "worker_processes", ThreadPoolExecutor)
        assert main(["campaign", "run", *runs, *SMALL, "-o", str(out)]) == DONE
        assert main(["campaign", "merge", "-o", str(out)]) == DONE
    return out


@pytest.mark.slow
def test_a_question_writes_nothing(runs, finished, tmp_path, monkeypatch, capsys):
    before, run_before = state_of(finished), state_of(Path(runs[0]))
    monkeypatch.chdir(tmp_path)
    assert main(["campaign", "plan", *runs, *SMALL, "-o", str(finished)]) == DONE
    assert main(["campaign", "plan", *runs, *SMALL]) == DONE
    assert (state_of(finished), state_of(Path(runs[0]))) == (before, run_before)
    assert not list(tmp_path.iterdir())
    assert "made again" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("action", "changed", "said"),
    [
        ("plan", ("--chunk", "8"), "chunk_pairs 4 there, 8 now"),
        ("plan", (), "chunk_pairs 4 there, 128 now"),
        ("run", ("--final-window", "32"), "windows_px (32, 16, 16, 16) there, (32, 32, 32, 32) now"),
        ("run", ("--prepare", "none"), "prepare sliding-minimum there, none now"),
        ("run", ("--scene", "OTHER"), "another scene"),
        ("plan", ("ONE RUN",), "two: left out"),
        ("run", ("SAME NAME",), "other frames"),
    ],
)
def test_another_recipe_in_a_used_folder_is_refused(
    runs, finished, tmp_path, monkeypatch, capsys, action, changed, said
):
    monkeypatch.setattr(campaign, "worker_processes", ThreadPoolExecutor)
    before, named = state_of(finished), list(runs)
    (tmp_path / "scene.yaml").write_text(SCENE.replace("500.0]", "501.0]"))
    words = [str(tmp_path / "scene.yaml") if word == "OTHER" else word for word in changed]
    match changed:
        case ("ONE RUN",):
            words, named = [], named[:1]
        case ("SAME NAME",):
            words = []
            named[1] = str(flow_run(tmp_path / "x", 5, shift=lambda n: (1.0, 1.0)).rename(tmp_path / "two"))
        case ():
            words = ["--first-window", "32", "--final-window", "16"]
    usual = () if changed == () else SMALL
    assert main(["campaign", action, *named, *usual, *words, "-o", str(finished)]) == USAGE
    error = " ".join(capsys.readouterr().err.split())
    assert said in error
    assert "choose another folder" in error
    assert state_of(finished) == before


def test_other_versions_are_refused_too(finished, monkeypatch, capsys):
    """Nobody names a run again after an upgrade: without a word all chunks would be made anew."""
    before = state_of(finished)
    monkeypatch.setattr(series_plan, "version", lambda name: "99.0")
    assert main(["campaign", "run", "-o", str(finished)]) == USAGE
    assert "numpy" in capsys.readouterr().err
    assert {k: v for k, v in state_of(finished).items() if k.name != ".lock"} == {
        k: v for k, v in before.items() if k.name != ".lock"
    }


@pytest.mark.slow
def test_a_run_is_added_and_a_longer_one_is_said(tmp_path, monkeypatch, capsys):
    """Of a run with more pairs chunks are made again, as they share what stands still in all; the plan says so."""
    monkeypatch.setattr(campaign, "worker_processes", ThreadPoolExecutor)
    out, runs = ("-o", str(tmp_path / "out")), [str(tmp_path / "one"), str(tmp_path / "two")]
    flow_run(tmp_path / "x", 3).rename(runs[0])
    flow_run(tmp_path / "y", 3).rename(runs[1])
    none = ("--prepare", "none", *SMALL[:-1], "2")
    assert main(["campaign", "run", runs[0], *out, *none]) == DONE
    assert main(["campaign", "merge", *out]) == DONE
    shutil.rmtree(runs[0])
    flow_run(tmp_path / "z", 6).rename(runs[0])
    capsys.readouterr()
    assert main(["campaign", "plan", *runs, *out, *none]) == DONE
    said = capsys.readouterr().out
    assert "one: 2 finished chunks are made again" in " ".join(said.split())
    assert (tmp_path / "out" / "runs" / "one" / "mean.nc").exists()
    assert main(["campaign", "run", *runs, *out, *none]) == DONE
    assert "5 chunks made, 0 were there" in capsys.readouterr().out
    assert not (tmp_path / "out" / "runs" / "one" / "mean.nc").exists()  # that of other chunks


@loop_over(
    "words, said",
    [
        (("plan",), "name the runs"),
        (("status", "RUN"), "status takes no runs"),
        (("run", "--final-window", "16"), "belong to runs"),
        (("run", "--scene", "scene.yaml"), "belong to runs"),
        (("run",), "begin with: rtpiv campaign run"),
        (("plan", "RUN", "--chunk", "100"), "2^m pairs"),
        (("plan", "RUN", "RUN"), "named twice"),
        (("plan", "RUN", "--dewarp-order", "3"), "give both"),
        (("plan", "nowhere"), "nowhere"),
        (("plan", "week", "RUN"), "week: is a campaign; give its own folder with -o week"),
        (("plan", "RUN", "--scene", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(runs, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    Path("week").mkdir(exist_ok=True)
    Path("week", "campaign.json").touch()
    words = [runs[0] if word == "RUN" else word for word in words]
    assert main(["campaign", *words, "-o", str(tmp_path / "out")]) == USAGE
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
