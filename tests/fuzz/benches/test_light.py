"""Laser and stages, used by two threads at random: no motion while light leaves, no light near glass or target."""

import pytest

from daq.timing.states import LaserState, LaserStateMachine
from tests.fuzz.amount import PATIENCE_S, seed, sequences
from tests.fuzz.benches.light import Playground, play
from tests.fuzz.benches.light_story import LightStory

PERSONS = ("run_key", "foreign_off", "laser_off", "door", "shut_door", "person_at_any_byte")
REFUSED = "202-119"  # this and the next are stories without `PERSONS`
LOST = "833-499"


@pytest.fixture
def without_persons(monkeypatch):
    """Stories as they were before somebody came to the keys and the door."""
    verbs = {name: weight for name, weight in LightStory.VERBS.items() if name not in PERSONS}
    monkeypatch.setattr(LightStory, "VERBS", verbs | {"stop_key": 1})
    monkeypatch.setattr(LightStory, "USUAL", LightStory.USUAL | {LaserState.SAFE: ("warm",)})
    monkeypatch.setattr("tests.fuzz.benches.laser.PERSON_AS_IT_FIRES", 0.0)


@pytest.mark.slow
def test_nothing_moves_while_light_leaves():
    books, found = play(range(30), "ci")
    assert not found, "\n".join(found)
    assert books["pulses"] > 80
    assert books["motions"] > 50


@pytest.mark.slow
@pytest.mark.timeout(PATIENCE_S)
def test_nothing_moves_while_light_leaves_in_2_000_sequences():
    """Five minutes of a core; `make fuzz` plays as many as wanted of another seed."""
    playground = Playground()
    for part in range(8):
        _, found = play(range(sequences(2_000) // 8), f"{seed('slow')} {part}", playground=playground)
        assert not found, "\n".join(found)


def test_a_box_that_takes_one_line_at_a_time_and_refuses_off_is_told_again_in_50_ms(monkeypatch, without_persons):
    """Its cable came back within a burst, and the first word over it was refused: one pair more, no second one."""
    story = Playground().tell(REFUSED, 14)
    assert not story.found, "\n".join(story.found)
    assert story.emulator.refused_off_s > 25.0
    monkeypatch.setattr("daq.timing.drivers.quantum_composers.PAUSE_S", 0.2)
    assert Playground().tell(REFUSED, 14).found


def test_a_reference_run_whose_answer_is_lost_ends_by_its_own_time(without_persons):
    """In 180 s, of which nothing is heard; no thread hangs."""
    story = Playground().tell(LOST, 14)
    assert not story.found, "\n".join(story.found)


NEAR = "daq.runner.laser_session.sheet_clearance_mm"
JUDGED = {  # what is taken away, so many stories of a seed, and what the judge says
    "one that lets things move": (
        (LaserStateMachine, "objection", lambda self: None),
        120,
        "moves e",
        " moves",
    ),
    "one that looks at nothing": ((LaserStateMachine, "what_moves", lambda self: None), 50, "looks c", " moves"),
    "light near the glass": ((NEAR, lambda bench, where: 100.0), 50, "near f", " off the sheet"),
}


@pytest.mark.parametrize("what", JUDGED)
def test_the_judge_sees(monkeypatch, what):
    patch, stories, of, words = JUDGED[what]
    monkeypatch.setattr(*patch)
    _, found = play(range(stories), of)
    assert any(line.startswith("a pulse") and line.endswith(words) for line in found), "\n".join(found)
