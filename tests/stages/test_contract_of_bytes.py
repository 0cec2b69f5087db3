"""What every driver that speaks bytes owes besides: scales, ports, faults of the line."""

import pytest

from sim.emulators.faults import KINDS, Fault, FaultSchedule
from stages.controller import Channel, Controller
from stages.drivers_by_name import driver_class
from stages.errors import DeviceError, PortUnavailable, StageError, StageUsageError
from stages.stage import Stage
from stages.states import AxisState
from tests.loops import loop_over
from tests.stages.benches import brisk, true_errors_um


def test_a_wrong_scale_shows_in_true_mm(bench, driver):
    """Driver and emulator convert separately: a lie in the bench file is a true error, or is refused."""
    wrong = {"lead_mm": 5.0, "steps_per_rev": 2500}  # 500 steps/mm built, 400 said
    if not driver_class(driver).counts_steps:
        with pytest.raises(StageError, match="steps"):
            bench(driver, sim=wrong, steps_per_mm=400.0)
        return
    made = bench(driver, sim=wrong).homed({"a": 40.0})
    datum_mm = made.world.true_mm("a")
    made.stage.move({"a": 90.0})
    assert made.world.true_mm("a") - datum_mm == pytest.approx(40.0, abs=0.1)


def test_a_screw_of_another_lead_is_driven_right(bench, driver):
    changes = {"steps_per_mm": 500.0} if driver_class(driver).counts_steps else {}
    made = bench(driver, sim={"lead_mm": 5.0, "steps_per_rev": 2500}, **changes).homed()
    assert max(map(abs, true_errors_um(made, (70.0, 55.0)))) <= 10.0


def test_another_program_on_the_port_is_refused(bench, driver):
    made = bench(driver)
    with pytest.raises(PortUnavailable, match="in use"):
        Stage.open(made.table, made.clock)


def test_only_a_controller_that_can_know_is_believed_to_be_referenced(bench, driver):
    made = bench(driver).homed({"a": 40.0})
    state = made.again().axis("a").state
    asks = driver_class(driver)._remembers_reference is not Controller._remembers_reference
    assert state is (AxisState.READY if asks else AxisState.UNREFERENCED)
    if state is AxisState.READY:
        assert made.stage.axis("a").position_mm == pytest.approx(40.0, abs=0.01)


def test_impossible_speed_is_refused_on_opening(bench, driver):
    if driver == "pi_gcs2":
        pytest.skip("the controller judges speeds itself, with error 8")
    with pytest.raises(StageUsageError, match=r"speed|mm/s"):
        bench(driver, speed_mm_s=9e6)


@loop_over("channel", ["", "9/9/9", "Q Q", "-1"])
def test_impossible_channel_is_refused(driver, channel):
    scale = 400.0 if driver_class(driver).counts_steps else None
    with pytest.raises(StageUsageError, match="channel"):
        driver_class(driver)("box", {channel: Channel(channel, scale)})


def beside_its_mark(made):
    """Where an axis can be sent close to where it stands after homing: most answers were looks at long ways."""
    made.stage.home()
    return {name: min(max(mm + 6.0, 12.0), 112.0) for name, mm in made.stage.where_mm().items()}


def run_through(made, targets_mm):
    """Home, two moves, a look; True if all of it succeeded, and then the truth must agree."""
    try:
        made.stage.connect("box")
        made.stage.home()
        made.stage.move(targets_mm)
        datum_mm = made.world.true_mm("a")
        made.stage.move({"a": targets_mm["a"] + 1.0})
        told_mm = made.stage.where_mm()
    except (StageError, DeviceError):
        return False
    assert abs(made.world.true_mm("a") - datum_mm - 1.0) <= 0.010
    assert told_mm["a"] == pytest.approx(targets_mm["a"] + 1.0, abs=0.010)
    assert told_mm["b"] == pytest.approx(targets_mm["b"], abs=0.010)
    return True


@pytest.mark.parametrize("fault", KINDS)
def test_one_fault_anywhere_ends_right_or_in_an_error(bench, driver, fault):
    """Never a wrong position taken for a right one; and nearly always the run goes on by itself.

    What is not repeated by itself is a reference run, because nobody asked for two.
    """
    made = bench(driver, **brisk(driver))
    targets_mm = beside_its_mark(made)
    answers, successes, met = range(1 + 2 * KINDS.index(fault), 70, 14), 0, 0
    for answer in answers:
        made.line.plug_in()
        made.line.faults = FaultSchedule([Fault(fault, answer, delay_s=0.8)], seed=answer)
        successes += run_through(made, targets_mm)
        met += bool(made.line.faults.met)
        if answer < 20:
            assert made.line.faults.met
        made.line.plug_in()
        made.clock.sleep_s(60.0)
    if fault == "unplug":
        assert successes == len(answers) - met  # there is no answer behind which a dead line goes unnoticed
    else:
        assert successes >= len(answers) - 1
