"""The folder for results is tried before work starts, and left as it was."""

import errno
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.errors import DiskError, RunUsageError
from ground import file_lock
from ground.file_lock import folder_held
from rtpiv.analysis.recipe import CorrectionRecipe
from rtpiv.command_line.cli import USAGE, main
from rtpiv.verbs import results
from rtpiv.verbs.calibrate import calibrate
from rtpiv.verbs.correct import correct
from rtpiv.verbs.evaluate import evaluate
from rtpiv.verbs.results import require_folder, results_in
from rtpiv.verbs.trace import trace
from tests.loops import loop_over
from tracer.scene.scene_file import load_scene


def test_a_folder_that_can_be_is_not_made_yet(tmp_path):
    wanted = tmp_path / "a" / "b"
    assert require_folder(str(wanted)) == wanted
    assert list(tmp_path.iterdir()) == []


@loop_over("below", ["file", "file/deeper", "a\0b", "x" * 300])
def test_a_folder_that_cannot_be(tmp_path, below):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunUsageError, match="cannot hold results; give another folder") as refused:
        require_folder(tmp_path / below)
    assert str(refused.value).count("cannot hold results") == 1
    assert (tmp_path / "file").read_text() == "mine"


@loop_over(
    "number, kind", [(errno.ENOSPC, DiskError), (errno.EROFS, RunUsageError), (errno.EACCES, RunUsageError)]
)
def test_full_read_only_and_forbidden(tmp_path, monkeypatch, number, kind):
    def refuse(dir):
        raise OSError(number, os.strerror(number), str(dir))

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(kind, match=os.strerror(number).lower()):
        results.require_folder(tmp_path / "out")


@loop_over(
    "words",
    [
        ["demo", "-o"],
        ["setup", "schema", "-o"],
        ["setup", "examples"],
        ["init", "--yes"],
        ["mean", "--join", "a", "b", "-o"],
    ],
)
def test_verbs_say_so_before_they_work(tmp_path, words, capsys):
    (tmp_path / "file").write_text("mine")
    assert main([*words, str(tmp_path / "file" / "out")]) == USAGE
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "file" in said


def test_results_that_were_given_no_folder_are_never_written_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert chosen(None) == Path("trace")
    assert not Path("trace").exists()  # nothing was put there
    Path("trace").mkdir()
    assert chosen(None) == Path("trace")  # nothing lies in it
    assert Path("trace").is_dir()
    with folder_held(Path("trace")):
        assert chosen(None) == Path("trace-2")
    Path("trace", "plane.png").touch()
    assert chosen(None) == Path("trace-2")
    Path("trace-2").touch()  # a file of that name
    assert chosen(None) == Path("trace-3")
    assert chosen("trace") == Path("trace")  # who names it means it
    assert chosen(None, lambda path: path.name == "trace") == Path("trace")


def chosen(out, goes_on=lambda path: False):
    with results_in(out, "trace", goes_on) as folder:
        return folder


def test_a_call_that_is_made_by_another_has_the_folder_too_and_takes_none_away(tmp_path):
    with results_in(tmp_path / "a" / "b") as out:
        with results_in(out), pytest.raises(BlockingIOError), folder_held(out):
            pass
        assert out.is_dir()
    assert not (tmp_path / "a").exists()  # as nothing was put there


def test_a_folder_that_is_taken_away_while_it_is_opened_is_not_held(tmp_path, monkeypatch):
    def removed(file):
        (tmp_path / "out").rmdir()

    (tmp_path / "out").mkdir()
    monkeypatch.setattr(file_lock, "hold", removed)
    with pytest.raises(BlockingIOError), folder_held(tmp_path / "out"):
        pass
    monkeypatch.undo()
    with pytest.raises(BlockingIOError), folder_held(tmp_path / "out"):
        pass


SCENE = """camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 20.0, material: BK7}]
"""


def test_a_scene_goes_where_its_file_goes_and_two_calls_keep_both_results(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("scene.yaml").write_text(SCENE)
    scene = load_scene("scene.yaml")
    frame = np.random.default_rng(1).integers(0, 4000, (96, 96)).astype(np.uint16)
    tifffile.imwrite("a.tif", frame)
    by_file = correct("a.tif", "scene.yaml", pictures=False)
    by_scene = correct("a.tif", scene, pictures=False)
    assert (by_file.frames[0].parent, by_scene.frames[0].parent) == (Path("corrected"), Path("corrected-2"))
    np.testing.assert_array_equal(tifffile.imread(by_file.frames[0]), tifffile.imread(by_scene.frames[0]))
    assert trace(scene, pictures=False).share == trace("scene.yaml", pictures=False).share
    with pytest.raises(RunUsageError, match="give the scene's file: the fit beside it"):
        correct("a.tif", scene, recipe=CorrectionRecipe(sigma_limit_px=0.1))
    for verb in (lambda: evaluate(["a.tif", "a.tif"], scene=scene), lambda: calibrate(".", scene)):
        with pytest.raises(RunUsageError, match="give the scene's file"):
            verb()


def test_a_run_in_place_of_its_frames_is_refused_with_what_to_give(tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    (tmp_path / "scene.yaml").write_text("bodies: []\n")
    assert main(["correct", str(tmp_path / "run"), "--scene", str(tmp_path / "scene.yaml")]) == USAGE
    said = " ".join(capsys.readouterr().err.split())
    assert "run: is a run; give some of its frames, as in" in said
    assert "*.tif, or evaluate the run" in said
