"""Two calls that put results into one folder at once: the second is refused."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.runs.run_folder import RunFolder
from ground.file_lock import folder_held
from rtpiv.command_line.cli import USAGE, main
from tests.daq.small_run import about_run, planned
from tests.loops import loop_over

SCENE = """camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 20.0, material: BK7}]
"""
LAB = ["--lenses-mm", "25", "--distances-mm", "500", "--balls-mm", "40", "--pixel-pitch-um", "50"]
WORDS = {  # of a call: what the second is refused before it reads anything
    "correct": ["frame.tif", "--scene", "one.yaml"],
    "trace": ["one.yaml"],
    "export": ["one.yaml", "--to", "tiff"],
    "setup target": ["--kind", "dots"],
    "compare": [*LAB, "--sensor-px", "96", "96"],
    "init": ["--yes", "--balls", "1"],
    "calibrate": [".", "--scene", "one.yaml"],
    "evaluate": ["frame.tif", "frame2.tif", "--mm-per-px", "0.1"],
    "sheet": ["frame.tif", "frame2.tif", "--scene", "one.yaml"],
    "report": ["report_of"],
    "calibrate --join": ["a", "b"],
    "mean --join": ["a", "b"],
    "mean --line": ["0", "0", "1", "1", "series"],
    "focus": ["run"],
    "setup examples": [],
    "demo": [],
    "mean": ["."],
    "campaign": ["run", "run"],
}
FIRST = {"init", "setup examples"}  # verbs that take their folder without -o


def called(verb, words, out):
    return [*verb.split(), str(out), *words] if verb in FIRST else [*verb.split(), *words, "-o", str(out)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("one.yaml").write_text(SCENE)
    for number, name in enumerate(("frame.tif", "frame2.tif", "target_clear.tif")):
        tifffile.imwrite(name, np.random.default_rng(number).integers(0, 4000, (96, 96), np.uint16))
    RunFolder.create(tmp_path, "small", about_run([planned(0)])).path.rename("report_of")
    return tmp_path


@loop_over("verb, words", WORDS.items())
def test_the_second_is_refused_before_it_has_written_anything(folder, verb, words, capsys):
    out = folder / "out"
    out.mkdir(exist_ok=True)
    with folder_held(out):
        if verb == "mean":
            (out / "series.json").write_text("{}")
            assert main(["mean", str(out)]) == USAGE
            (out / "series.json").unlink()
        else:
            assert main(called(verb, words, out)) == USAGE
    assert "another process puts results there; let it finish" in " ".join(capsys.readouterr().err.split())
    assert not list(out.iterdir())
