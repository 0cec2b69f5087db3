from dataclasses import replace

import numpy as np
import pytest

from correction.errors import BoardError
from correction.target import Chessboard


def test_shade_of_the_supplied_board_in_words():
    board = Chessboard()
    where = {
        (1.25, 1.25): 1,  # bright disc in the dark square (0, 0)
        (0.2, 0.2): 0,  # that square beside its disc
        (1.25, -1.25): 0,  # dark disc in the bright square (0, -1)
        (0.2, -0.2): 1,
        (-1.25, -1.25): 1,
        (-1.25, 1.25): 1,  # bright square without a disc
        (3.75, 1.25): 1,
        (3.75, 3.75): 0,
        (1.25 + 0.49, 1.25): 1,  # just inside and just outside the disc
        (1.25 + 0.51, 1.25): 0,
    }
    assert board.shade(np.array(list(where))).tolist() == list(where.values())


def test_corner_sign_is_the_shade_of_the_square_up_and_right():
    board = Chessboard(disc_mm=0.1)
    index = board.corners_within([(-9, -9), (9, 9)])
    up_right = board.shade(board.corner_mm(index) + 0.3)
    assert (np.where(up_right > 0.5, 1, -1) == board.corner_sign(index)).all()


def test_corners_within_a_box_and_a_triangle():
    board = Chessboard(square_mm=2.0, disc_mm=0.5)
    box = {tuple(c) for c in board.corners_within([(-3, -1), (5, 3)]).tolist()}
    assert box == {(i, j) for i in (-1, 0, 1, 2) for j in (0, 1)}
    triangle = {tuple(c) for c in board.corners_within([(-0.1, -0.2), (4.5, -0.2), (-0.1, 4.4)]).tolist()}
    assert triangle == {(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)}
    assert len(board.corners_within([(0.1, 0.1), (0.2, 0.2)])) == 0
    ends = replace(board, squares=(4, 4), origin_corner=(1, 2), discs=())
    assert {tuple(c) for c in ends.corners_within([(-9, -9), (9, 9)]).tolist()} == {
        (i, j) for i in (0, 1, 2) for j in (-1, 0, 1)
    }


def test_arms_stay_clear_of_every_disc():
    board = Chessboard()
    t = np.linspace(-0.49, 0.49, 99)
    clear = 0.5 - 0.5 * board.disc_mm / board.square_mm  # of every disc, half the width of an arm
    arm = np.stack(np.meshgrid(t, np.linspace(-1, 1, 41) * (clear - 1e-6)), -1).reshape(-1, 2)
    bare = Chessboard(disc_mm=1e-6)
    for points in (arm, arm[:, ::-1]):
        for index in board.corners_within([(-6, -6), (6, 6)]):
            around = board.corner_mm(index) + points * board.square_mm
            assert (board.shade(around) == bare.shade(around)).all()


@pytest.mark.parametrize(
    ("numbers", "word"),
    [
        ({"square_mm": 0.0}, "positive"),
        ({"disc_mm": 2.0}, "1.5 mm or less"),
        ({"discs": ((0, 0),)}, "two discs"),
        ({"discs": ((0, 0), (0, 0))}, "two discs"),
        ({"discs": ((0, 0), (1, 1), (0, 1), (1, 0))}, "turn"),
        ({"discs": ((0, 0), (2, 0))}, "turn"),
    ],
)
def test_impossible_boards_are_refused_with_the_cure(numbers, word):
    with pytest.raises(BoardError, match=word):
        Chessboard(**numbers)


def test_a_broken_outline_is_refused():
    with pytest.raises(BoardError, match="outline"):
        Chessboard().corners_within([(0.0, np.nan), (1.0, 1.0)])
