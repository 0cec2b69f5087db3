"""A plate with two levels of dots through the verbs alone: lab, frames, calibration, against the truth."""

import json

import pytest
import yaml

from daq.bench.bench_file import load_bench
from daq.bench.opened import start_simulation
from rtpiv.command_line.cli import DONE, main
from rtpiv.verbs.init import GivenLab, init

PLATE = """kind: dots
pitch_mm: 4.0
dot_mm: 1.5
large_dot_mm: 2.4
bright_dots: true
levels: rows
step_mm: 1.2
"""
FEW = "experiment: target\nclear: {z_mm: [0.0, -15.0]}\nglass: {z_mm: [0.0, -15.0]}\n"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A lab of one ball before a plate, and the target run of its simulated bench."""
    folder = tmp_path_factory.mktemp("plate") / "lab"
    init(folder, GivenLab(balls=1, ball_mm=(30.0,), glass=("BK7",), sensor_px=(480, 400), pixel_pitch_um=12.0))
    (folder / "plate.yaml").write_text(PLATE)
    (folder / "plan-target.yaml").write_text(FEW)
    tree = yaml.safe_load((folder / "bench.yaml").read_text())
    tree["target"] = {"board": "plate.yaml"}
    tree["simulation"].update(camera_transport="memory", samples=2)
    (folder / "bench.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    assert main(["check", str(folder / "bench.yaml"), str(folder / "plate.yaml")]) == DONE
    words = [str(folder / "plan-target.yaml"), "--bench", str(folder / "bench.yaml"), "-o", str(folder / "runs")]
    assert main(["acquire", *words, "--simulate", "--home", "--no-correct"]) == DONE
    return folder


def run_of(lab):
    (run,) = (path.parent for path in (lab / "runs").glob("*/run.json"))
    return run


@pytest.mark.slow
def test_the_run_of_a_plate_is_calibrated_by_its_own_board(lab, tmp_path, capsys):
    assert main(["calibrate", str(run_of(lab)), "-o", str(tmp_path / "fit"), "--no-pictures"]) == DONE
    assert "the model is right" in " ".join(capsys.readouterr().out.split())
    found = json.loads((tmp_path / "fit" / "calibration.json").read_text())
    truth = yaml.safe_load((run_of(lab) / "truth.yaml").read_text())
    (ball,) = truth["bodies"]
    for place, axis in enumerate("xyz"):
        number = found["numbers"][f"ball.{axis}"]
        assert number["sigma"] < 0.1
        assert abs(number["value"] - ball["centre_mm"][place]) < 4.0 * number["sigma"] + 0.01, axis  # screws' play
    step = found["numbers"]["print.step"]
    simulation = start_simulation(load_bench(lab / "bench.yaml"))
    true_mm = simulation.world.print.dots.step_mm
    simulation.close()
    assert abs(true_mm - 1.2) > 1e-4  # its maker has missed a little
    assert 1.2 * step["sigma"] < 0.005  # told to 0.01
    assert abs(1.2 * (1.0 + step["value"]) - true_mm) < 4.0 * 1.2 * step["sigma"]
    assert found["map_sigma_px"]["behind glass"]["largest"] < 0.1
