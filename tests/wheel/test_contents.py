"""What is in the wheel, and that it runs from there."""

import os
import subprocess
import sys
import zipfile
from importlib.metadata import version

import pytest

from tests.wheel.build import ROOT, build_wheel

PACKAGES = ("rtpiv", "ground", "piv", "tracer", "correction", "stages", "daq", "sim")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build_wheel(tmp_path_factory.mktemp("wheel"))


def test_every_file_that_is_used_and_nothing_else(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for package in PACKAGES:
        there = {str(path.relative_to(ROOT)) for path in (ROOT / package).rglob("*.py")}
        assert there <= names
    assert {f"{package}/__init__.pyi" for package in PACKAGES if package != "ground"} <= names
    assert "rtpiv/analysis/report/page.css" in names
    shown = {path.relative_to(ROOT / "examples") for path in (ROOT / "examples").rglob("*.*")}
    assert {f"rtpiv/examples/{path}" for path in shown if "__pycache__" not in path.parts} <= names
    allowed = {
        *PACKAGES,
        "rtpiv_pytest.py",
        next(name for name in names if name.endswith("/RECORD")).partition("/")[0],
    }
    assert {name.partition("/")[0] for name in names} == allowed
    assert not [name for name in names if "__pycache__" in name or name.startswith("benchmarks")]


def test_it_runs_where_it_lies(wheel, tmp_path):
    """Before all that is installed; the user's folder has a sim.py and a daq.py, which hide nothing."""
    place, here = tmp_path / "place", tmp_path / "here"
    zipfile.ZipFile(wheel).extractall(place)
    here.mkdir()
    for name in ("sim.py", "daq.py", "tracer.py", "benchmarks.py"):
        (here / name).write_text("raise SystemExit('hidden')\n")
    environment = os.environ | {"PYTHONPATH": str(place)}
    code = "from rtpiv.command import main; from rtpiv.example_files import examples; print(examples()); main()"
    ran = subprocess.run(
        [sys.executable, "-P", "-c", code, "--version"],
        cwd=here,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.splitlines() == [str(place / "rtpiv" / "examples"), f"rtpiv {version('rtpiv')}"]
