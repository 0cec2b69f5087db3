"""A laser that somebody else uses at random: no pulse in a state that has none, whatever happens to its line."""

import pytest

from daq.timing.box import TimingBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.laser import Laser
from daq.timing.states import Event, LaserState
from sim.emulators.protocol_sim import LINES
from tests.fuzz.amount import PATIENCE_S, seed, sequences
from tests.fuzz.benches.laser import Story, play


def test_no_pulse_that_was_not_asked_for():
    books, found = play(75, "ci")
    assert not found, "\n".join(found)
    assert books["pulses"] > 250
    assert books["bursts"] > 15


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE_S)
def test_no_pulse_in_4_000_sequences():
    """A minute of a core; `make fuzz` plays as many as wanted of another seed."""
    _, found = play(sequences(4_000), seed("1"))
    assert not found, "\n".join(found)


def says_nothing(self, *_):
    """A stop that reaches nobody."""


def test_the_judge_sees_a_burst_whose_end_is_left_to_the_box(monkeypatch):
    """A knob has made it endless, and the cable is in."""
    assert not any(map(endless, range(10)))
    monkeypatch.setattr(QuantumComposersBox, "end", says_nothing)
    assert any("while ready" in line for number in range(10) for line in endless(number))


def endless(number):
    """What the judge finds in a burst that is made endless at the keys, and waited for."""
    story = Story(f"endless {number}")
    story.begin()
    story.do("warm")
    story.clock.sleep_s(6.0)
    for name in ("set", "set", "arm", "fire", "endless", "wait", "sleep"):
        story.do(name)
    LINES.pop(story.address)
    return story.found


def ends_late(box, end=QuantumComposersBox.end):
    box.clock.sleep_s(0.5)
    end(box)


def ends_early(laser):
    if laser.state is LaserState.FIRING:
        laser._enter(Event.DONE)
    return False


AFTER_A_PERSON = "after a person has ended the light"
JUDGED = {  # what is taken away, so many stories of a seed, and what the judge says
    "a stop that does not switch off": ([(TimingBox, "drop", says_nothing)], 200, "blind 11", "while unknown"),
    "a state that goes ahead of the box": ([(Laser, "look", ends_early)], 200, "early 12", "while ready"),
    "an end that comes late": ([(QuantumComposersBox, "end", ends_late)], 300, "late 27", "after the time of its"),
    "a laser that is given up while its cable is loose": (
        [("daq.timing.shutdown.LEAVING_S", 0.0)], 20, "loose 11", "something is on after the end",
    ),
    "a door that holds the laser only while it is open": (
        [(Laser, "switch_opened", says_nothing)], 60, "door", AFTER_A_PERSON,
    ),
    "a burst that undoes a stop": (
        [(QuantumComposersBox, "require_lamps", says_nothing),
         (QuantumComposersBox, "_start", QuantumComposersBox._start_slowly)], 200, "undone 15", AFTER_A_PERSON,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", JUDGED)
def test_the_judge_sees(monkeypatch, what):
    patches, stories, of, words = JUDGED[what]
    for patch in patches:
        monkeypatch.setattr(*patch)
    _, found = play(stories, of)
    assert any(words in line for line in found), found
