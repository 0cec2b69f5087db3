"""A laser that somebody else uses at random: no pulse in a state that has none, whatever happens to its line."""

import pytest

from daq.timing.box import TimingBox
from daq.timing.drivers.quantum_composers import QuantumComposersBox
from daq.timing.laser import Laser
from daq.timing.states import Event, LaserState
from sim.emulators.protocol_sim import LINES
from tests.fuzz.benches.laser import Story, play


def test_no_pulse_that_was_not_asked_for():
    books, found = play(75, "ci")
    assert not found, "\n".join(found)
    assert books["pulses"] > 250
    assert books["bursts"] > 15


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_no_pulse_in_4_000_sequences():
    """Two minutes of a core; `make fuzz` plays as many as wanted of another seed."""
    books, found = play(4_000, "1")
    assert not found, "\n".join(found)
    assert books["sequences"] == 4_000


def says_nothing(self, *_):
    """A stop that reaches nobody."""


def test_the_judge_sees_a_stop_that_does_not_switch_off(monkeypatch):
    monkeypatch.setattr(TimingBox, "drop", says_nothing)
    _, found = play(200, "blind 11")
    assert any("while unknown" in line for line in found)


def test_the_judge_sees_a_state_that_goes_ahead_of_the_box(monkeypatch):
    monkeypatch.setattr(Laser, "look", ends_early)
    _, found = play(200, "early 12")
    assert any("while ready" in line for line in found)


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


def test_the_judge_sees_an_end_that_comes_late(monkeypatch):
    monkeypatch.setattr(QuantumComposersBox, "end", ends_late)
    _, found = play(300, "late 27")
    assert any("after the time of its chunk" in line for line in found), found


def ends_late(box, end=QuantumComposersBox.end):
    box.clock.sleep_s(0.5)
    end(box)


def ends_early(laser):
    if laser.state is LaserState.FIRING:
        laser._enter(Event.DONE)
    return False


def test_the_judge_sees_a_laser_that_is_given_up_while_its_cable_is_loose(monkeypatch):
    monkeypatch.setattr("daq.timing.shutdown.LEAVING_S", 0.0)
    _, found = play(20, "loose 11")
    assert found[-1:] == ["something is on after the end"]


def test_the_judge_sees_a_door_that_holds_the_laser_only_while_it_is_open(monkeypatch):
    monkeypatch.setattr(Laser, "switch_opened", says_nothing)
    _, found = play(60, "door")
    assert any("after a person has ended the light" in line for line in found), found


def test_the_judge_sees_a_burst_that_undoes_a_stop(monkeypatch):
    monkeypatch.setattr(QuantumComposersBox, "require_lamps", says_nothing)
    monkeypatch.setattr(QuantumComposersBox, "_start", QuantumComposersBox._start_slowly)
    _, found = play(200, "undone 15")
    assert any("after a person has ended the light" in line for line in found), found
