"""References of Thorlabs boxes: marks that restarts wipe out, reference runs, and what is believed of them."""

import pytest

from stages.errors import NotReferenced, StageError
from stages.states import AxisState


def test_a_box_homed_at_its_own_buttons_after_a_restart_is_not_believed(bench):
    """It is homed and rests, but who knows with what offset."""
    made = bench("thorlabs_apt").homed({"a": 60.0})
    made.line.power_cycle(0.3)
    made.clock.sleep_s(1.0)
    made.line.emulator.home_offset = 4000
    made.line.emulator.channel("bay1").homing = (2, 1, made.line.emulator.channel("bay1").homing[2], 4000)
    made.line.emulator.person_homes()
    made.clock.sleep_s(60.0)
    made.line.receive()
    assert made.stage.where_mm()["a"] is None
    with pytest.raises(NotReferenced):
        made.stage.move({"a": 50.0})
    assert made.again().axis("a").state is AxisState.UNREFERENCED
    made.stage.home()
    assert made.again().axis("a").state is AxisState.READY


def test_a_restart_between_the_last_look_and_the_move_is_noticed_at_once(bench, monkeypatch):
    """A box that comes up switched on drives to the target in a coordinate that means nothing."""
    made = bench("thorlabs_apt").homed({"a": 60.0})
    transact = made.controller._transact

    def restarted(data, *rest, **named):
        if named.get("moves"):
            made.line.power_cycle(0.0)
            made.line.emulator.channel("bay1").is_on = True
        return transact(data, *rest, **named)

    monkeypatch.setattr(made.controller, "_transact", restarted)
    stood_mm = made.world.true_mm("a")
    with pytest.raises(NotReferenced, match="stopped at once"):
        made.stage.move({"a": 40.0})
    made.clock.sleep_s(10.0)
    assert made.world.true_mm("a") == pytest.approx(stood_mm, abs=0.1)


def test_a_box_that_is_homed_no_more_is_not_believed_though_the_mark_is_there(bench):
    """A fault of its encoder, another program: it says so itself."""
    made = bench("thorlabs_apt").homed()
    made.line.emulator.channel("bay1").is_homed = False
    assert made.stage.where_mm() == {"a": None, "b": None}
    assert made.again().axis("a").state is AxisState.UNREFERENCED


def test_a_reference_run_that_is_set_otherwise_since_is_not_believed_by_the_next_program(bench):
    made = bench("thorlabs_apt").homed()
    channel = made.line.emulator.channel("bay1")
    channel.homing = (*channel.homing[:3], 1234)
    assert made.again().axis("a").state is AxisState.UNREFERENCED
    assert made.stage.axis("b").state is AxisState.READY


def test_a_box_that_keeps_no_mark_cannot_be_homed(bench, monkeypatch):
    made = bench("thorlabs_apt")
    deaf = property(lambda one: 5, lambda one, mark: None)
    monkeypatch.setattr(type(made.line.emulator.channel("bay1")), "relative", deaf, raising=False)
    with pytest.raises(StageError, match="restarts could not be noticed"):
        made.stage.home()
    assert made.world.true_mm("a") == pytest.approx(made.world.motors["a"].mechanics.power_up_mm, abs=0.03)


def test_a_box_that_keeps_its_flag_while_it_homes_and_begins_late_is_waited_for(bench, monkeypatch):
    made = bench("thorlabs_apt").homed({"a": 60.0})
    channel = made.line.emulator.channel("bay1")
    home = channel.home
    monkeypatch.setattr(
        type(channel),
        "home",
        lambda one: made.clock.at(made.clock.now_s() + 0.15, home) if one is channel else None,
    )
    monkeypatch.setattr(
        type(channel), "is_homed", property(lambda one: True, lambda one, homed: None), raising=False
    )
    made.stage.home(["a"])
    assert made.world.motors["a"].carriage_mm == pytest.approx(0.0, abs=0.06)


def test_a_reference_run_that_never_began_is_none(bench, monkeypatch):
    """Homed from before, with an offset that somebody has changed since."""
    made = bench("thorlabs_apt").homed({"a": 60.0})
    channel = made.line.emulator.channel("bay1")
    channel.homing = (*channel.homing[:3], 4000)
    monkeypatch.setattr(type(channel), "home", lambda one: None)
    with pytest.raises(StageError, match="did not begin its reference run"):
        made.stage.home(["a"])
    assert made.stage.where_mm()["a"] is None
    assert made.again().axis("a").state is AxisState.UNREFERENCED


def test_an_offset_after_the_switch_is_where_the_box_counts_from(bench):
    made = bench("thorlabs_apt", firmware={"home_offset": 1200})  # 3 mm
    made.stage.home()
    made.stage.move({"a": 20.0})
    assert made.world.motors["a"].carriage_mm == pytest.approx(23.0, abs=0.06)
