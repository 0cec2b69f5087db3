"""Boards that are not ours, behind two balls: the fit is as good by them, and a wrong count is refused."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import TargetNotFound
from correction.fit.scene_fit import fit_scene
from correction.fit.seen.measurement import TargetFrame
from correction.target import Chessboard
from correction.target.codes import with_codes
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.patterns import CodedBoard
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.benches import SQUARE_MM, errors_behind
from tests.correction.fit.test_dots import grid
from tests.correction.fit.test_plates import plate
from tracer.board import Codes

CODES = Codes("DICT_4X4_1000", 0.7)
SIZE = {"squares": (42, 41), "origin_corner": (20, 22)}
PLAIN = Chessboard(SQUARE_MM, discs=(), **SIZE)
BOARDS = {
    "discs": (Chessboard(SQUARE_MM, 0.4 * SQUARE_MM, **SIZE), Print(SQUARE_MM, 0.4 * SQUARE_MM, **SIZE)),
    "plain": (PLAIN, Print(SQUARE_MM, discs=(), odd_bright=False, **SIZE)),
    "charuco": (
        with_codes(Chessboard(2.0 * SQUARE_MM, discs=(), squares=(26, 27), origin_corner=(12, 13)), CODES),
        CodedBoard(2.0 * SQUARE_MM, discs=(), squares=(26, 27), origin_corner=(12, 13), codes=CODES),
    ),
}

CASES = [
    *(("discs", 3), ("plain", 3), ("charuco", 3), ("dots", 3), ("dots", 4), ("dots", 5), ("rows", 3), ("rows", 4)),
    *(("rows", 5), ("alternating", 3), ("columns", 4)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), CASES)
def test_the_map_behind_two_balls_is_right_by_any_board(kind, seed):
    if kind == "dots":
        board, paper = grid(SQUARE_MM)
    elif kind in BOARDS:
        board, paper = BOARDS[kind]
    else:
        board, paper = plate(kind, 1.0, SQUARE_MM, bright=kind == "rows")
    nominal = at_size(demo_scene("two_spheres_500"), 1008)
    truth, samples = misalign(nominal, seed), 3 if kind in BOARDS else 5
    frames = [
        TargetFrame("clear", render(truth.with_bodies(()), paper, Sensor(), samples=samples, seed=1), False),
        TargetFrame("glass", render(truth, paper, Sensor(), samples=samples, seed=2), True),
    ]
    fit = fit_scene(nominal, frames, board)
    error, _, compared = errors_behind(fit, truth)
    assert compared > 0.99
    assert np.sqrt(np.mean(error**2)) < (0.02 if kind == "charuco" else 0.01)  # whose squares are twice as large
    assert not fit.verdict.unlisted
    assert fit.board.odd_bright == (paper.odd_bright if kind in ("discs", "plain") else board.odd_bright)


@pytest.mark.slow
def test_a_plain_board_of_another_count_is_refused_with_both():
    nominal = at_size(demo_scene("two_spheres_500"), 1008)
    bare = render(misalign(nominal, 3).with_bodies(()), BOARDS["plain"][1], Sensor(), samples=2, seed=1)
    frames = [TargetFrame("clear", bare, False), TargetFrame("glass", bare, True)]
    with pytest.raises(TargetNotFound, match=r"clear: .* squares from edge to edge .* 41 x 41 squares .* count"):
        fit_scene(nominal, frames, replace(PLAIN, squares=(41, 41)))
