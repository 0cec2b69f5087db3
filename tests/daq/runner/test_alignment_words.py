"""What an alignment says: by which balls it was measured, which stand elsewhere, that nothing needs to move."""

import numpy as np

from correction.alignment.moves import Wanted
from correction.alignment.spheres_seen import SphereSeen
from daq.runner.alignment_loop import end_in_words, move_in_words

NOTHING = np.zeros(3)


def ball(name, off_um, own_rim=True):
    return SphereSeen(name, np.array((1e-3 * off_um, 0.0, 0.0)), np.eye(3) * 0.005**2, own_rim, 1.0)


def said(*balls):
    want = Wanted(NOTHING, NOTHING, NOTHING, np.full(3, 0.002), NOTHING, NOTHING, 0.0)
    return end_in_words(want, balls)


def test_every_ball_has_its_own_word_and_the_last_sentence_covers_only_those_that_were_judged():
    *balls, last, _ = said(ball("near", 0.0), ball("far", 0.0, own_rim=False), ball("last", 0.0, own_rim=False))
    assert balls[0] == "near: at its place in the glass, 0 +- 7 um off sideways"
    assert [line.split(",")[0] for line in balls[1:]] == ["far: not judged", "last: not judged"]
    assert last.startswith("aligned by near: 0 um off sideways, +- 3 um; not judged: far, last (+- 700 um)")
    assert said(ball("near", 0.0), ball("far", 2.0))[-2] == "aligned: 0 um off sideways, +- 3 um"


def test_a_ball_that_stands_elsewhere_is_named():
    text = "\n".join(said(ball("near", 0.0), ball("far", 100.0)))
    assert "far itself stands 100 +- 7 um off its place" in text
    assert "near itself" not in text
    left = np.array((0.1, 0.0, 0.0))  # all of the glass is off: of no ball is that its own
    want = Wanted(NOTHING, NOTHING, left, np.full(3, 0.002), NOTHING, NOTHING, 0.0)
    assert not any("itself" in line for line in end_in_words(want, [ball("near", 100.0), ball("far", 100.0)]))


def test_nothing_to_move_is_said_as_that():
    assert "no axis needs to move" in move_in_words({"x": 1.0}, {"x": 1.0})
    assert move_in_words({"x": 1.0}, {"x": 1.5}) == "moving x +0.5000 mm"
