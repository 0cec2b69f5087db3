"""The wheel in an empty environment, far from the checkout: the first hour of a lab.

Dependencies come from the environment of the tests, by links, so no index is asked.
"""

import os
import re
import subprocess
import sysconfig
import time
import venv
from pathlib import Path

import numba
import pytest

from tests.rtpiv.test_page import script
from tests.wheel.build import build_wheel

# An editable install leaves a folder rtpiv/examples: linked, the wheel would be installed into it.
OWN = ("rtpiv", "_rtpiv", "_editable", "__editable__", "pip", "mpmath")


class Installed:
    """A program in an environment of its own, started in a user's folder that holds files with our names."""

    def __init__(self, place: Path, here: Path) -> None:
        self.place, self.here = place, here
        self.site = Path(sysconfig.get_path("purelib", "venv", {"base": str(place), "platbase": str(place)}))
        here.mkdir()
        for name in ("sim.py", "daq.py", "tracer.py", "benchmarks.py", "stages.py"):
            (here / name).write_text("raise SystemExit('this file hides the program')\n")

    def link(self) -> None:
        """Link what the tests' environment has, but for this project."""
        for path in Path(numba.__file__).parents[1].iterdir():
            name = path.name.lower()
            there = (self.site / path.name).exists()
            if not (name.startswith(OWN) or path.suffix == ".pth" or there):
                (self.site / path.name).symlink_to(path)

    def __call__(self, *words: str | Path) -> str:
        clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        command = [str(word) for word in (self.place / "bin" / words[0], *words[1:])]
        ran = subprocess.run(command, cwd=self.here, env=clean, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        return ran.stdout + ran.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=True)
    program = Installed(place, tmp_path_factory.mktemp("user") / "here")
    program.link()
    wheel = build_wheel(tmp_path_factory.mktemp("wheel"))
    program("python", "-m", "pip", "install", "--no-deps", "--no-index", "--quiet", wheel)
    return program


def expanded(folder, command):
    """Words of a command as a shell in this folder would have them."""
    for word in command.split():
        yield from (str(hit.relative_to(folder)) for hit in folder.glob(word)) if "*" in word else (word,)


LAB = ("--yes", "--balls", "3", "--arrangement", "triangle", "--glass", "acrylic", "--support-mm", "8",
       "--sensor-px", "1024", "1024", "--pixel-pitch-um", "5.5")  # fmt: skip
README = Path(__file__).resolve().parents[2] / "README.md"
FIRST_PICTURE_S = 180.0


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_first_hour_of_a_new_lab(installed, monkeypatch, tmp_path):
    """The commands of the README and the script of docs/python.md, in the folder that `rtpiv init` made."""
    monkeypatch.setenv("RTPIV_CACHE", str(tmp_path / "cache"))  # a computer that has compiled nothing yet
    begun_s = time.monotonic()
    installed("rtpiv", "init", "lab", *LAB)
    installed.here = lab = installed.here / "lab"
    said = installed("rtpiv", "trace", "scene.yaml", "-o", "trace")
    assert time.monotonic() - begun_s < FIRST_PICTURE_S
    assert "compiling, first use on this computer" in said
    assert len(list((lab / "trace").glob("*.png"))) >= 2

    block = README.read_text(encoding="utf-8").partition("## The first hour")[2].partition("## ")[0]
    commands = re.findall(r"^    (rtpiv (?:check|acquire|calibrate|report) [^#\n]*)", block, re.MULTILINE)
    assert [command.split()[1] for command in commands] == ["check", "acquire", "calibrate", "acquire", "report"]
    for command in commands:
        installed(*expanded(lab, command))
    assert len(list(lab.glob("runs/*shift/report/report.html"))) == 1

    (lab / "fit").rename(lab / "fit-1")  # a fit is not overwritten by that of another run
    (lab / "sim.py").write_text("def mine():\n    return 'mine'\n")
    own = "import sim\n" + script() + "print(sim.mine())\n"
    (lab / "campaign.py").write_text(own)
    said = installed("python", "campaign.py")
    assert "of the plane is recovered" in said
    assert "mine" in said.splitlines()
