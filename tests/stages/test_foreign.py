"""Stages behind the library of others: calls that hang, lie or come late, and persons who say where they stand."""

import math
import subprocess
import sys
import threading
import time

import pytest

from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.drivers_by_name import FOREIGN
from stages.errors import (
    DeviceError,
    DeviceLost,
    MotionStopped,
    NotReferenced,
    OutOfRange,
    StageError,
    StageUsageError,
)
from stages.stage import Stage
from stages.states import AxisState
from tests.loops import loop_over
from tests.stages.benches import BOXES, screws, stages_table, true_errors_um

pytestmark = pytest.mark.filterwarnings("ignore:.* is moved by:RuntimeWarning")
CALL_S = 1.5  # a library that is not hung may wait for the processor: 0.3 s were once too few


@pytest.fixture(params=FOREIGN)
def library(request):
    return request.param


@pytest.fixture
def made(bench, library):
    made = bench(library, box={"call_s": CALL_S}).homed({"a": 20.0, "b": 20.0})
    return made


@pytest.fixture
def hang(made):
    """Make a call of the library hang until the end of the test, or until it is let go."""
    until = threading.Event()

    def hang(call):
        made.line.emulator.hangs[call] = until
        return until

    yield hang
    until.set()


def in_library():
    return [thread for thread in threading.enumerate() if thread.name == "library of box"]


@pytest.mark.parametrize("call", ["send", "read", "busy", "home"])
def test_a_call_that_never_returns_is_an_error_within_its_deadline(made, hang, call):
    hang(call)
    begun_s = time.monotonic()
    with pytest.raises(DeviceLost, match="has not answered"):
        made.stage.home() if call == "home" else made.stage.move({"a": 60.0})
    assert time.monotonic() - begun_s < CALL_S + 1.0  # the machine may be busy
    assert made.stage.axis("a").state is AxisState.LOST
    assert made.stage.where_mm() == {"a": None, "b": None}
    begun_s = time.monotonic()
    for ask in (lambda: made.stage.move({"b": 30.0}), made.stage.home, lambda: made.stage.connect("box")):
        with pytest.raises(DeviceLost):
            ask()
    made.stage.stop()
    assert time.monotonic() - begun_s < 1.0
    assert len(in_library()) == 1  # nobody was sent after the first
    begun_s = time.monotonic()
    made.stage.close()
    assert time.monotonic() - begun_s < CALL_S


def test_what_comes_back_late_is_stopped_and_the_library_left(made, hang):
    until = hang("send")
    with pytest.raises(DeviceLost):
        made.stage.axis("a").move_to(100.0)  # nobody halts the bench for it
    made.line.emulator.hangs.clear()
    until.set()
    for thread in in_library():
        thread.join(5.0)
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") < 21.0
    assert not in_library()
    made.stage.connect("box")
    assert made.stage.axis("a").state is AxisState.UNREFERENCED
    made.stage.home()
    assert max(map(abs, true_errors_um(made, (60.0,)))) <= 10.0


def test_a_stop_does_not_wait_for_a_call_and_is_said_after_it(made, hang):
    """The call in progress is given up soon after a stop, and what waits behind it is never begun."""
    until = hang("send")
    failed = []

    def move():
        try:
            made.stage.move({"a": 100.0})
        except StageError as error:
            failed.append(error)

    mover = threading.Thread(target=move)
    mover.start()
    time.sleep(0.05)
    begun_s = time.monotonic()
    made.stage.stop()
    assert time.monotonic() - begun_s < 0.25  # less than the call may take
    until.set()
    mover.join(5.0)
    assert isinstance(failed[0], MotionStopped)
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") < 21.0
    made.stage.clear_stop()
    made.stage.move({"a": 50.0})


