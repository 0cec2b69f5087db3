"""Plates with dots on two levels are found however they are turned, and their marks lie where they were cut."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import BoardError, TargetNotFound
from correction.target import Chessboard
from correction.target.board_file import PrintedBoard, board_text
from correction.target.board_origin import Placing
from correction.target.board_search import find_board, track_board
from correction.target.chessboard import QUARTER_TURNS
from correction.target.lattice_fit import measure_lattice
from correction.target.lattice_growth import Patch
from sim.renderer.patterns import Plate
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.target.drawn_boards import NOMINAL, camera, counted
from tests.slow_cases import one_in_three
from tracer.board import LARGE_DOTS, Dots
from tracer.scene.scene import Scene

PITCH_MM = 3.0
LEVELS = ("rows", "columns", "alternating")
FEW = (1, 4, 5, 8, 11)


def words(levels, step_mm=1.0, bright=True):
    """What a board and a plate are made of."""
    return {"discs": LARGE_DOTS, "dots": Dots(0.4 * PITCH_MM, bright, levels, step_mm), "squares": (14, 12)}


def seen(true=NOMINAL, **about):
    """A frame of a bare plate."""
    plate = Plate(PITCH_MM, 0.65 * PITCH_MM, **words(**about))
    return render(Scene(true, ()), plate, Sensor(), samples=4, seed=1)


def told(**about):
    return Chessboard(PITCH_MM, 0.65 * PITCH_MM, **words(**about))


def aslant(degrees):
    """A camera that looks at the plate from aside, and is rolled."""
    away, up = 300.0 * np.sin(np.deg2rad(degrees)), 300.0 * np.cos(np.deg2rad(degrees))
    return camera((0.8 * away, 0.6 * away, up), (0.0, 0.0), 0.1)


@pytest.mark.parametrize(
    ("levels", "view"), one_in_three(LEVELS, [(0.0, 1.0, True), (30.0, 1.0, True), (40.0, -0.5, False)])
)
def test_dots_of_both_levels_are_where_they_were_cut(levels, view):
    degrees, step_mm, bright = view
    true = aslant(degrees)
    about = {"levels": levels, "step_mm": step_mm, "bright": bright}
    found = find_board(seen(true, **about), told(**about))
    assert len(found) > 130
    off = found.position_px - true.project(found.board.place_mm(found.index))
    deep = found.board.depth_mm(found.index) != 0.0
    for level in (deep, ~deep):
        assert np.sqrt(np.mean(off[level] ** 2)) < 0.03
    flat = found.position_px - true.project(np.column_stack((found.plane_mm, np.zeros(len(found)))))
    if degrees:  # else a pixel at the border alone
        assert np.median(np.linalg.norm(flat[deep], axis=1)) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("levels", LEVELS)
def test_a_camera_that_is_believed_a_pitch_aside_moves_no_dot(levels):
    true = camera((PITCH_MM, -2.0 * PITCH_MM, 300.0), (PITCH_MM, -2.0 * PITCH_MM), 0.02)
    found = track_board(seen(true, levels=levels), told(levels=levels), NOMINAL.project, reach=4.0)
    assert len(found) > 120
    assert np.sqrt(np.mean((found.position_px - true.project(found.board.place_mm(found.index))) ** 2)) < 0.03


def test_without_its_large_dots_a_plate_is_refused():
    covered = seen(levels="rows")
    covered[:, 150:] = covered[0, 0]
    with pytest.raises(TargetNotFound, match="not the 3 large dots"):
        track_board(covered, told(levels="rows"), NOMINAL.project, reach=4.0)


def test_a_plate_whose_large_dot_cannot_be_measured_is_refused_and_measured_once_it_is_clear():
    clear, board = seen(levels="rows"), told(levels="rows")
    found = find_board(clear, board)
    patch = Patch(found.index, found.position_px, found.axes_px, board.corner_sign(found.index))
    placed = [(patch, Placing(QUARTER_TURNS[0], (0, 0)))]
    u, v = np.rint(NOMINAL.project(np.zeros(3))).astype(int)
    hidden = clear.copy()
    hidden[v - 7 : v + 8, u - 7 : u + 8] = clear[0, 0]
    with pytest.raises(TargetNotFound, match=r"large dots of the plate do not lie on one smooth view.*take away"):
        measure_lattice(hidden, board, placed, None)
    assert len(measure_lattice(clear, board, placed, None)) == len(found)


def test_of_some_drawn_plates_none_is_wrong():
    count, wrong, rms = counted("plate", FEW)
    assert not wrong
    assert count["right"] > 1
    assert np.median(rms) < 0.03


@pytest.mark.slow
def test_of_two_hundred_drawn_plates_none_is_wrong():
    count, wrong, rms = counted("plate", range(200))
    assert not wrong
    assert count["right"] > 100, count  # large dots of the others are hidden, or out of the frame
    assert np.median(rms) < 0.03


def test_depths_are_those_of_rows_columns_or_fields():
    index = np.array([(0, 0), (1, 0), (0, 1), (-1, 1), (-2, -3)])
    deep = {
        "rows": [0.0, 0.0, 1.5, 1.5, 1.5], "columns": [0.0, 1.5, 0.0, 1.5, 0.0],
        "alternating": [0.0, 1.5, 1.5, 0.0, 1.5],
    }  # fmt: skip
    for levels, depths in deep.items():
        board = told(levels=levels, step_mm=1.5)
        assert board.depth_mm(index).tolist() == depths
        assert np.array_equal(board.place_mm(index)[:, 2], -np.array(depths))
        assert board.stretch((1.0, 1.0, 1.1)).depth_mm(index) == pytest.approx(1.1 * np.array(depths))
    flat = replace(told(levels="rows"), dots=Dots(1.2))
    assert not flat.depth_mm(index).any()
    assert flat.print_sigma == flat.scale_sigma


@pytest.mark.parametrize(
    "wrong", [{"levels": "rows"}, {"step_mm": 1.0}, {"levels": "diagonals", "step_mm": 1.0}], ids=str
)
def test_half_a_plate_is_refused(wrong):
    with pytest.raises(BoardError, match="say"):
        Chessboard(PITCH_MM, 0.65 * PITCH_MM, discs=LARGE_DOTS, dots=Dots(0.4 * PITCH_MM, **wrong))


@pytest.mark.parametrize("discs", [((0, 0),), ((0, 0), (1, 0))], ids=str)
def test_large_dots_of_a_plate_show_how_it_is_turned(discs):
    with pytest.raises(BoardError, match=r"at least two discs|look the same"):
        Chessboard(PITCH_MM, 0.65 * PITCH_MM, discs=discs, dots=Dots(0.4 * PITCH_MM, True, "rows", 1.0))


FILE = {
    "kind": "dots", "pitch_mm": 5.0, "dot_mm": 1.5, "large_dot_mm": 2.5, "bright_dots": True, "levels": "rows",
    "step_mm": 1.0,
}  # fmt: skip


def test_a_board_file_says_levels_and_what_is_known_of_them():
    board = PrintedBoard(**FILE).board()
    assert board.dots == Dots(1.5, True, "rows", 1.0)
    assert board.scale_sigma == (1e-4, 1e-4)
    assert board.print_sigma == (1e-4, 1e-4, 0.01)
    assert "levels: rows" in board_text(PrintedBoard(**FILE))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"step_mm": None}, "levels and step_mm"),
        ({"levels": None}, "levels and step_mm"),
        ({"step_mm": 0.0}, "step_mm is not 0"),
        ({"step_mm": -4.5}, "at most 0.8 of pitch_mm"),
        ({"levels": "diagonals"}, "rows"),
        ({"levels": None, "step_mm": None, "step_sigma_mm": 0.1}, "step_sigma_mm, the uncertainty"),
    ],
)
def test_a_board_file_that_is_no_plate_is_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        PrintedBoard(**FILE | wrong)
