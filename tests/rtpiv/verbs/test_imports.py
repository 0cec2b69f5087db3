"""Who asks for a verb waits for what it runs, and for nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

ROOT = Path(__file__).resolve().parents[3]
VERBS = sorted(path.stem for path in (ROOT / "rtpiv" / "verbs").glob("[a-z]*.py"))
DRAWN = {"matplotlib"}
TRACED = {"numba", "llvmlite"}
SOLVED = {f"scipy.{part}" for part in ("stats", "optimize", "spatial", "interpolate", "ndimage", "io", "sparse")}
BENCHES = {"daq.bench.bench_table", "daq.runner.session", "daq.plans.steps", "stages.stage", "stages.config"}
FITTED = {f"correction.fit.{part}" for part in ("judge.result", "judge.hypotheses", "seen.measurement")}
OTHERS = {"cv2", "sim", "hypothesis", "IPython", "pandas"} | (
    {"coverage"} if "COVERAGE_PROCESS_CONFIG" not in os.environ else set()
)
SMALL = """
camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0]}
bodies: [{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}]
"""


def _errors_of(code: str, *words: str) -> str:
    """Standard error of a process that runs some code."""
    return subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}", *words],
        env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True,
    ).stderr  # fmt: skip


def _loaded(code: str, *words: str) -> set[str]:
    """Modules of a process that has run some code."""
    return set(_errors_of(f"{code}\nprint(*sys.modules, file=sys.stderr)", *words).split())


@pytest.mark.slow
def test_no_verb_imports_what_it_may_not_need():
    assert {"correct", "evaluate", "calibrate", "trace", "report", "acquire"} <= set(VERBS)
    code = "from importlib import import_module; [import_module(f'rtpiv.verbs.{name}') for name in sys.argv[1:]]"
    loaded = _loaded(code, *VERBS)
    assert {f"rtpiv.verbs.{name}" for name in VERBS} <= loaded
    assert (DRAWN | TRACED | SOLVED | OTHERS) & loaded == set()


@pytest.mark.slow
def test_who_looks_at_scenes_or_frames_waits_neither_for_benches_nor_for_fits():
    """None of the four loads what all of them together have not loaded."""
    verbs = {f"rtpiv.verbs.{name}" for name in ("check", "trace", "correct", "evaluate")}
    loaded = _loaded(f"import {', '.join(sorted(verbs))}")
    assert verbs <= loaded
    assert (BENCHES | FITTED) & loaded == set()


def test_help_waits_for_nothing_that_draws():
    code = "from rtpiv.command_line.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    loaded = _loaded(code)
    assert {"multiprocessing", "numpy", "concurrent.futures", "importlib.resources", "tempfile"} & loaded == set()


COMMANDS = (  # in this order, each with less that it must not load than those before
    (["check", "bare.yaml"], DRAWN | TRACED | SOLVED | OTHERS | BENCHES | FITTED),
    (["check", "scene.yaml"], DRAWN | SOLVED | OTHERS | BENCHES | FITTED),
    (["trace", "scene.yaml", "--no-pictures"], DRAWN | SOLVED | OTHERS | FITTED),
    (["correct", "frame.tif", "--scene", "scene.yaml", "--no-pictures"], DRAWN | SOLVED | OTHERS),
)
RUN_ALL = """
from rtpiv.command_line.cli import main
for words in sys.argv[1:]:
    assert main(words.split()) == 0
    print(words, "LOADED", *sys.modules, file=sys.stderr)
"""


def test_a_command_imports_what_it_runs(tmp_path, monkeypatch):
    (tmp_path / "scene.yaml").write_text(SMALL)
    (tmp_path / "bare.yaml").write_text(SMALL.partition("bodies")[0])
    tifffile.imwrite(tmp_path / "frame.tif", np.full((96, 96), 100, np.uint16))
    monkeypatch.chdir(tmp_path)
    said = _errors_of(RUN_ALL, *(" ".join(words) for words, _ in COMMANDS))
    for words, not_needed in COMMANDS:
        (line,) = (line for line in said.splitlines() if line.startswith(f"{' '.join(words)} LOADED"))
        loaded = set(line.split())
        assert f"rtpiv.verbs.{words[0]}" in loaded
        assert not_needed & loaded == set(), words