def test_the_others_are_told_to_stop(bench, mocker):
    """A rail on its own port beside a library that hangs."""
    axis = stages_table("pi_gcs2").model_dump(exclude_unset=True)["axes"]["a"]
    glass = {**BOXES["micromanager"][0], "call_s": CALL_S}
    table = {
        "controllers": {"rail": {"driver": "pi_gcs2", "port": "a"}, "box": glass},
        "axes": {
            "rail": {**axis, "controller": "rail", "channel": "1"},
            "glass": {**axis, "controller": "box", "channel": "XY/x"},
        },
        "home_order": ["rail", "glass"],
    }
    clock, config = VirtualClock(), StagesTable.model_validate(table)
    world = SimulatedStages(config, clock, screws(config))
    with world.in_process() as offered, Stage.open(offered, clock) as stage:
        stage.home()
        stop = mocker.spy(stage.controllers["rail"], "stop")
        until = world.lines["box"].emulator.hangs["send"] = threading.Event()
        with pytest.raises(DeviceLost):
            stage.move({"rail": 30.0, "glass": 60.0})
        assert stop.call_count
        stage.move({"rail": 60.0})  # it goes on by itself
        assert stage.axis("glass").state is AxisState.LOST
        until.set()


PROGRAM = """
import sys, threading
from stages.config import StagesTable
from stages.stage import Stage

class Hangs:
    position = 0.0
    def set(self, value):
        threading.Event().wait()
    def stop(self):
        pass

sys.modules["hangs"] = sys.modules["__main__"]
axis = dict(controller="box", channel="x", carries="target", along="x", limits_mm=[0.0, 9.0], speed_mm_s=1.0,
            acceleration_mm_s2=1.0)
box = dict(driver="positioners", homing="hand", call_s=0.3, objects={"x": {"object": "hangs:Hangs"}})
table = StagesTable.model_validate(dict(controllers={"box": box}, axes={"x": axis}, home_order=["x"]))
with Stage.open(table) as stage:
    stage.confirm("x", 1.0)
    try:
        stage.move({"x": 5.0})
    except Exception as error:
        print(type(error).__name__, flush=True)
print("alive", flush=True)
"""


MICRO_MANAGER = PROGRAM.replace(
    'box = dict(driver="positioners", homing="hand", call_s=0.3, objects={"x": {"object": "hangs:Hangs"}})',
    """
import pymmcore, mm_test_adapters
class Hangs(pymmcore.CMMCore):
    def setPosition(self, label, um):
        self.sleep(1e6)
box = dict(driver="micromanager", homing="hand", call_s=0.3, core="hangs:Hangs",
           adapters=mm_test_adapters.device_adapter_path(),
           devices={"x": {"library": "DemoCamera", "device": "DStage"}})
""",
)


@pytest.mark.parametrize("program", [PROGRAM, MICRO_MANAGER], ids=["an object", "Micro-Manager"])
def test_a_program_whose_library_hangs_goes_on_and_ends(program):
    if program is MICRO_MANAGER:
        pytest.importorskip("pymmcore")
        pytest.importorskip("mm_test_adapters")
    begun_s = time.monotonic()
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["DeviceLost", "alive"]
    assert done.returncode == 0, done.stderr
    assert time.monotonic() - begun_s < 20.0


@pytest.mark.parametrize("lie", [{"done_early_s": 0.4}, {"begins_late_s": 0.3}, {"begins_late_s": 0.8}])
def test_done_that_is_said_too_early_is_not_believed(bench, library, lie):
    made = bench(library, firmware=lie).homed()
    assert max(map(abs, true_errors_um(made, (60.0, 20.0, 20.3, 110.0)))) <= 10.0


@pytest.mark.parametrize("mm", [math.nan, math.inf, -math.inf])
def test_nothing_but_numbers_reaches_the_library(made, mm):
    before = list(made.line.emulator.called)
    channel = made.table.axes["a"].channel
    with pytest.raises(OutOfRange):
        made.controller.start_move(channel, mm, 1.0, 1.0)
    with pytest.raises(OutOfRange):
        made.stage.axis("a").confirm(mm)
    assert made.line.emulator.called == before


def test_a_position_that_is_no_number_is_no_position(made, mocker):
    mocker.patch.object(made.line.emulator, "position_mm", return_value=math.nan)
    with pytest.raises(DeviceError, match="no position reference"):
        made.stage.where_mm()
    mocker.stopall()
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_a_stage_pushed_aside_has_lost_its_reference(bench, library):
    made = bench(library, firmware={"encoder": True}).homed()
    made.world.shove("a", 0.5)
    assert made.stage.where_mm()["a"] is None
    with pytest.raises(NotReferenced):
        made.stage.move({"a": 30.0})


