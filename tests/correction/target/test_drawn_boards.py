"""Drawn boards are found where they hang, or refused with what to add; none is taken for another of its places."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.target import Chessboard
from correction.target.board_search import find_board, track_board
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.target.count_boards import count_boards
from tests.correction.target.drawn_boards import KINDS, NOMINAL, camera, drawn, verdict
from tracer.scene.scene import Scene

FEW = (2, 3, 4, 5, 7, 8, 9, 13, 14)  # of each kind some, behind none, two and three balls
FOREIGN = (344, 364, 382, 544)  # behind balls, at rims and along the end of what hides the board, nearly in place
PLAIN = Chessboard(3.0, discs=(), squares=(14, 11))


def predict(place_mm):
    return NOMINAL.project(place_mm)


def seen(board, true=NOMINAL, odd_bright=True):
    """A frame of a bare board."""
    real = Print(
        board.square_mm, discs=board.discs, squares=board.squares, origin_corner=board.origin_corner,
        odd_bright=odd_bright,
    )  # fmt: skip
    return render(Scene(true, ()), real, Sensor(), samples=2, seed=1)


@pytest.mark.slow
def test_of_some_drawn_boards_none_is_wrong():
    count = count_boards(FEW)
    assert not count.wrong
    assert all(count.said[kind, "right"] > 1 for kind in KINDS), count


@pytest.mark.parametrize("seed", FOREIGN)
def test_corners_seen_through_a_ball_or_beside_the_board_are_none_of_it(seed):
    said, about = verdict(drawn(seed))
    assert said == "right", (said, about)


@pytest.mark.slow
def test_of_a_thousand_drawn_boards_none_is_wrong():
    count = count_boards(range(1000))
    print(f"\n{count}")
    assert not count.wrong
    assert count.said["discs", "right"] > 180, count  # of 250: discs of the others are hidden, or out of the frame
    assert count.said["charuco", "right"] > 235, count
    assert count.said["dots", "right"] > 165, count  # as for discs
    assert count.said["plain", "right"] > 85, count  # half of them are larger than the frame
    assert all(np.median(count.rms_px[kind]) < 0.03 for kind in KINDS), count


@pytest.mark.parametrize("odd_bright", [True, False])
@pytest.mark.parametrize("origin_corner", [None, (6, 4)])
def test_a_plain_board_is_counted_from_its_edges_by_a_camera_that_stands_elsewhere(odd_bright, origin_corner):
    board = replace(PLAIN, origin_corner=origin_corner)
    true = camera((4.0, -5.0, 296.0), (4.0, 3.0), 0.05)
    found = track_board(seen(board, true, odd_bright), board, predict, reach=12.0)
    there = true.project(np.column_stack((found.plane_mm, np.zeros(len(found)))))
    assert len(found) == 130
    assert np.abs(found.position_px - there).max() < 0.5  # of 16 px to the next corner
    assert found.board == replace(board, odd_bright=odd_bright)


@pytest.mark.parametrize(
    ("told", "shown", "reach", "words"),
    [
        (replace(PLAIN, squares=None), replace(PLAIN, squares=(99, 99)), 12.0, "say how many squares"),
        (replace(PLAIN, squares=(99, 99)), replace(PLAIN, squares=(99, 99)), 12.0, "bring a corner of the board"),
        (replace(PLAIN, squares=(13, 11)), PLAIN, 12.0, "14 squares from edge to edge and 11 squares"),
        (PLAIN, PLAIN, 1.0, "lies within 1 squares"),
        (Chessboard(3.0), replace(PLAIN, squares=(99, 99)), 12.0, "discs that mark the origin"),
    ],
)
def test_what_does_not_say_where_it_is_is_refused_with_what_to_add(told, shown, reach, words):
    true = camera((4.0, -5.0, 296.0), (4.0, 3.0), 0.05)
    with pytest.raises(TargetNotFound, match=words):
        track_board(seen(shown, true), told, predict, reach=reach)


def test_a_view_that_is_good_enough_says_by_itself_where_a_plain_board_is():
    board = replace(PLAIN, squares=None)
    found = track_board(seen(replace(PLAIN, squares=(99, 99)), NOMINAL, False), board, predict, reach=0.7)
    assert np.abs(found.position_px - predict(found.board.place_mm(found.index))).max() < 0.5
    with pytest.raises(TargetNotFound, match="prediction"):
        find_board(seen(PLAIN), PLAIN)
