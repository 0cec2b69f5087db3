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
    "test_laser.py",
    ".github/workflows/bench.yml",
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
    for name in ("look.py", "test_lab.py", "test_laser.py"):
        compile(found[name], name, "exec")
    assert found["test_lab.py"].count("\ndef test_") == 3
    steps = yaml.safe_load(found[".github/workflows/bench.yml"])["jobs"]["rehearse"]["steps"]
    assert steps[-1]["run"] == "python -m pytest"


@pytest.mark.slow
def test_a_lab_made_by_the_page_tests_itself_twice_with_the_same_bytes(tmp_path):
    lab = tmp_path / "lab"
    write_lab(lab)
    seen = []
    for name in ("one", "two"):
        ran, processor_s = run_tests(lab, f"--basetemp={tmp_path / name}")
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert "5 passed" in ran.stdout
        assert processor_s < 60.0
        seen.append(world(tmp_path / name))
    assert len(seen[0][1]) == 8
    assert seen[0] == seen[1]
