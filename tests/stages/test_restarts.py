"""A controller that restarts, at rest or in motion, is never believed again until it has been homed."""

from dataclasses import replace

import pytest

from sim.emulators.pi_gcs2 import StageMake
from stages.errors import (
    DeviceError,
    DeviceLost,
    MotionStopped,
    NoReply,
    NotReferenced,
    StageError,
    StageUsageError,
)
from stages.protocols.grbl import RESET, RESUME
from stages.states import AxisState
from tests.slow_cases import slow
from tests.stages.benches import brisk

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")


def homed(bench, driver, **changes):
    return bench(driver, **changes).homed({"a": 60.0, "b": 30.0})


@pytest.mark.parametrize("off_s", [slow(0.0), slow(0.02), slow(0.3), 2.0])
def test_at_rest(bench, kind, off_s):
    """Seen from outside only: whatever is asked first must not believe the old position."""
    asks = {
        "where": lambda stage: stage.where_mm()["a"],
        "position": lambda stage: stage.axis("a").position_mm,
        "state": lambda stage: stage.axis("a").state,
        "move": lambda stage: stage.move({"a": 40.0}),
        "the other axis": lambda stage: stage.move({"b": 40.0}),
    }
    for name, ask in asks.items():
        made = homed(bench, kind, **brisk(kind))
        made.line.power_cycle(off_s)
        made.clock.sleep_s(off_s + 0.5)
        stood_mm = made.world.true_mm("a"), made.world.true_mm("b")
        try:
            answer = ask(made.stage)
        except NotReferenced:
            answer = None
        assert answer in (None, AxisState.UNREFERENCED), name
        made.clock.sleep_s(5.0)
        assert (made.world.true_mm("a"), made.world.true_mm("b")) == stood_mm, name
        made.stage.home()
        made.stage.move({"a": 40.0})
        datum_mm = made.world.true_mm("a")
        made.stage.move({"a": 50.0})
        assert made.world.true_mm("a") - datum_mm == pytest.approx(10.0, abs=0.01), name


@pytest.mark.parametrize("after_s", [0.05, slow(0.4), 2.0, slow(2.65), 2.7, slow(2.75), 2.8, slow(2.9), 3.0])
def test_in_motion(bench, kind, after_s):
    """Also between the two legs of an arrival: nothing drives on in another coordinate."""
    made = homed(bench, kind)
    here_mm = made.world.true_mm("a")
    made.clock.at(made.clock.now_s() + after_s, lambda: made.line.power_cycle(0.3))
    with pytest.raises(StageError):
        made.stage.move({"a": 10.0})
    rests_mm = made.world.true_mm("a")
    assert 9.4 <= rests_mm <= here_mm + 0.1
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") == rests_mm
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_while_homing(bench, kind):
    made = bench(kind, sim={"power_up_mm": 39.0})
    made.clock.at(made.clock.now_s() + 0.5, lambda: made.line.power_cycle(0.3))
    with pytest.raises(StageError):
        made.stage.home()
    assert made.stage.where_mm()["b"] is None
    if made.controller.is_lost:  # a library that has failed
        made.clock.sleep_s(1.0)
        made.stage.connect("box")
    made.stage.home()
    made.stage.move({"a": 50.0})


def test_home_works_right_after_a_restart_that_nobody_noticed(bench, kind):
    made = homed(bench, kind)
    made.line.power_cycle(0.3)
    made.clock.sleep_s(2.0)
    made.stage.home()
    assert made.stage.where_mm()["a"] is not None


@pytest.mark.parametrize("cut", [1, 2, 3, 8, 15, 22, 23, 24])
def test_a_banner_in_two_pieces_is_a_banner(bench, cut):
    """The first piece is read as unasked bytes, the second with the next answer; alarm and mark are mute here."""
    made = homed(bench, "grbl")
    made.line.emulator.settings[22] = 0  # so that it stands in Idle after the restart
    made.controller._mark = None
    made.line.power_cycle(0.0)
    banner, pending = made.line.receive(), made.controller.port.pending
    pieces = [banner[:cut], banner[cut:]]

    def in_pieces():
        return pieces.pop(0) if pieces else pending()

    made.controller.port.pending = in_pieces
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_a_board_unlocked_at_a_pendant_is_not_believed(bench):
    """Neither banner nor alarm reach us: only the mark tells."""
    made = homed(bench, "grbl")
    made.line.power_cycle(0.0)
    made.line.send(b"$X\n")
    made.clock.sleep_s(0.5)
    made.line.receive()
    assert made.stage.where_mm() == {"a": None, "b": None}
    with pytest.raises(NotReferenced):
        made.stage.move({"a": 40.0})


