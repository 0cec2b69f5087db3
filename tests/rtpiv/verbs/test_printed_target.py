"""A target as a new user has it: from `rtpiv target` by a foreign program to dots, photographed, calibrated."""

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.target.board_file import read_board
from rtpiv.analysis.prints import sheets
from rtpiv.analysis.prints.pages import PAPERS_MM, _middle, room_on
from rtpiv.verbs.target import target
from sim.demo.scenes import at_size, misaligned, named_scene
from sim.renderer.patterns import Image, Pose
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import errors_behind

DPI, PAPER, SIZE_PX, HEIGHTS_MM = 600, "A4", 1008, (0.0, -10.0)
LEAST, MOST = 0.08, 0.92  # reflectance of ink and paper
SQUARE_MM = {"chessboard": 3.0, "charuco": 5.0, "dots": 3.5}


def printed(path, kind, square_mm):
    """The page as dots (Image), its origin at that of the target."""
    document = pytest.importorskip("pypdfium2").PdfDocument(path)
    grey = document[0].render(scale=DPI / 72.0, grayscale=True).to_numpy().reshape(-1, round(210 / 25.4 * DPI))
    sheet = {"chessboard": sheets.chessboard, "charuco": sheets.charuco, "dots": sheets.dots}[kind]
    left, lower, right, upper = sheet(room_on(PAPER), square_mm).bounds_mm
    width, height = PAPERS_MM[PAPER]
    pose = Pose((_middle(width, left, right), _middle(height, lower, upper), 0.0))
    values = (LEAST + (MOST - LEAST) / 255.0 * grey).astype(np.float32)
    return Image(values, 25.4 / DPI, MOST, pose)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", SQUARE_MM)
@pytest.mark.parametrize("name", ["two_spheres_500", "three_spheres_500"])
def test_a_target_from_the_printer_makes_a_map_that_is_right_behind_glass(tmp_path, kind, name):
    pytest.importorskip("pypdfium2")
    made = target(kind=kind, paper=PAPER, square_mm=SQUARE_MM[kind], out=tmp_path / "target")
    target(tmp_path / "target" / "board.yaml", measured_mm=made.board.bars_mm)
    board = read_board(tmp_path / "target" / "board.yaml").board()
    paper = printed(made.path, kind, board.square_mm)
    nominal = at_size(named_scene(name), SIZE_PX)
    truth, frames = misaligned(nominal, 3), []
    for glass in (False, True):
        for height in HEIGHTS_MM:
            sheet = Image(paper.values, paper.pixel_mm, MOST, paper.pose.moved(0.0, 0.0, height))
            scene = truth if glass else truth.with_bodies(())
            image = render(scene, sheet, Sensor(), samples=5, seed=len(frames))
            frames.append(TargetFrame(f"{glass} {height:g}", image, glass, height))
    fit = fit_scene(nominal, frames, board)
    error, sigma, compared = errors_behind(fit, truth)
    rms = np.sqrt(np.mean(error**2))
    print(f"\n{kind}, {name}: map {rms:.4f} px rms behind glass, sigma {np.sqrt(np.mean(sigma**2)):.4f} px")
    assert compared > 0.99
    assert rms < 0.01
