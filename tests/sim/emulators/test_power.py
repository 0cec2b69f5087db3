"""What the boxes forget when their power fails, what they keep, and what a person's button does to them."""

import pytest

from sim.emulators.grbl import GrblEmulator
from sim.emulators.isel_dnc import IselEmulator
from sim.emulators.line import Line
from sim.emulators.pi_gcs2 import PiEmulator, StageMake
from sim.emulators.thorlabs_apt import AptEmulator
from sim.emulators.zaber_ascii import ZaberEmulator
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from sim.stages import SimulatedStages
from stages.config import StagesTable
from tests.stages.benches import screws, stages_table

SCREW = Mechanics(lead_mm=5.0, steps_per_rev=1600, high_switch_mm=200.0, index_mm=100.0, power_up_mm=60.0)
MOTORS = {
    ZaberEmulator: ["1/1", "1/2"],
    PiEmulator: ["1", "2"],
    IselEmulator: ["X", "Y"],
    GrblEmulator: ["X", "Y"],
}
HOME = {
    ZaberEmulator: b"/home\n", PiEmulator: b"SVO 1 1 2 1\nFRF\n", IselEmulator: b"@03\r@0R3\r",
    GrblEmulator: b"$H\n",
}  # fmt: skip
MOVE = {  # far, and slow enough to be caught on the way
    ZaberEmulator: b"/1 1 move abs 32000\n", PiEmulator: b"MOV 1 150\n", IselEmulator: b"@0A 32000,2000,0,30\r",
    GrblEmulator: b"$J=G53G90X-100F600\n",
}  # fmt: skip


class Box:
    """One box on a line, with two motors."""

    def __init__(self, made, **options):
        self.clock = VirtualClock()
        self.motors = {name: Motor(SCREW) for name in MOTORS[made]}
        self.device = made(self.motors, self.clock, **options)
        self.line = Line(self.device, self.clock)
        self.first = next(iter(self.motors.values()))

    def wait(self, seconds):
        self.clock.sleep_s(seconds)
        return self.line.receive()

    def ask(self, data, seconds=0.05):
        self.line.send(data)
        return self.wait(seconds)

    @property
    def is_grbl(self):
        return isinstance(self.device, GrblEmulator)

    def homed(self):
        self.ask(HOME[type(self.device)], 300.0)
        self.ask(MOVE[type(self.device)], 100.0)
        return self


@pytest.fixture(params=MOTORS, ids=lambda made: made.__name__)
def box(request):
    return Box(request.param)


@pytest.mark.parametrize("phase", ["home", "move"])
def test_power_fails_in_motion_and_the_carriage_stays(box, phase):
    if phase == "move":
        box.ask(HOME[type(box.device)], 300.0)
    box.ask({"home": HOME, "move": MOVE}[phase][type(box.device)], 0.1)
    assert any(motor.running for motor in box.motors.values())
    box.line.power_cycle(0.3)
    there_mm = [motor.carriage_mm for motor in box.motors.values()]
    heard = box.wait(60.0)
    assert [motor.carriage_mm for motor in box.motors.values()] == there_mm
    assert heard == (b"Grbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n" if box.is_grbl else b"")
    assert all(box.device.purpose(name) == "move" for name in box.motors)


def test_a_box_without_power_hears_and_says_nothing(box):
    before_mm = box.homed().first.carriage_mm
    box.line.send({ZaberEmulator: b"/1 1 get pos\n", PiEmulator: b"POS?\n"}.get(type(box.device), b"@0P\r?"))
    box.line.power_cycle(0.3)  # the answer is in its buffer
    assert box.ask(MOVE[type(box.device)], 0.2) == b""
    box.wait(10.0)
    assert box.first.carriage_mm == before_mm
    assert not box.first.running


def test_half_a_command_is_forgotten(box):
    box.homed()
    command = MOVE[type(box.device)]
    box.line.send(command[:-3])
    box.line.power_cycle(0.0)
    before_mm = box.first.carriage_mm
    box.ask(command[-3:], 5.0)
    assert box.first.carriage_mm == before_mm


def test_zaber_counts_from_where_it_stands_and_says_so():
    box = Box(ZaberEmulator, checksums=False).homed()
    box.ask(b"/1 1 set maxspeed 4711\n")
    assert box.ask(b"/1 1 get pos\n") == b"@01 1 OK IDLE -- 32000\r\n"
    box.line.power_cycle()
    box.wait(1.0)
    assert box.ask(b"/1 1 get pos\n") == b"@01 1 OK IDLE WR 0\r\n"
    assert box.ask(b"/1 1 get maxspeed\n") == b"@01 1 OK IDLE WR 4711\r\n"
    before_mm = box.first.carriage_mm
    box.ask(b"/1 1 move abs 320\n", 20.0)
    assert box.first.carriage_mm - before_mm == pytest.approx(1.0)  # a wrong place, taken for a right one


