"""The wheel in an empty environment, far from the checkout: a user's whole way, from --version to the report.

Dependencies come from the environment of the tests, by links, so no index is asked; at first without the extra.
"""

import json
import os
import subprocess
import sysconfig
import venv
from pathlib import Path

import numba
import pytest

from tests.wheel.build import build_wheel

EXTRA = ("harvesters", "genicam")
# An editable install leaves a folder daq/examples: linked, the wheel would be installed into it.
OWN = ("rtpiv", "_rtpiv", "_editable", "__editable__", "pip", "mpmath", "daq")
SCENE = """
camera: {f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 110.0, sensor_px: [201, 201]}
bodies: [{name: near, kind: sphere, centre_mm: [0.0, 0.0, 25.0], radius_mm: 25.0, material: N-BK7}]
"""


class Installed:
    """A program in an environment of its own, started in a user's folder that holds files with our names."""

    def __init__(self, place: Path, here: Path) -> None:
        self.place, self.here = place, here
        self.site = Path(sysconfig.get_path("purelib", "venv", {"base": str(place), "platbase": str(place)}))
        here.mkdir()
        for name in ("sim.py", "daq.py", "tracer.py", "benchmarks.py", "stages.py"):
            (here / name).write_text("raise SystemExit('this file hides the program')\n")

    def link(self, wanted: bool) -> None:
        """Link what the tests' environment has, but for this project: all but the extra, or the extra."""
        for path in Path(numba.__file__).parents[1].iterdir():
            name = path.name.lower()
            there = (self.site / path.name).exists()
            if name.startswith(OWN) or path.suffix == ".pth" or there or name.startswith(EXTRA) != wanted:
                continue
            (self.site / path.name).symlink_to(path)

    def __call__(self, *words: str | Path, fails: bool = False) -> str:
        clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        command = [str(word) for word in (self.place / "bin" / words[0], *words[1:])]
        ran = subprocess.run(command, cwd=self.here, env=clean, capture_output=True, text=True, check=False)
        assert (ran.returncode != 0) == fails, ran.stdout + ran.stderr
        return ran.stdout + ran.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=True)
    program = Installed(place, tmp_path_factory.mktemp("user") / "here")
    program.link(False)
    wheel = build_wheel(tmp_path_factory.mktemp("wheel"))
    program("python", "-m", "pip", "install", "--no-deps", "--no-index", "--quiet", wheel)
    return program


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_user_s_whole_way(installed):
    here, files = installed.here, installed.site / "daq" / "examples"
    assert installed("rtpiv", "--version").startswith("rtpiv ")

    said = installed("rtpiv", "demo", fails=True)
    assert "rtpiv[camera]" in said
    assert len(said.splitlines()) == 1
    assert not (here / "demo").exists()
    bench = ("--bench", files / "bench-sim.yaml", "--simulate", "--home")
    assert "rtpiv[camera]" in installed("rtpiv", "acquire", files / "plan-target.yaml", *bench, fails=True)
    installed("rtpiv", "acquire", files / "plan-target.yaml", *bench[:2], "--dry-run")

    (here / "scene.yaml").write_text(SCENE)
    said = installed("rtpiv", "benchmark", "scene.yaml", "--rounds", "1")
    assert "mpmath is not installed" in said
    assert "drjit is left out" in said
    assert json.loads((here / "benchmark" / "benchmark.json").read_text())["scenes"]
    installed("rtpiv", "trace", files / "pyramid_500.yaml")

    installed.link(True)
    said = installed("rtpiv", "doctor", "--bench", files / "bench-sim.yaml")
    assert "hides ours" not in said
    installed("rtpiv", "demo")
    page = here / "demo" / "report" / "report.html"
    assert "<style>" in page.read_text(encoding="utf-8")
    installed("python", "-P", files / "tour.py", "tour")
    assert (here / "tour" / "tour.png").exists()