def test_both_axes_of_a_pair_are_sent_and_the_partner_stands(bench):
    """Its last target goes with every move, so it never creeps; one that was pushed aside is not driven back."""
    made = bench("micromanager", firmware={"encoder": True}).homed({"b": 20.0013})
    stands_mm = made.world.true_mm("b")
    for target_mm in (30.0, 40.0, 50.0):
        made.stage.move({"a": target_mm})
    partner = [mm for call, channel, mm in made.line.emulator.called if (call, channel) == ("send", "XY/y")]
    assert partner[-3:] == pytest.approx([20.0013] * 3, abs=1e-9)
    assert made.world.true_mm("b") == stands_mm
    made.world.shove("b", 3.0)
    pushed_mm = made.world.true_mm("b")
    made.stage.move({"a": 60.0})
    assert made.world.true_mm("b") == pytest.approx(pushed_mm, abs=0.003)
    assert made.stage.where_mm()["b"] is None


def test_one_command_homes_both_axes_of_a_pair(bench):
    made = bench("micromanager")
    with pytest.raises(StageUsageError, match="also homes b"):
        made.stage.home(["a"])


def test_a_home_that_moves_nothing_finds_nothing(bench, library, mocker):
    made = bench(library)
    mocker.patch.object(made.line.emulator, "seek")
    with pytest.raises(DeviceError, match="homing: hand"):
        made.stage.home()
    assert made.stage.where_mm() == {"a": None, "b": None}


# ---- a person's word ---------------------------------------------------------------------------


@pytest.fixture
def by_hand(bench, library):
    return bench(library, box={"homing": "hand"}, sim={"power_up_mm": 37.0}, backlash_um=0.0)


def test_a_person_says_where_it_stands(by_hand):
    stage = by_hand.stage
    with pytest.raises(StageUsageError, match="confirm b=MM"):
        stage.home()
    with pytest.raises(NotReferenced):
        stage.move({"a": 40.0})
    before = list(by_hand.line.emulator.called)
    stage.home(ask=lambda name: by_hand.world.true_mm(name))
    assert by_hand.line.emulator.called == before  # nothing has moved
    assert stage.operator_mm == pytest.approx({"a": 37.0, "b": 37.0})
    stage.move({"a": 60.0, "b": 10.0})
    assert by_hand.world.true_mm("a") == pytest.approx(60.0, abs=0.01)
    assert stage.where_mm() == pytest.approx({"a": 60.0, "b": 10.0}, abs=0.01)
    stage.home()  # their word still holds
    by_hand.line.power_cycle(0.0)
    assert stage.where_mm() == {"a": None, "b": None}
    assert not stage.operator_mm


@pytest.mark.parametrize("mm", [4.9, 121.0, math.nan])
def test_a_word_that_cannot_be_is_refused(by_hand, mm):
    with pytest.raises(OutOfRange):
        by_hand.stage.confirm("a", mm)
    assert by_hand.stage.where_mm()["a"] is None


def test_what_homes_by_itself_takes_nobodys_word(made):
    with pytest.raises(StageUsageError, match="itself"):
        made.stage.confirm("a", 20.0)


def test_a_word_from_before_a_loss_does_not_hold(by_hand):
    by_hand.stage.home(ask=lambda name: 37.0)
    by_hand.line.unplug()
    with pytest.raises(DeviceLost):
        by_hand.stage.move({"a": 40.0})
    by_hand.line.plug_in()
    by_hand.stage.connect("box")
    assert by_hand.stage.axis("a").state is AxisState.UNREFERENCED


# ---- the bench file ----------------------------------------------------------------------------


