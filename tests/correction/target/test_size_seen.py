"""Boards with squares of another size than told: the refusal says how much, never to bring marks into view."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import corners_in_view, find_board, track_board
from correction.target.codes import with_codes
from correction.target.size_seen import size_seen
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import CodedBoard, DotGrid, Pose, place
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.target.drawn_boards import NOMINAL, REACH_MM, camera, drawn, verdict
from tests.slow_cases import slow_but
from tracer.board import LARGE_DOTS, Codes, Dots
from tracer.bodies import Sphere
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene

SIDE_MM = {"discs": 3.0, "plain": 3.0, "charuco": 4.8, "dots": 3.0}
CODES = Codes("DICT_4X4_100", 0.7)
LARGER = slow_but((0.5, 0.7, 0.8, 0.91, 0.95, 1.05, 1.1, 1.25, 1.5, 2.0), 0.5, 0.95, 1.25, 2.0)
FLAT = Pose()
OFF = camera((3.0, -2.0, 298.0), (2.0, 1.0), 0.02)


def predict(board_mm):
    return NOMINAL.project(np.column_stack((board_mm[:, :2], np.zeros(len(board_mm)))))


def told(kind, times=1.0, squares=None):
    """A board whose squares are said to be so many times as large as they are."""
    side = times * SIDE_MM[kind]
    board = Chessboard(side, 0.4 * side, squares=squares)
    if kind == "charuco":
        return with_codes(replace(board, discs=(), squares=squares or (12, 10)), CODES)
    if kind == "dots":
        return replace(board, disc_mm=0.65 * side, discs=LARGE_DOTS, dots=Dots(0.4 * side))
    return replace(board, discs=() if kind == "plain" else board.discs)


def seen(kind, true=OFF, bodies=(), pose=FLAT):
    """A frame of the board as it is, larger than the frame but for a charuco board."""
    side = SIDE_MM[kind]
    paper = {
        "discs": Print(side, 0.4 * side),
        "plain": Print(side, discs=()),
        "charuco": CodedBoard(side, discs=(), codes=CODES, squares=(12, 10)),
        "dots": DotGrid(side, 0.65 * side, discs=LARGE_DOTS, dots=Dots(0.4 * side)),
    }[kind]
    return render(Scene(true, bodies), place(paper, pose), Sensor(), samples=2, seed=1)


@pytest.fixture(scope="module", params=SIDE_MM)
def kind_and_frame(request):
    return request.param, seen(request.param)


@pytest.mark.parametrize("times", LARGER)
def test_a_board_of_another_size_is_found_by_its_marks_or_named_with_both_sizes(kind_and_frame, times):
    """What is found is for the fit to judge, which knows how well the camera is told."""
    kind, frame = kind_and_frame
    board = told(kind, times)
    try:
        found = track_board(frame, board, predict, reach=REACH_MM / board.square_mm)
    except TargetNotFound as error:
        said = str(error)
        assert "into view" not in said
        side = f"{board.square_mm:g} mm ({board.square_mm * 1600.0 / 300.0:.1f} px)"
        assert f"times as large as the camera should see those of {side}" in said
        key = "pitch_mm" if kind == "dots" else "square_mm"
        about = float(said.split(f"the right {key} (about ")[1].split(")")[0])
        assert about == pytest.approx(SIDE_MM[kind], rel=0.015)
    else:
        assert kind == "charuco" or (kind != "plain" and 0.7 < times < 1.45)
        there = OFF.project(np.column_stack((found.plane_mm / times, np.zeros(len(found)))))
        assert np.abs(found.position_px - there).max() < 0.5


@pytest.mark.parametrize("kind", ["discs", "dots"])
def test_marks_that_are_hidden_are_asked_for_where_the_size_is_right(kind):
    frame = seen(kind)
    frame[90:190, 110:210] = frame[0, 0]
    board = told(kind)
    with pytest.raises(TargetNotFound, match="into view"):
        track_board(frame, board, predict, reach=REACH_MM / board.square_mm)


def test_a_board_that_leans_is_as_large_as_one_that_does_not():
    frame = seen("discs", NOMINAL, pose=Pose(turn_rad=(0.0, 0.4, 0.0)))
    found = find_board(frame, told("discs"))
    view = corners_in_view(told("discs"), predict, frame.shape)
    size = size_seen(found.position_px, found.axes_px, view, told("discs"))
    assert size is not None
    assert size.times == pytest.approx(1.0, abs=0.02)


def test_a_view_through_a_ball_says_nothing_of_the_size():
    """It is as wrong as through a board of another size, but not alike all over."""
    ball = Sphere("ball", (0.0, 0.0, 28.0), 26.0, ConstantMedium(1.5))
    board = told("discs")
    with pytest.raises(TargetNotFound) as refused:
        track_board(seen("discs", NOMINAL, (ball,)), board, predict, reach=REACH_MM / board.square_mm)
    assert "times as large" not in str(refused.value)


@pytest.mark.parametrize("seed", [168, 199])
def test_a_few_corners_of_a_board_that_is_as_told_do_not_make_it_larger(seed):
    """Fifteen and 25 of them, by a camera that stands 5 mm nearer."""
    said, about = verdict(drawn(seed))
    assert said == "refused"
    assert "times as large" not in about
