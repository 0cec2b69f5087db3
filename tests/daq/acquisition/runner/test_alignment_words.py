"""What an alignment says: by which balls it was measured, which stand elsewhere, that nothing needs to move."""

import numpy as np

from correction.alignment.moves import Wanted
from correction.alignment.spheres_seen import SphereSeen
from daq.acquisition.runner.aiming import end_in_words, move_in_words

NOTHING = np.zeros(3)


def ball(name, off_um, own_rim=True):
    return SphereSeen(name, np.array((1e-3 * off_um, 0.0, 0.0)), np.eye(3) * 0.005**2, own_rim, 1.0)


def said(*balls):
    want = Wanted(NOTHING, NOTHING, NOTHING, np.full(3, 0.002), NOTHING, NOTHING, 0.0)
    return "\n".join(end_in_words(want, balls))


def test_balls_without_a_rim_are_not_claimed():
    text = said(ball("near", 0.0), ball("far", 0.0, own_rim=False), ball("last", 0.0, own_rim=False))
    assert "measured by 1 of 3 balls, whose rims are seen (near)" in text
    assert "measured by" not in said(ball("near", 0.0), ball("far", 2.0))


def test_a_ball_that_stands_elsewhere_is_named():
    text = said(ball("near", 0.0), ball("far", 100.0))
    assert "far itself stands 100 +- 7 um off its place" in text
    assert "near itself" not in text
    left = np.array((0.1, 0.0, 0.0))  # all of the glass is off: of no ball is that its own
    want = Wanted(NOTHING, NOTHING, left, np.full(3, 0.002), NOTHING, NOTHING, 0.0)
    assert not any("itself" in line for line in end_in_words(want, [ball("near", 100.0), ball("far", 100.0)]))


def test_nothing_to_move_is_said_as_that():
    assert "no axis needs to move" in move_in_words({"x": 1.0}, {"x": 1.0})
    assert move_in_words({"x": 1.0}, {"x": 1.5}) == "moving x +0.5000 mm"