@pytest.mark.parametrize("absolute", [False, True])
def test_pi_forgets_unless_its_encoders_are_absolute(absolute):
    box = Box(PiEmulator, stages=StageMake(absolute_encoders=absolute)).homed()
    box.ask(b"MOV 2 99\n")  # leaves an error behind: no such thing as before
    box.ask(b"MOV 1 9999\n")
    box.line.power_cycle()
    box.wait(1.0)
    assert box.ask(b"ERR?\n") == b"0\n"
    assert box.ask(b"SVO? 1\n") == b"1=0\n"
    assert box.ask(b"FRF? 1\n") == (b"1=1\n" if absolute else b"1=0\n")
    assert box.ask(b"POS? 1\n") == (b"1=150.0000000\n" if absolute else b"1=0.0000000\n")
    box.ask(b"SVO 1 1\nMOV 1 10\n")
    assert box.ask(b"ERR?\n") == (b"0\n" if absolute else b"5\n")


def test_isel_is_not_initialised_and_owes_no_answer():
    box = Box(IselEmulator).homed()
    box.ask(b"@0A -3200,500,0,30\r", 1.0)
    box.line.power_cycle()
    assert box.wait(60.0) == b""
    assert box.ask(b"@0P\r") == b"4"
    assert box.ask(b"@0R1\r") == b"4"
    assert box.ask(b"@03\r") == b"0"
    assert box.ask(b"@0P\r") == b"0000000000000"
    assert box.ask(b"@0A 10,500,0,30\r") == b"R"


@pytest.mark.parametrize(("homing", "state"), [(1, b"Alarm"), (0, b"Idle")])
def test_grbl_greets_and_is_locked_if_it_can_home(homing, state):
    box = Box(GrblEmulator, settings={22: homing, 20: 0})
    box.ask(b"$X\n")
    box.ask(b"$J=G91X5F6000\n", 5.0)
    box.ask(b"T7\n")
    assert b"T7" in box.ask(b"$G\n")
    box.line.power_cycle(0.3)
    assert box.wait(0.29) == b""
    greeting = box.wait(0.02)
    assert greeting.startswith(b"Grbl 1.1h ['$' for help]\r\n")
    assert (b"unlock" in greeting) is bool(homing)
    assert box.ask(b"?") == b"<" + state + b"|MPos:0.000,0.000,0.000|FS:0,0>\r\n"
    assert box.ask(b"$G\n") == b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok\r\n"


def test_a_boot_loader_makes_grbl_deaf_for_longer():
    box = Box(GrblEmulator, restart_s=1.5)
    box.line.power_cycle(0.3)
    assert box.ask(b"$I\n", 1.7) == b""
    assert box.wait(0.2).startswith(b"Grbl")


def test_a_soft_reset_of_grbl_forgets_the_tool_and_keeps_the_place():
    box = Box(GrblEmulator).homed()
    place = box.ask(b"?")
    assert box.ask(b"T5\n") == b"ok\r\n"
    assert box.ask(b"T256\n") == b"error:38\r\n"
    box.ask(b"\x18")
    assert b"T0" in box.ask(b"$G\n")
    assert box.ask(b"?") == place


def test_grbl_takes_a_tool_only_at_rest_and_unlocked():
    box = Box(GrblEmulator)
    assert box.ask(b"T5\n") == b"error:9\r\n"
    box.homed()
    box.ask(b"$J=G91X-50F300\n")
    assert box.ask(b"T5\n") == b"error:9\r\n"


def test_a_feed_hold_ends_a_jog_short_of_its_target():
    box = Box(GrblEmulator).homed()
    box.ask(b"$J=G91X-50F600\n", 2.0)
    box.device.button()
    box.wait(2.0)
    held_mm = box.first.carriage_mm
    assert box.ask(b"?").startswith(b"<Idle|MPos:-11")
    assert box.ask(b"$J=G91X-1F600\n", 5.0) == b"ok\r\n"
    assert box.first.carriage_mm == pytest.approx(held_mm - 1.0, abs=0.01)


def test_a_feed_hold_at_rest_holds_what_comes_until_resumed():
    box = Box(GrblEmulator).homed()
    before_mm = box.first.carriage_mm
    box.device.button()
    assert box.ask(b"?").startswith(b"<Hold:0|")
    assert box.ask(b"$J=G91X-50F600\n", 60.0) == b""
    assert box.ask(b"\x85", 1.0) == b""  # there is no jog yet
    assert box.first.carriage_mm == before_mm
    assert box.ask(b"~", 60.0) == b"ok\r\n"
    assert box.first.carriage_mm == pytest.approx(before_mm - 50.0, abs=0.1)


def test_a_reset_throws_away_what_a_hold_kept_waiting():
    box = Box(GrblEmulator).homed()
    before_mm = box.first.carriage_mm
    box.device.button()
    box.ask(b"$J=G91X-50F600\n")
    assert box.ask(b"\x18", 60.0).startswith(b"Grbl")
    assert box.ask(b"?").startswith(b"<Idle|")
    assert box.first.carriage_mm == before_mm


