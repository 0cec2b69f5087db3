"""Frames that contradict what is given: files or heights exchanged, frames turned, walls before the board."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import CorrectionError, FitFailed, TargetNotFound
from correction.fit import camera_stage
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.target import Chessboard
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import DotGrid
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import bench
from tests.slow_cases import slow
from tracer.board import LARGE_DOTS, Dots
from tracer.scene.scene_file import load_priors, load_scene

MADE = "two_spheres_500", 6, (-10.0, 10.0), (), 504
TANK = """
wavelength_nm: 532.0
camera: {focal_px: 1600.0, position_mm: [0.0, 0.0, 700.0], sensor_px: [480, 384]}
bodies:
  - {name: pane, kind: window, centre_mm: [0.0, 0.0, 268.0], normal: [0.0, 0.0, 1.0], thickness_mm: 8.0,
     radius_mm: 250.0, material: acrylic, behind: water}
fit:
  camera: {position_mm: 3.0}
"""


def test_exchanged_files_are_named():
    """The frame with glass is called bare, and the bare one is called that with glass; renamed they fit."""
    frames = bench(*MADE).frames
    at_zero = [frame for frame in frames if frame.height_mm == 0.0]
    exchanged = [replace(frame, glass=not frame.glass) for frame in at_zero]
    with pytest.raises(CorrectionError, match=r"shows the bare target without glass.*the files are exchanged"):
        fit_scene(bench(*MADE).nominal, exchanged, bench(*MADE).board)


@pytest.mark.slow
def test_exchanged_heights_are_named():
    bare = [frame for frame in bench(*MADE).frames if not frame.glass]
    nominal = bench(*MADE).nominal.with_bodies(())
    swapped = [replace(frame, height_mm=-frame.height_mm) for frame in bare]
    with pytest.raises(FitFailed, match=r"with its heights exchanged: z\+ and z- are swapped"):
        fit_scene(nominal, swapped, bench(*MADE).board)
    fit_scene(nominal, bare, bench(*MADE).board)  # as advised


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (lambda image: image[::-1, ::-1], r"turned by [+-]1(80|79) degrees"),
        (lambda image: image[:, ::-1], "if it hangs upright, the frame is a mirror image"),
        (lambda image: image[::-1], "if it hangs upright, the frame is a mirror image"),
    ],
)
def test_turned_frames_are_named(turn, words):
    bare = next(frame for frame in bench(*MADE).frames if not frame.glass)
    nominal = bench(*MADE).nominal.with_bodies(())
    with pytest.raises(TargetNotFound, match=words):
        fit_scene(nominal, [replace(bare, image=np.ascontiguousarray(turn(bare.image)))], bench(*MADE).board)


@pytest.fixture
def tank(tmp_path):
    path = tmp_path / "tank.yaml"
    path.write_text(TANK)
    return load_scene(path), load_priors(path)


@pytest.mark.slow
@pytest.mark.parametrize("board", [Chessboard(15.0, 6.0), slow(Chessboard(15.0, discs=(), squares=(9, 8)))])
def test_a_board_behind_much_water_is_as_large_as_its_window_shows_it(tank, board):
    """Through 260 mm of water squares look a tenth larger; nothing of the board is to be corrected."""
    nominal, priors = tank
    true = replace(nominal.camera, position_mm=(2.1, -1.3, 703.0))
    real = Print(15.0, 6.0, discs=board.discs, squares=board.squares)
    image = render(replace(nominal, camera=true), real, Sensor(), samples=3, seed=1)
    found = fit_scene(nominal, [TargetFrame("clear", image, False)], board, priors)
    off = np.abs(np.subtract(found.scene.camera.position_mm, true.position_mm))
    assert off[2] < 0.5
    assert off.max() < 2.0  # a board of 8 x 7 corners hardly tells sideways from a turn
    wrong = replace(board, square_mm=16.9)
    with pytest.raises(CorrectionError, match=r"give the right square_mm \(about 1(4\.9|5)"):
        fit_scene(nominal, [TargetFrame("clear", image, False)], wrong, priors)


@pytest.mark.slow
def test_a_board_within_a_tube_of_water_is_as_large_as_the_tube_shows_it(tmp_path):
    """It looks a quarter wider, and no higher; advice for squares that are given wrong is what is printed."""
    path, (before, after) = tmp_path / "tube.yaml", TANK.split("  - {name: pane")
    path.write_text(
        f"{before}  - {{name: tube, kind: tube, start_mm: [0.0, -150.0, 0.0], end_mm: [0.0, 150.0, 0.0],"
        f" outer_radius_mm: 120.0, inner_radius_mm: 114.0, material: acrylic, filled: water}}\n"
        f"fit:{after.split('fit:')[1]}"
    )
    nominal, priors = load_scene(path), load_priors(path)
    true = replace(nominal.camera, position_mm=(2.1, -1.3, 703.0))
    board = Chessboard(10.0, discs=(), squares=(9, 8))
    real = Print(10.0, 4.0, discs=(), squares=(9, 8))
    image = render(replace(nominal, camera=true), real, Sensor(), samples=3, seed=1)
    frames = [TargetFrame("clear", image, False)]
    found = fit_scene(nominal, frames, board, priors)
    assert abs(found.scene.camera.position_mm[2] - true.position_mm[2]) < 0.5
    with pytest.raises(CorrectionError, match=r"give the right square_mm \(about (9\.9|10)"):
        fit_scene(nominal, frames, replace(board, square_mm=11.3), priors)


def test_a_distance_far_from_what_was_known_is_reported(tank):
    nominal, priors = replace(tank[0], bodies=()), tank[1]
    true = replace(nominal.camera, position_mm=(1.0, -1.3, 711.0))  # 3.7 sigmas
    image = render(replace(nominal, camera=true), Print(15.0, 6.0), Sensor(), samples=3, seed=1)
    said = []
    fit_scene(nominal, [TargetFrame("clear", image, False)], Chessboard(15.0, 6.0), priors, said.append)
    assert any("warning: camera.z is 3." in line for line in said), said


@pytest.mark.slow
def test_few_usable_dots_are_refused_in_numbers(tank, monkeypatch, recwarn):
    """Dots of which hardly a picture is whole; it ended in sentences with NaN, after warnings of NumPy."""
    nominal, priors = replace(tank[0], bodies=()), tank[1]
    board = Chessboard(15.0, 9.0, discs=LARGE_DOTS, dots=Dots(6.0))
    image = render(nominal, DotGrid(15.0, 9.0, discs=LARGE_DOTS, dots=Dots(6.0)), Sensor(), samples=3, seed=1)
    whole = camera_stage.centre_dots
    monkeypatch.setattr(
        camera_stage, "centre_dots", lambda *words: (found := whole(*words)).take(np.arange(len(found)) < 5)
    )
    with pytest.raises(TargetNotFound, match=r"only 5 dots of the bare target .* 12 are needed") as said:
        fit_scene(nominal, [TargetFrame("clear", image, False)], board, priors)
    assert "nan" not in str(said.value)
    assert not recwarn.list
