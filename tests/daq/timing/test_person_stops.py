"""A person ends the light at any exchange, byte or time of a run: it stays off, and the run ends with an error."""

from itertools import product

import pytest

from tests.daq.timing.person_stops import BOXES, DARKENS, HOWS, Run, listing, on_a_line, play
from tests.loops import loop_over

UNSEEN = "start"  # the string, or the six lines, that begin a burst; see `person_stops`


def require_dark(table):
    """No row of a listing has late pulses or an end without an error."""
    assert sum(row[0] for row in table.values()) > 0
    wrong = {moment: row for moment, row in table.items() if moment != UNSEEN and (row[1] or row[3])}
    assert not wrong


@loop_over("how", HOWS)
@loop_over("box", [box for box in BOXES if not {"all", "state", "2"} & {*box.split()}])
def test_nothing_leaves_after_a_person_has_ended_it(box, how):
    """A few moments of each box and way: together they fall into every phase of a run."""
    require_dark(listing(box, how, "write", 3))
    require_dark(listing(box, how, "time", 1))


DG645S = [(box, how) for box in BOXES if "dg645" in box for how in DARKENS]


@loop_over("box, how", DG645S)
def test_nothing_leaves_a_delay_generator_that_is_dark_for_another_reason(box, how):
    require_dark(listing(box, how, "byte", 8))


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("box", "how"), [*product(BOXES, HOWS), *DG645S])
def test_nothing_leaves_after_a_person_has_ended_it_at_every_exchange(box, how):
    table = listing(box, how)
    require_dark(table)
    if not box.endswith("slow"):  # one string, in which only another thread of the program can act, and is heard
        assert table.get(UNSEEN, [0, 0, 0, 0])[1::2] == [0, 0]
    require_dark(listing(box, how, "byte", 400))


def test_a_run_that_is_left_alone_gives_all_its_pulses():
    for box in ("lamps run", "diodes run all slow"):
        run = play(box, "STOP")
        assert run.error is None
        assert not run.late
        run.emulator.advance()
        assert [run.emulator.outputs.count[output] for output in sorted(run.lit)] == [60, 60]


def test_a_person_who_presses_run_has_released_it():
    """STOP and RUN in a pause, at the keys: the next chunk is whole."""
    with on_a_line(Run("lamps run", "STOP")) as run:
        run.begin()
        run.chunk(0)
        run.emulator.person_stops()
        run.clock.sleep_s(1.0)
        run.emulator.person_runs()
        run.chunk(1)
        assert {run.emulator.outputs.count[output] for output in run.lit} == {40}
