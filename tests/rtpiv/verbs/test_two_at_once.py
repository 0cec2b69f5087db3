"""Two calls that put results into one folder at once: it holds what one of them made, or the other, never both."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.runs.run_folder import RunFolder
from ground.file_lock import folder_held
from rtpiv.command_line.cli import DONE, USAGE, main
from rtpiv.options.command import commands
from tests.daq.small_run import about_run, planned
from tests.loops import loop_over

SCENE = """camera: {{focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}}
bodies: [{{name: ball, kind: sphere, centre_mm: [{x}, 0.0, 25.0], radius_mm: 20.0, material: BK7}}]
"""
LAB = ["--lenses-mm", "25", "--distances-mm", "500", "--balls-mm", "40", "--pixel-pitch-um", "50"]
WORDS = {  # verb -> one call and another, of other settings, into one folder
    "correct": (["frame.tif", "--scene", "one.yaml"], ["frame.tif", "frame2.tif", "--scene", "other.yaml"]),
    "trace": (["one.yaml"], ["other.yaml"]),
    "export": (["one.yaml", "--to", "tiff"], ["other.yaml", "one.yaml", "--to", "netcdf"]),
    "setup target": (["--kind", "dots"], ["--square-mm", "5", "--paper", "A3"]),
    "compare": ([*LAB, "--sensor-px", "96", "96"], [*LAB, "--sensor-px", "96", "80", "--counts", "3"]),
    "init": (["--yes", "--balls", "1"], ["--yes", "--balls", "3", "--overwrite"]),
}
ALONE = {  # what the second is refused before it reads anything, or has nothing to read
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
CHILD = """import sys, time
from pathlib import Path
from rtpiv.command_line.cli import main
import rtpiv.verbs.{verb}, rtpiv.analysis.pictures.results
Path(sys.argv[1]).touch()
while not Path("go").exists():
    time.sleep(0.001)
sys.exit(main(sys.argv[2:]))
"""


def called(verb, words, out):
    return [*verb.split(), str(out), *words] if verb in FIRST else [*verb.split(), *words, "-o", str(out)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("one.yaml").write_text(SCENE.format(x=0.0))
    Path("other.yaml").write_text(SCENE.format(x=5.0))
    for number, name in enumerate(("frame.tif", "frame2.tif", "target_clear.tif")):
        tifffile.imwrite(name, np.random.default_rng(number).integers(0, 4000, (96, 96), np.uint16))
    RunFolder.create(tmp_path, "small", about_run([planned(0)])).path.rename("report_of")
    return tmp_path


@loop_over("verb", [*WORDS, *ALONE])
def test_the_second_is_refused_before_it_has_written_anything(folder, verb, capsys):
    out = folder / "out"
    out.mkdir(exist_ok=True)
    with folder_held(out):
        words = WORDS[verb][0] if verb in WORDS else ALONE[verb]
        if verb == "mean":
            (out / "series.json").write_text("{}")
            assert main(["mean", str(out)]) == USAGE
            (out / "series.json").unlink()
        else:
            assert main(called(verb, words, out)) == USAGE
    assert "another process puts results there; let it finish" in " ".join(capsys.readouterr().err.split())
    assert not list(out.iterdir())


@pytest.mark.slow
@pytest.mark.draws
@pytest.mark.parametrize("verb", WORDS)
def test_nothing_is_mixed(folder, verb):
    alone = []
    for name, words in zip("ab", WORDS[verb], strict=True):
        assert main(called(verb, words, folder / name)) == DONE
        alone.append(files(folder / name))
    for number in range(3):
        (folder / "go").unlink(missing_ok=True)
        out = folder / f"out{number}"
        program = CHILD.format(verb=commands()[verb])
        both = [
            subprocess.Popen(
                [sys.executable, "-c", program, f"{out}.{name}", *called(verb, words, out)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            for name, words in zip("ab", WORDS[verb], strict=True)
        ]
        while len(list(folder.glob(f"out{number}.*"))) < len(both):
            time.sleep(0.01)
        (folder / "go").touch()
        said = [one.communicate()[1] for one in both]
        codes = [one.returncode for one in both]
        assert set(codes) <= {DONE, USAGE}, said
        assert DONE in codes
        assert not any("Traceback" in each for each in said)
        made = files(out)
        whole = [all(made.get(name) == content for name, content in each.items()) for each in alone]
        done = [w for w, code in zip(whole, codes, strict=True) if code == DONE]
        assert any(done), f"{verb}: {sorted(made)}, {codes}"
        if codes.count(DONE) == 1:
            assert made == alone[codes.index(DONE)]


def files(folder):
    """What lies in a folder, without the place where it lies, which some files name."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file():
            content = path.read_bytes().replace(str(folder).encode(), b"")
            found[str(path.relative_to(folder))] = content
    return found
