"""What everything that moves owes, on its emulator, judged by where the simulated carriage really is."""

import math
import random
import re

import pytest

from stages.drivers_by_name import FOREIGN, controller_class
from stages.errors import (
    AxisStalled,
    DeviceLost,
    LimitHit,
    MotionStopped,
    NotReferenced,
    OutOfRange,
    PortUnavailable,
    WrongDevice,
)
from stages.states import AxisState
from tests.stages.benches import true_errors_um

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
TARGETS_MM = (60.0, 20.0, 61.5, 61.6, 61.55, 110.0, 30.25, 30.2)


def test_opening_moves_nothing_and_knows_who_answers(bench, kind):
    made = bench(kind)
    assert re.search(r"\w{3}", made.controller.identity)
    before_mm = made.world.true_mm("a")
    made.clock.sleep_s(10.0)
    assert made.world.true_mm("a") == before_mm
    assert made.stage.axis("a").state is AxisState.UNREFERENCED


def test_no_absolute_move_before_homing(bench, kind):
    made = bench(kind)
    before_mm, before = made.world.true_mm("a"), made.sent
    with pytest.raises(NotReferenced, match="home it"):
        made.stage.move({"a": 50.0})
    assert made.sent == before
    assert made.world.true_mm("a") == before_mm
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_true_position_within_10_um_despite_50_um_backlash(bench, kind):
    made = bench(kind, sim={"lead_error_um": 1.0, "power_up_mm": 75.0}).homed()
    errors = true_errors_um(made, TARGETS_MM)
    assert max(map(abs, errors)) <= 10.0
    positions = [random.Random(4).uniform(10.0, 115.0) for _ in range(10)]
    assert max(map(abs, true_errors_um(made, positions))) <= 10.0


def test_from_above_works_as_well(bench, kind):
    made = bench(kind, approach={"side": "from_above", "distance_mm": 0.3, "speed_mm_s": 1.0}).homed()
    assert max(map(abs, true_errors_um(made, TARGETS_MM))) <= 10.0


def test_without_approach_the_backlash_shows(bench, kind):
    """The judge must be able to see what the compensation removes."""
    made = bench(kind, approach=None).homed()
    assert max(map(abs, true_errors_um(made, TARGETS_MM))) > 40.0


def test_opposite_sign_and_offset_turn_the_coordinate(bench, kind):
    straight = bench(kind)
    offset_mm = straight.table.axes["a"].offset_mm
    turned = bench(kind, sign=-1, offset_mm=125.0 - offset_mm)
    turned.stage.home()
    turned.stage.move({"a": 40.0})
    forty_mm = turned.world.motors["a"].carriage_mm
    turned.stage.move({"a": 50.0})
    assert turned.world.motors["a"].carriage_mm - forty_mm == pytest.approx(-10.0, abs=0.01)
    assert turned.world.true_mm("a") - turned.world.true_mm("b") != 0.0


def test_targets_out_of_range_raise_before_motion(bench, kind):
    made = bench(kind).homed({"a": 50.0})
    before_mm, before = made.world.true_mm("a"), made.sent
    for target_mm in (math.nan, math.inf, -math.inf, 4.999, 120.001, 5.1, -1e300):
        with pytest.raises(OutOfRange):
            made.stage.move({"b": 60.0, "a": target_mm})
        with pytest.raises(OutOfRange):
            made.stage.axis("a").move_to(target_mm)
        assert made.sent == before, target_mm
        assert made.world.true_mm("a") == before_mm, target_mm


def test_stop_at_rest_is_harmless(bench, kind):
    made = bench(kind)
    for end in (made.stage.stop, made.stage.halt):
        end()
        made.stage.clear_stop()
        made.stage.home()
        end()
        end()
        made.stage.clear_stop()
        assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0
        end()
    made.stage.stop()
    assert made.stage.axis("a").state is AxisState.READY
    assert made.stage.axis("a").position_mm == pytest.approx(60.0, abs=0.01)