@loop_over(
    "library, change, text",
    [
        ("micromanager", {"devices": {}}, "set either devices or config"),
        ("micromanager", {"config": "a.cfg"}, "set either devices or config"),
        ("micromanager", {"devices": {}, "config": "../a.cfg"}, "must be in the folder"),
        ("micromanager", {"devices": {}, "config": "/etc/a.cfg"}, "must be in the folder"),
        ("micromanager", {"devices": {"Z": {"library": "L", "device": "D"}}}, "is no device"),
        (
            "micromanager",
            {"devices": {"XY": {"library": "L", "device": "D", "properties": {"Position": 1.0}}}},
            "opening must not move anything",
        ),
        ("micromanager", {"homing": "maybe"}, "homing"),
        ("micromanager", {"port": "/dev/ttyUSB0"}, "port"),
        ("positioners", {"objects": {"z": {"object": "a:B"}}}, "is not one of the objects"),
        ("positioners", {"objects": {"x": {"object": "a.B"}}}, "object"),
        ("positioners", {"call_s": 0.0}, "call_s"),
    ],
)
def test_what_a_bench_file_says_wrongly_is_named(library, change, text):
    with pytest.raises(ValueError, match=text):
        stages_table(library, change)


def test_a_stop_that_slips_in_behind_the_look_ends_the_motion(made, mocker):
    """Another thread stops the bench behind the last look at the latch, before the library is told to move."""
    box, send = made.line.emulator, made.line.emulator.send

    def stopped_first(channel, target_mm):
        stopper = threading.Thread(target=made.stage.stop)
        stopper.start()
        while not made.stage.is_held:
            time.sleep(0.001)
        send(channel, target_mm)

    mocker.patch.object(box, "send", side_effect=stopped_first)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 100.0})
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") < 24.0


def test_a_stop_before_the_library_is_told_means_that_it_is_not_told(made, mocker):
    """It falls behind every look of the axis: the last one is in the library's own thread."""
    confirm_reference, before = made.controller.confirm_reference, list(made.line.emulator.called)

    def stopped_behind(channel):
        confirm_reference(channel)
        made.stage.stop()

    mocker.patch.object(made.controller, "confirm_reference", side_effect=stopped_behind)
    with pytest.raises(MotionStopped):
        made.stage.axis("a").move_to(100.0)
    assert made.line.emulator.called == before


def test_a_restart_that_a_stop_hides_takes_the_reference_all_the_same(made):
    """It rests where no way of its has led: what it reads counts from elsewhere."""
    made.stage.move({"a": 60.0})

    def both():
        made.line.power_cycle(0.0)
        made.stage.stop()

    made.clock.at(made.clock.now_s() + 0.5, both)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 110.0})
    assert made.stage.where_mm()["a"] is None


@pytest.mark.parametrize("held", ["XY/x", "XY/y"])
def test_a_pair_of_which_one_has_not_come_home_is_not_homed(bench, mocker, held):
    """Somebody holds the other axis: it reads something else than at its reference."""
    made = bench("micromanager").homed({"a": 40.0, "b": 30.0})
    box, seek = made.line.emulator, made.line.emulator.seek
    mocker.patch.object(box, "seek", side_effect=lambda channel: channel != held and seek(channel))
    with pytest.raises(MotionStopped, match="after its reference run"):
        made.stage.home()
    assert made.stage.where_mm() == {"a": None, "b": None}


def test_a_question_that_fails_in_motion_stops_what_moves(made, mocker):
    """The adapter raises once, and the box has never been away; nobody else halts the bench."""
    box, busy = made.line.emulator, made.line.emulator.busy
    failures = [RuntimeError("timeout")]

    def busy_or_not(channel):
        if failures and box.motors[channel].running:
            raise failures.pop()
        return busy(channel)

    mocker.patch.object(box, "busy", side_effect=busy_or_not)
    with pytest.raises(DeviceLost, match="timeout"):
        made.stage.axis("a").move_to(110.0)
    made.clock.sleep_s(20.0)
    assert made.world.true_mm("a") < 40.0


def test_a_stage_that_pauses_on_its_way_has_its_time_anew(bench, library):
    """It rests twice for 0.7 s: before it begins, and half way."""
    made = bench(library, firmware={"begins_late_s": 0.7}).homed()
    box, channel, begun_s = made.line.emulator, made.table.axes["a"].channel, made.clock.now_s()
    made.clock.at(begun_s + 1.2, lambda: box.stop(channel))
    made.clock.at(begun_s + 2.0, lambda: box._go(channel, 50.0))
    made.stage.move({"a": 50.0})
    assert made.world.true_mm("a") == pytest.approx(50.0, abs=0.1)
