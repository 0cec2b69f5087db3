"""Frames of other people through correction and evaluation: the vectors of a run with the same frames."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import tifffile
from scipy.io import netcdf_file

from rtpiv.analysis.series.series_mean import mean_of_series
from rtpiv.analysis.series.series_plan import chunk_path
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.verbs import campaign
from tests.rtpiv.analysis.series.small_series import DT_US, SCENE, flow_run

PAIRS = 4
WINDOWS = ("--first-window", "32", "--final-window", "16")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run, its frames once more as numbered files and as a stack, and the vectors of the run."""
    folder = tmp_path_factory.mktemp("recorded")
    run = flow_run(folder, PAIRS)
    stack = [tifffile.imread(path) for path in sorted((run / "frames").iterdir())]
    for number, frame in enumerate(stack):
        tifffile.imwrite(folder / f"B{number // 2:05d}_{'ab'[number % 2]}.tif", frame)
    tifffile.imwrite(folder / "stack.tif", np.stack(stack), photometric="minisblack")
    (folder / "scene.yaml").write_text(SCENE)
    words = ("evaluate", str(run), "-o", str(folder / "run"), *WINDOWS, "--workers", "1", "--no-pictures")
    assert main(words) == DONE
    return folder


def vectors(folder):
    with netcdf_file(chunk_path(folder, 0), mmap=False) as file:
        return {name: np.array(file.variables[name][:]).tobytes() for name in ("u", "v", "sigma_u", "flag")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["B%05d_a.tif", "stack.tif"])
def test_the_vectors_are_those_of_a_run_with_the_same_frames(recorded, tmp_path, name):
    scene, out = ("--scene", str(recorded / "scene.yaml")), ("-o", str(tmp_path / "out"))
    more = (*WINDOWS, "--workers", "1", "--dt-us", str(DT_US), "--no-pictures")
    assert main(["evaluate", str(recorded / name), *scene, *out, *more]) == DONE
    assert vectors(tmp_path / "out") == vectors(recorded / "run")
    assert mean_of_series(SeriesView(tmp_path / "out")).used == PAIRS


@pytest.mark.slow
def test_a_folder_is_evaluated_and_a_pattern_averaged(recorded, tmp_path, monkeypatch, capsys):
    """Mean of the folder, of its pattern and of the run that recorded these frames; by ensembles too."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "day1").mkdir()
    for path in recorded.glob("B*.tif"):
        (tmp_path / "day1" / path.name).write_bytes(path.read_bytes())
    more = ("--scene", str(recorded / "scene.yaml"), "--dt-us", str(DT_US), *WINDOWS, "--workers", "1")
    assert main(["evaluate", "day1", *more, "--no-pictures"]) == DONE
    assert vectors(tmp_path / "evaluation") == vectors(recorded / "run")
    assert main(["evaluate", "day1", *more, "--no-pictures"]) == DONE  # goes on in its folder
    assert f"{PAIRS} of them had been evaluated before" in capsys.readouterr().out
    assert main(["mean", "day1/B%05d_a.tif", *more, "-o", "averaged", "--ensemble", "16"]) == DONE
    assert f"mean of {PAIRS} pairs" in capsys.readouterr().out
    assert vectors(tmp_path / "averaged") == vectors(recorded / "run")
    for name in ("mean.nc", "mean_ensemble.nc", "mean.html"):
        assert (tmp_path / "averaged" / name).is_file()


@pytest.mark.slow
def test_a_frame_that_changes_is_read_again_and_its_chunk_made_anew(recorded, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(campaign, "worker_processes", ThreadPoolExecutor)
    for path in recorded.glob("B*.tif"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    scene, out = ("--scene", str(recorded / "scene.yaml")), tmp_path / "out"
    words = ["campaign", "run", str(tmp_path / "B%05d_a.tif"), *scene, "-o", str(out), *WINDOWS]
    words += ["--chunk", "2", "--dt-us", str(DT_US), "--prepare", "none"]
    assert main(words) == DONE
    lines = (out / "runs" / "B-05d_a.tif" / "checksums.jsonl").read_text().splitlines()
    assert len(lines) == 2 * PAIRS
    changed = tmp_path / "B00003_b.tif"
    tifffile.imwrite(changed, tifffile.imread(changed) + np.uint16(3))
    (tmp_path / "B00000_a.tif").write_bytes(b"II*\0")
    assert main(words) == DONE
    assert "2 chunks made, 0 were there" in capsys.readouterr().out
    again = (out / "runs" / "B-05d_a.tif" / "checksums.jsonl").read_text().splitlines()
    assert json.loads(again[0])[3] == ""
    assert [a == b for a, b in zip(lines, again, strict=True)] == [False] + [True] * 6 + [False]
    assert main(words) == DONE
    assert "0 chunks made, 2 were there" in capsys.readouterr().out


@pytest.mark.usefixtures("no_mean_page")
def test_what_nobody_says_is_asked_for(recorded, tmp_path, capsys):
    frames, out = str(recorded / "stack.tif"), ("-o", str(tmp_path / "out"))
    scene = ("--scene", str(recorded / "scene.yaml"))
    assert main(["campaign", "plan", frames, *out, "--dt-us", "50"]) == USAGE
    assert "give --scene" in capsys.readouterr().err
    assert main(["campaign", "plan", frames, *scene, *out]) == USAGE
    assert "give --dt-us" in capsys.readouterr().err
    assert main(["evaluate", frames, *scene, *out, *WINDOWS, "--workers", "1", "--no-pictures"]) == DONE
    with netcdf_file(chunk_path(tmp_path / "out", 0), mmap=False) as file:
        assert file.variables["u"].units == b"mm"
    capsys.readouterr()
    assert main(["mean", str(tmp_path / "out")]) == DONE
    assert "mean [mm]" in capsys.readouterr().out