def test_stop_ends_a_move_and_leaves_the_axis_usable(bench, kind):
    made = bench(kind).homed({"a": 10.0})
    waits_mm = made.world.true_mm("b")
    made.clock.at(made.clock.now_s() + 2.0, made.stage.stop)
    begun_s = made.clock.now_s()
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 110.0, "b": 50.0})
    assert made.clock.now_s() - begun_s < 3.0
    rests_mm = made.world.true_mm("a")
    assert 20.0 < rests_mm < 90.0
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") == rests_mm
    assert made.world.true_mm("b") == waits_mm  # the second axis of the move never began
    assert made.stage.axis("a").state is AxisState.READY
    with pytest.raises(MotionStopped, match="clear"):
        made.stage.move({"a": 60.0})
    made.stage.clear_stop()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0


def test_stop_during_homing(bench, kind):
    made = bench(kind, sim={"power_up_mm": 112.0})
    made.clock.at(made.clock.now_s() + 0.3, made.stage.stop)
    with pytest.raises(MotionStopped):
        made.stage.home()
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    made.clock.sleep_s(30.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm
    assert made.stage.axis("b").state is AxisState.UNREFERENCED
    made.stage.clear_stop()
    made.stage.home()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0


def test_limit_switch_ends_the_move_and_the_trust(bench, kind):
    made = bench(kind).homed({"a": 50.0})
    motor = made.world.motors["a"]
    with_switch_mm = motor.carriage_mm + 30.0
    motor.mechanics = type(motor.mechanics)(
        **{name: getattr(motor.mechanics, name) for name in motor.mechanics.__slots__}
        | {"high_switch_mm": with_switch_mm}
    )
    with pytest.raises(MotionStopped if kind in FOREIGN else LimitHit, match="home"):
        made.stage.move({"a": 110.0})
    made.stage.clear_stop()  # a library does not say why a stage rests, so it might have been a person
    assert motor.carriage_mm == pytest.approx(with_switch_mm, abs=0.5)
    assert made.stage.axis("a").state is AxisState.UNREFERENCED
    with pytest.raises(NotReferenced):
        made.stage.move({"a": 50.0})
    made.stage.home()
    assert made.stage.axis("a").state is AxisState.READY


def test_stall_is_reported_or_found_by_homing(bench, kind):
    made = bench(kind).homed({"a": 40.0})
    datum_mm = made.world.true_mm("a")
    motor = made.world.motors["a"]
    motor.obstacle_mm = motor.carriage_mm + 20.0
    if controller_class(kind).senses_stall:
        with pytest.raises(AxisStalled, match="home"):
            made.stage.move({"a": 90.0})
        assert made.world.true_mm("a") - datum_mm == pytest.approx(20.0, abs=0.1)
        assert made.stage.axis("a").state is AxisState.UNREFERENCED
        with pytest.raises(NotReferenced):
            made.stage.move({"a": 50.0})
    else:  # no encoder: nobody can know, and the documentation says so
        made.stage.move({"a": 90.0})
        assert made.world.true_mm("a") - datum_mm == pytest.approx(20.0, abs=0.1)
    motor.obstacle_mm = None
    made.stage.home()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0


def test_unplugged_in_motion(bench, kind):
    made = bench(kind).homed({"a": 10.0})
    pulled_s = made.clock.now_s() + 2.0
    made.clock.at(pulled_s, made.line.unplug)
    with pytest.raises(DeviceLost):
        made.stage.move({"a": 110.0})
    assert made.clock.now_s() - pulled_s <= 0.5
    axis = made.stage.axis("a")
    assert axis.state is AxisState.LOST
    with pytest.raises(DeviceLost, match="plug it in"):
        axis.move_to(50.0)
    with pytest.raises(PortUnavailable):
        made.stage.connect("box")
    made.line.plug_in()
    made.clock.sleep_s(30.0)
    made.stage.connect("box")
    assert axis.state is AxisState.UNREFERENCED
    with pytest.raises(NotReferenced):
        axis.move_to(50.0)
    made.stage.home()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0


def test_another_device_after_a_loss_is_refused(bench, kind):
    made = bench(kind)
    made.controller.identity = "somebody else"
    with pytest.raises(WrongDevice, match="cables"):
        made.stage.connect("box")