def test_what_keeps_its_reference_over_power_is_believed(bench):
    """An absolute encoder knows where it is: homing it again would be a motion that nobody needs."""
    made = bench("pi_gcs2", firmware={"stages": StageMake(absolute_encoders=True)}).homed({"a": 60.0})
    made.line.power_cycle(0.3)
    made.clock.sleep_s(1.0)
    assert made.stage.where_mm()["a"] == pytest.approx(60.0, abs=0.01)
    made.stage.move({"a": 40.0})
    assert made.stage.where_mm()["a"] == pytest.approx(40.0, abs=0.01)


def test_a_person_at_the_box_stops_the_bench(bench, kind):
    """A feed hold, a stop key, a knob: the move has ended, and nothing drives on until somebody clears it."""
    made = homed(bench, kind)
    made.clock.at(made.clock.now_s() + 1.0, made.line.emulator.person_stops)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 110.0, "b": 50.0})
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    assert rests_mm[0] < 100.0
    for again in (
        lambda: made.stage.move({"b": 50.0}),
        lambda: made.stage.home(),
        lambda: made.stage.axis("a").home(),
    ):
        with pytest.raises(MotionStopped, match="clear"):
            again()
    made.clock.sleep_s(10.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm


def test_a_person_at_the_box_stops_a_reference_run_for_good(bench, kind):
    """What outranks the knob in the answer must not hide it.

    A Grbl board ignores a feed hold then, but not a reset.
    """
    made = bench(kind, sim={"power_up_mm": 100.0})
    box = made.line.emulator
    made.clock.at(made.clock.now_s() + 0.3, (lambda: box.button(RESET)) if kind == "grbl" else box.person_stops)
    with pytest.raises(MotionStopped):
        made.stage.home()
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    with pytest.raises(MotionStopped, match="clear"):
        made.stage.home()
    made.clock.sleep_s(10.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm


@pytest.mark.parametrize(
    ("of_kind", "power_up_mm", "before_mm"),
    [("zaber_ascii", 100.0, 5.0), ("zaber_ascii", 100.0, 20.0),
     ("thorlabs_apt", 60.0, 0.2), ("thorlabs_apt", 60.0, 5.0), ("thorlabs_apt", 60.0, 20.0)],
)  # fmt: skip
def test_a_person_who_stops_too_late_for_the_switch_has_stopped(bench, of_kind, power_up_mm, before_mm):
    """A reference run that is stopped so close to the switch that it brakes into it: the limit hides the knob."""
    made = bench(of_kind, sim={"power_up_mm": power_up_mm})
    box, motor, is_zaber = made.line.emulator, made.world.motors["a"], of_kind == "zaber_ascii"
    if is_zaber:
        box.axis(1, 1).settings["accel"] = 1  # a long way of braking

    def press():
        box.advance()
        if motor.carriage_mm - motor.mechanics.low_switch_mm < before_mm:
            if not is_zaber:
                box.channel("bay1").speeds = (0, 5, 10**6)  # a long way of braking
            box.person_stops()
        else:
            made.clock.at(made.clock.now_s() + 0.001, press)

    made.clock.at(made.clock.now_s() + 0.1, press)
    with pytest.raises(MotionStopped):
        made.stage.home()
    assert not is_zaber or "WL" in box.axis(1, 1).flags
    assert made.stage.is_held
    assert made.stage.where_mm()["a"] is None


def test_a_jog_that_a_held_board_has_not_read_never_runs(bench):
    """Somebody holds the board just before the jog, and releases it when the program has long given up."""
    made = bench("grbl").homed({"a": 60.0})
    transact = made.controller._transact

    def held_before_the_jog(data, *rest, **named):
        if data.startswith(b"$J"):
            made.line.emulator.person_stops()
        return transact(data, *rest, **named)

    made.controller._transact = held_before_the_jog
    rests_mm = made.world.true_mm("a")
    with pytest.raises(MotionStopped, match="held"):
        made.stage.move({"a": 10.0})
    assert made.stage.is_held
    made.line.emulator.button(RESUME)
    made.clock.sleep_s(10.0)
    assert made.world.true_mm("a") == rests_mm


def test_a_banner_from_before_a_reference_run_does_not_leave_it_alone(bench):
    """The board was reset a moment before $H: its banner comes while it homes, and nobody would watch it more."""
    made = bench("grbl", sim={"power_up_mm": 100.0})
    clear_line = made.controller._clear_line

    def reset_behind_the_last_look():
        clear_line()
        made.line.emulator.button(RESET)

    made.controller._clear_line = reset_behind_the_last_look
    with pytest.raises(StageError):
        made.stage.home()
    made.controller._clear_line = clear_line
    rests_mm = made.world.true_mm("a"), made.world.true_mm("b")
    made.clock.sleep_s(30.0)
    assert (made.world.true_mm("a"), made.world.true_mm("b")) == rests_mm


def test_a_zaber_axis_that_moves_by_itself_tells_no_position(bench):
    """A motion that a killed program has begun, or a knob: slow enough that two readings agree."""
    made = bench("zaber_ascii").homed({"a": 60.0})
    made.line.send(b"/1 1 7 set maxspeed 200\n")
    made.line.send(b"/1 1 8 move abs 30000\n")
    made.clock.sleep_s(0.2)
    made.line.receive()
    assert made.stage.where_mm()["a"] is None
    with pytest.raises(StageUsageError, match="wait until it stops"):
        made.stage.move({"a": 30.0})


def test_the_second_leg_of_an_arrival_is_not_driven_by_a_box_that_has_restarted(bench, kind, mocker):
    """Right behind the first leg: what is still on its way there would end in another coordinate."""
    made = homed(bench, kind)
    begin, wait, begun = made.controller.start_move, made.stage.axis("a")._wait, []

    def restarts_behind_the_leg(limit_s, token):
        wait(limit_s, token)
        mocker.patch.object(made.controller, "_still_referenced", return_value=False)

    mocker.patch.object(made.controller, "start_move", side_effect=lambda *way: (begun.append(way), begin(*way)))
    mocker.patch.object(made.stage.axis("a"), "_wait", side_effect=restarts_behind_the_leg)
    with pytest.raises(NotReferenced):
        made.stage.move({"a": 40.0})
    assert len(begun) == 1


def test_what_moved_when_its_port_was_lost_is_stopped_as_soon_as_it_is_open_again(bench, driver):
    """The box goes on without its cable."""
    made = homed(bench, driver)
    made.clock.at(made.clock.now_s() + 0.5, made.line.unplug)
    with pytest.raises(DeviceLost):
        made.stage.move({"a": 110.0})
    with pytest.raises(DeviceLost, match="may move still"):  # into whose way another axis would be homed
        made.stage.home()
    made.line.plug_in()
    made.stage.connect("box")
    made.clock.sleep_s(0.5)
    rests_mm = made.world.true_mm("a")
    assert rests_mm < 105.0
    made.clock.sleep_s(10.0)
    assert made.world.true_mm("a") == rests_mm
    made.stage.home()


@pytest.mark.parametrize("code", [1, 3, 4, 5, 6, 7, 8, 9])
def test_an_alarm_takes_the_reference_of_a_grbl_board_although_its_mark_has_stayed(bench, code):
    """An alarm that somebody has ended at a pendant: no restart, no mark wiped out, but steps may be lost."""
    made = homed(bench, "grbl")
    made.line.emulator.say(b"ALARM:%d\r\n" % code)
    made.line.emulator._work()
    made.clock.sleep_s(0.1)
    assert made.stage.where_mm() == {"a": None, "b": None}
    rests_mm = made.world.true_mm("a")
    with pytest.raises(StageError):
        made.stage.move({"a": 40.0})
    made.clock.sleep_s(5.0)
    assert made.world.true_mm("a") == rests_mm


@pytest.mark.parametrize("state", ["Hold", "Door"])
def test_a_board_that_reports_to_be_held_in_a_move_was_stopped_by_a_person(bench, mocker, state):
    """A stop of the whole bench, not an error of one axis: nothing moves before somebody clears it."""
    made = homed(bench, "grbl")
    status, held_s = made.controller._status, made.clock.now_s() + 0.5

    def held():
        said = status()
        return replace(said, state=state, substate=0) if made.clock.now_s() > held_s else said

    made.clock.at(held_s, made.line.emulator.person_stops)
    mocker.patch.object(made.controller, "_status", side_effect=held)
    with pytest.raises(MotionStopped, match="held at the board"):
        made.stage.move({"a": 110.0})
    assert made.stage.is_held
    mocker.stopall()
    with pytest.raises(MotionStopped, match="clear"):
        made.stage.move({"b": 50.0})


def test_a_grbl_board_that_stands_in_alarm_is_not_believed_although_its_mark_has_stayed(bench):
    """The line of the alarm was lost; the report still says it, and afterwards somebody unlocks the board."""
    made = homed(bench, "grbl")
    made.line.emulator._state = "Alarm"
    assert made.stage.where_mm()["a"] is None
    made.line.emulator._state = "Idle"
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_a_jog_that_a_locked_grbl_board_refuses_takes_its_reference(bench):
    """Locked between the look at its position and the jog, and unlocked at a pendant right behind it."""
    made = homed(bench, "grbl")
    transact = made.controller._transact

    def locked_for_a_moment(data, *rest, **named):
        jogs = data.startswith(b"$J")
        made.line.emulator._state = "Alarm" if jogs else made.line.emulator._state
        answer = transact(data, *rest, **named)
        if jogs:
            made.line.emulator._state = "Idle"
        return answer

    made.controller._transact = locked_for_a_moment
    rests_mm = made.world.true_mm("a")
    with pytest.raises(NotReferenced, match="locked"):
        made.stage.move({"a": 40.0})
    assert made.stage.where_mm() == {"a": None, "b": None}
    assert made.world.true_mm("a") == rests_mm


@pytest.mark.parametrize("asks", [
    lambda stage: stage.where_mm(),
    lambda stage: stage.move({"a": 40.0}),
    lambda stage: stage.axis("a").home(),
    lambda stage: stage.controllers["box"].confirm_reference("X"),
])  # fmt: skip
def test_a_feed_hold_at_rest_is_named_and_over_when_it_is_released(bench, asks):
    """Grbl 1.1 in Hold obeys no line and reports <Hold:0> to every `?` (real firmware; interface.md)."""
    made = homed(bench, "grbl")
    made.line.emulator.person_stops()
    stood_mm = made.world.true_mm("a")
    for _ in range(3):
        with pytest.raises(DeviceError, match=r"box is held at the board \(Hold:0\) .* release it there"):
            asks(made.stage)
    made.line.emulator.button(RESUME)
    made.clock.sleep_s(1.0)
    assert made.world.true_mm("a") == stood_mm
    made.stage.clear_stop()
    if made.stage.where_mm()["a"] is None:  # a reference run was asked for
        made.stage.home()
    made.stage.move({"a": 40.0})
    assert made.stage.where_mm()["a"] == pytest.approx(40.0, abs=0.01)


def test_a_held_board_is_named_when_it_is_opened(bench):
    made = homed(bench, "grbl")
    made.line.emulator.person_stops()
    made.controller.close()
    with pytest.raises(DeviceError, match="is held at the board"):
        made.controller.connect(made.table.controllers["box"].port)


def test_an_alarm_while_a_reference_run_is_brought_to_rest_leaves_the_axis_to_be_homed(bench, mocker):
    """An answer is lost while it homes, and a limit switch is met while it is calmed: no axis homes for ever."""
    made = bench("grbl", sim={"power_up_mm": 100.0})
    moving, looks = made.controller.moving, []

    def unheard_then_alarm(channel):
        looks.append(channel)
        if len(looks) == 3:
            raise NoReply("lost")
        if len(looks) == 4:
            raise DeviceError("alarm 9, homing found no switch")
        return moving(channel)

    mocker.patch.object(made.controller, "moving", side_effect=unheard_then_alarm)
    with pytest.raises(DeviceError, match="alarm 9"):
        made.stage.axis("a").home()
    assert made.stage.axis("a").state is AxisState.UNREFERENCED
    mocker.stopall()
    made.clock.sleep_s(30.0)
    made.stage.axis("a").home()
    assert made.stage.axis("a").state is AxisState.READY
