"""A ball that was knocked after the calibration: terminal, head of the page and mean.nc say it, and go on to."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import netcdf_file

from correction.self_check.moved_sphere import judge_pairs
from rtpiv.analysis.series import self_check
from rtpiv.command_line.cli import main
from tests.correction.self_check.test_moved_sphere import NAMES, PAIRS, particles
from tests.rtpiv.analysis.series.small_series import flow_run
from tracer.light_sheet import LightSheet

WINDOWS = ("--first-window", "32", "--final-window", "16", "--workers", "1")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A small run, and what the particles of another one, behind balls, say of them."""
    monkeypatch.setattr(self_check, "load_scene", lambda path: SimpleNamespace(bodies=NAMES, sheet=None))
    monkeypatch.setattr(self_check, "flow_frames", lambda runs, scene: None)
    return flow_run(tmp_path, 4)


def say(monkeypatch, move_mm: float) -> None:
    move = np.zeros(9)
    move[3] = move_mm
    found = judge_pairs(NAMES, particles(np.random.default_rng(1), move), PAIRS, LightSheet())
    monkeypatch.setattr(self_check, "self_check_of", lambda frames: found)


def attributes(folder) -> dict[str, str]:
    with netcdf_file(folder / "mean.nc", mmap=False) as file:
        names = [name for name in ("self_check", "spheres_moved") if hasattr(file, name)]
        return {name: getattr(file, name).decode() for name in names}


@pytest.mark.slow
def test_a_ball_knocked_after_calibration_is_told_wherever_the_mean_is(run, monkeypatch, capsys):
    say(monkeypatch, 0.05)
    for asked in (run, run / "series"):  # evaluated, then averaged again without its frames
        assert main(["mean", str(asked), *(WINDOWS if asked == run else ())]) == 0
        assert "middle has moved" in " ".join(capsys.readouterr().out.split())
        assert attributes(run / "series")["spheres_moved"] == "middle"
        page = (run / "series" / "mean.html").read_text(encoding="utf-8")
        assert 0 < page.index("middle has moved") < page.index("mean speed")


def test_balls_that_stand_still_are_no_alarm(run, monkeypatch, capsys, no_mean_page):
    say(monkeypatch, 0.0)
    assert main(["mean", str(run), *WINDOWS]) == 0
    assert "moved" not in capsys.readouterr().out
    found = attributes(run / "series")
    assert "no sphere has moved" in found["self_check"]
    assert "spheres_moved" not in found
