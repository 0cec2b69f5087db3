"""docs/rehearse.md: a lab made in an empty folder by that page alone tests itself, twice with the same bytes."""

import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from daq.runs.raw_frame import read_raw
from rtpiv.command_line.cli import main
from sim.event_log import FILE

PAGE = Path(__file__).resolve().parents[2] / "docs" / "rehearse.md"
FILES = {
    "plan-too-far.yaml",
    "faults.yaml",
    "look.py",
    "test_lab.py",
    "test_words.py",
    "test_laser.py",
    ".github/workflows/bench.yml",
}
BROKEN = {  # what a test guards, broken -> the test that must tell it
    "the script goes elsewhere": ("look.py", "(0.0, -10.0, -20.0)", "(0.0, -10.0, -15.0)", "looks_where"),
    "the script forgets to move": ("look.py", "bench.move(target_z=z_mm)", "z_mm", "looks_where"),
    "the limits are wide": ("bench.yaml", "limits_mm: [-70.0, 25.0]", "limits_mm: [-95.0, 25.0]", "limits_refuse"),
    "the plan is harmless": ("plan-too-far.yaml", "-90.0", "-10.0", "limits_refuse"),
    "the cable stays in": ("faults.yaml", "what: unplug", "what: doubled", "cable"),
    "the cable comes out later": ("faults.yaml", "step: 7", "step: 8", "cable"),
    "the script says something else": ("look.py", "(0.0, -10.0, -20.0)", "(0.0, -10.0, -15.0)", "is_told_what"),
    "the key STOP is RUN": ("test_laser.py", '"what": "stop"', '"what": "run"', "stop_at_the_box"),
    "resume does not home": ("test_lab.py", "resume(run, home=True)", "resume(run)", "cable"),
}


def files():
    """Files of the page by name, as they stand there."""
    blocks = re.findall(r"^```\w+\n# (\S+)\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return dict(blocks)


def write_lab(folder):
    """What somebody has who follows the page."""
    command = re.search(r"^    rtpiv (init .*)$", PAGE.read_text("utf-8"), re.MULTILINE)[1]
    assert main([*command.replace("init .", f"init {folder}").split()]) == 0
    for name, text in files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


AT_THE_BENCH = """
import rtpiv
from sim.rehearsed import Rehearsed
from look import look
with Rehearsed("bench.yaml") as bench:
    look(bench)
"""


def record(lab):
    """What was said at the bench, of which a simulated one takes the place here; the page's file of the target."""
    environment = os.environ | {"PYTHONPATH": str(PAGE.parents[1]), "RTPIV_RECORD": "said"}
    subprocess.run([sys.executable, "-c", AT_THE_BENCH], cwd=lab, env=environment, check=True)
    (said,) = (lab / "said").glob("sim-target-*.txt")
    said.rename(lab / "said" / "target.txt")


def run_tests(lab, *words):
    """Run the lab's tests as its owner would; the process, and its seconds of processor."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "RTPIV_WITNESS"))}
    environment = clean | {"PYTHONPATH": str(PAGE.parents[1])}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "rtpiv_pytest", "-p", "no:cacheprovider", *words],
        cwd=lab, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return ran, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def world(place):
    """What happened in the run of a place, and the pixels of its frames."""
    run = next(place.rglob(FILE)).parent
    return (run / FILE).read_bytes(), [read_raw(path)[0].tobytes() for path in sorted(run.glob("frames/*.tif"))]


def test_the_page_has_the_files_and_its_workflow_runs_the_tests():
    found = files()
    assert set(found) == FILES
    for name in ("look.py", "test_lab.py", "test_words.py", "test_laser.py"):
        compile(found[name], name, "exec")
    assert found["test_lab.py"].count("\ndef test_") == 3
    steps = yaml.safe_load(found[".github/workflows/bench.yml"])["jobs"]["rehearse"]["steps"]
    assert steps[-1]["run"] == "python -m pytest"


@pytest.mark.slow
def test_a_lab_made_by_the_page_tests_itself_twice_with_the_same_bytes(tmp_path):
    lab = tmp_path / "lab"
    write_lab(lab)
    record(lab)
    seen = []
    for name in ("one", "two"):
        ran, processor_s = run_tests(lab, f"--basetemp={tmp_path / name}")
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert "6 passed" in ran.stdout
        assert processor_s < 60.0
        seen.append(world(tmp_path / name))
    assert len(seen[0][1]) == 8
    assert seen[0] == seen[1]


@pytest.mark.slow
@pytest.mark.parametrize("broken", BROKEN)
def test_each_test_of_the_page_fails_when_what_it_guards_is_broken(tmp_path, broken):
    name, old, new, told = BROKEN[broken]
    write_lab(tmp_path)
    if told == "is_told_what":
        record(tmp_path)
    text = (tmp_path / name).read_text()
    assert text.count(old) == 1
    (tmp_path / name).write_text(text.replace(old, new))
    ran, _ = run_tests(tmp_path, "-k", told, "--basetemp", str(tmp_path / "pytest"))
    assert ran.returncode == 1, ran.stdout + ran.stderr
    assert "1 failed" in ran.stdout
