"""Sequences in which the fuzz once found something: they show nothing any more."""

import pytest

from tests.safety.fuzz import Playground
from tests.safety.sequences import drawn

FOUND = {
    "a knob pressed so late that the axis brakes into the switch": ("last", 724),
    "a person's stop at a mute box whose one word is lost": ("slow", 2257),
    "a knob pressed while a broken answer is being recovered from": ("20261122b", 35405),
    "a reference run beside a motion whose port was lost": ("20261122d", 82814),
}


@pytest.mark.parametrize("what", FOUND)
def test_what_was_found_shows_nothing(what):
    assert Playground(longest_s=0).play(drawn(*FOUND[what])).findings == []