def test_a_line_that_is_held_goes_on_where_it_was():
    box = Box(GrblEmulator).homed()
    before_mm = box.first.carriage_mm
    box.ask(b"G1G91X-50F600\n", 2.0)
    box.ask(b"!", 0.02)
    assert box.ask(b"?", 0.01).startswith(b"<Hold:1|")
    box.wait(2.0)
    assert box.ask(b"?").startswith(b"<Hold:0|")
    assert -25.0 < box.first.carriage_mm - before_mm < -15.0
    box.ask(b"~", 60.0)
    assert box.ask(b"?").startswith(b"<Idle|")
    assert box.first.carriage_mm == pytest.approx(before_mm - 50.0, abs=0.1)


def test_a_hold_while_homing_holds_afterwards():
    box = Box(GrblEmulator)
    box.ask(b"$H\n", 1.0)
    box.device.button()
    assert b"ok" in box.wait(300.0)
    assert box.ask(b"?").startswith(b"<Hold:0|")
    box.ask(b"~")
    assert box.ask(b"?").startswith(b"<Idle|")


def test_a_jog_cancel_behind_an_unread_jog_does_nothing():
    box = Box(GrblEmulator).homed()
    before_mm = box.first.carriage_mm
    box.line.send(b"$J=G91X-50F600\n")
    box.line.send(b"\x85")  # the main loop has not read the line yet
    box.wait(60.0)
    assert box.first.carriage_mm == pytest.approx(before_mm - 50.0, abs=0.1)
    box.ask(b"$J=G91X-5F600\n", 0.002)
    box.line.send(b"\x85")
    box.wait(60.0)
    assert box.first.carriage_mm == pytest.approx(before_mm - 50.0, abs=0.2)


def test_the_knob_of_a_zaber_interrupts_and_turns():
    box = Box(ZaberEmulator, checksums=False).homed()
    box.ask(b"/1 1 move abs 3200\n", 0.1)
    box.device.person_stops()
    box.wait(2.0)
    assert b" IDLE NI " in box.ask(b"/1 1\n")
    before_mm = box.first.carriage_mm
    box.device.turn_knob(1, 1, 640)
    assert b" BUSY NC " in box.ask(b"/1 1\n", 0.002)
    box.wait(10.0)
    assert box.first.carriage_mm == pytest.approx(before_mm + 2.0, abs=0.01)
    assert b" IDLE NI " in box.ask(b"/1 1\n")


def test_a_stop_at_another_interface_of_a_pi_leaves_error_10():
    box = Box(PiEmulator).homed()
    box.ask(b"MOV 1 10\n", 1.0)
    box.device.person_stops()
    rests_mm = (box.wait(2.0), box.first.carriage_mm)[1]
    assert 20.0 < rests_mm < 150.0
    assert box.ask(b"ERR?\n") == b"10\n"


def test_the_stop_key_of_an_isel_is_answered_f():
    box = Box(IselEmulator).homed()
    box.ask(b"@0A -20000,1000,0,30\r", 1.0)
    box.device.person_stops()
    assert box.wait(5.0) == b"F"
    box.device.person_stops()
    assert box.wait(5.0) == b""


def test_two_boxes_of_one_kind_tell_themselves_apart_where_their_protocol_can():
    said = {}
    for driver, question in [
        ("zaber_ascii", b"/1 get system.serial\n"),
        ("pi_gcs2", b"*IDN?\n"),
        ("grbl", b"$I\n"),
    ]:
        one = stages_table(driver).model_dump()
        axes = {f"{box}_{name}": {**axis, "controller": box} for box in "uv" for name, axis in one["axes"].items()}
        table = StagesTable.model_validate(
            {
                "controllers": {box: {"driver": driver, "port": "nowhere"} for box in "uv"},
                "axes": axes,
                "home_order": list(axes),
            }
        )
        clock = VirtualClock()
        world = SimulatedStages(table, clock, screws(table))
        for name in "uv":
            world.lines[name].send(question)
            clock.sleep_s(0.1)
            said[driver, name] = world.lines[name].receive()
        assert said[driver, "u"] != said[driver, "v"]
        assert len(said[driver, "u"]) > 10


def test_homing_of_grbl_fails_if_the_switch_stays_closed():
    """The carriage stands further beyond the switch than the pull-off: zero would be found at the wrong place."""
    box = Box(GrblEmulator, settings={23: 0})
    box.first.slip(141.7)
    heard = box.ask(b"$H\n", 300.0)
    assert heard.startswith(b"ALARM:8\r\nGrbl 1.1h")
    assert box.ask(b"?").startswith(b"<Alarm|")


@pytest.mark.parametrize(("made", "channel", "turn"), [
    (ZaberEmulator, "1/1", lambda device: device.turn_knob(1, 1, 640)),
    (AptEmulator, "1", lambda device: device.turn_wheel("1", 34_304)),
])  # fmt: skip
@pytest.mark.parametrize("off_s", [0.0, 1.0])
def test_a_knob_turns_nothing_without_power(made, channel, turn, off_s):
    """Found by the fuzz: a box that was off drove its axis, and once it was on again the motion was nobody's."""
    clock, motor = VirtualClock(), Motor(SCREW)
    device = made({channel: motor}, clock)
    device.restart(off_s)
    before_mm = motor.carriage_mm
    turn(device)
    clock.sleep_s(10.0)
    device.advance()
    assert device.is_on
    assert (motor.carriage_mm == before_mm) == (off_s > 0.0)
