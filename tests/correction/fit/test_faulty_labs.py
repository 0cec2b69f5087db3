"""Labs with one fault each: every kind can be drawn, and is a fault."""

import re

from tests.correction.fit.faulty_labs import KINDS, faulty, right
from tests.loops import loop_over

SEED = 308


def test_there_are_at_least_25_kinds():
    assert len(KINDS) >= 25


@loop_over("kind", KINDS)
def test_every_kind_changes_something_and_says_what_must_be_said(kind):
    sound, case = right(SEED), faulty(kind, SEED)
    parts = ("given", "bare", "glass", "printed", "priors", "named_mm", "spoil", "pose")
    assert any(getattr(sound, part) != getattr(case, part) for part in parts)
    assert case.words
    assert all(re.compile(words) for words in case.words)
