"""Three parts installed alone, each far from the checkout: the program of its README does what it says."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.wheel.build import ROOT, build_wheel

SAYS = {
    "piv": r"(100|9\d)% valid, u = 3\.(39|40)\d \+- 0\.00\d px",
    "tracer": r"\d+% of the pixels see the plane, by the branches \(\(\), \('ball',\)\)",
    "stages": r"42\.000\d mm read back, 42\.0\d+ mm in truth|42\.000\d mm read back, 41\.99\d+ mm in truth",
}
MOST_LINES = 13_550  # the tracer has 13 510 with light sheets that are refused where nothing is seen (ADR 91)


@pytest.mark.parametrize("part", SAYS)
def test_a_part_alone_does_what_its_readme_says(part, tmp_path):
    place, here = tmp_path / "place", tmp_path / "here"
    wheel = build_wheel(tmp_path, ROOT / part)
    zipfile.ZipFile(wheel).extractall(place)
    here.mkdir()
    assert {path.name for path in place.iterdir() if path.is_dir()} <= {part, "ground", "sim"} | {
        path.name for path in place.glob("*.dist-info")
    }
    text = (ROOT / part / "README.md").read_text(encoding="utf-8")
    program = here / "program.py"
    program.write_text(re.search(r"```python\n(.*?)```", text, re.S)[1])
    # Dependencies come from the environment of the tests; the checkout itself must not be seen.
    blind = f"import sys; sys.path[:] = [{str(place)!r}] + [p for p in sys.path if p != {str(ROOT)!r}]"
    code = f"{blind}; import {part}, runpy; print({part}.__file__); runpy.run_path('program.py')"
    ran = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=here,
        env=os.environ | {"PYTHONPATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith(str(place))
    assert re.search(SAYS[part], ran.stdout), ran.stdout
    assert sum(len(path.read_text().splitlines()) for path in (ROOT / part).rglob("*.py")) < MOST_LINES


def test_the_parts_have_the_version_of_the_whole():
    said = {
        re.search(r'^version = "(.*)"', (ROOT / part / "pyproject.toml").read_text(), re.M)[1] for part in SAYS
    }
    assert said == {re.search(r'^version = "(.*)"', Path(ROOT / "pyproject.toml").read_text(), re.M)[1]}
