"""A late answer is never taken for the answer to the next question: 200 seeded schedules over all drivers.

The two axes rest at different, always new places, so an answer credited to the wrong question is a wrong position.
The judge is the true carriage, not the emulator's counter.
"""

import random

import pytest

from sim.emulators.faults import Fault, FaultSchedule
from stages.drivers_by_name import DRIVERS
from stages.errors import NoReply, ProtocolViolation, StageError
from tests.stages.benches import brisk

SCHEDULES = 200 // len(DRIVERS)


def schedule(seed):
    """Up to three late answers among the next thirty; some later than a question waits, some much later."""
    rng = random.Random(seed)
    return FaultSchedule(
        [Fault("late", rng.randrange(30), delay_s=rng.choice([0.3, 0.55, 0.7, 1.1, 2.6])) for _ in range(3)], seed
    )


def offsets_mm(made):
    """Told minus true of both axes with an undisturbed line: play and reference, constant from one side."""
    told_mm = made.stage.where_mm()
    return {name: told_mm[name] - made.world.true_mm(name) for name in told_mm}


def test_a_late_answer_is_never_credited_to_the_next_question(bench, driver):
    made = bench(driver, **brisk(driver)).homed({"a": 30.0, "b": 80.0})
    constant_mm = offsets_mm(made)
    rng = random.Random(driver)
    answered = timed_out = 0
    for seed in range(SCHEDULES):
        made.line.faults = schedule(seed)
        for _ in range(4):
            name = rng.choice("ab")
            try:
                if rng.random() < 0.3:
                    made.stage.move({name: rng.uniform(10.0, 110.0)})
                told_mm = made.stage.axis(name).position_mm
            except (NoReply, ProtocolViolation):
                timed_out += 1
                continue
            answered += 1
            assert told_mm - made.world.true_mm(name) == pytest.approx(constant_mm[name], abs=0.010), seed
        made.line.plug_in()
        made.controller.abandon()
    assert answered > 3 * SCHEDULES
    assert timed_out < SCHEDULES / 10


def test_the_schedules_do_make_questions_time_out(bench, driver):
    """Without repeating, the same schedules are felt; otherwise the test above would prove nothing."""
    made = bench(driver).homed()
    felt = 0
    made.controller._ask_again = lambda ask: ask()
    for seed in range(10):
        made.line.faults = schedule(seed)
        for _ in range(6):
            try:
                made.controller.position_mm(made.table.axes["a"].channel)
            except StageError:
                felt += 1
        made.line.plug_in()
        made.controller.abandon()
    assert felt >= 5
