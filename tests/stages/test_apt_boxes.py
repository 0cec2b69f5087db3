"""What Thorlabs boxes do beyond the contract: servos and steppers, wheels and buttons, marks, unasked words."""

import re
import struct
from contextlib import closing
from pathlib import Path

import pytest

from sim.emulators.device import Emulator
from sim.emulators.line import Line
from sim.emulators.protocol_sim import put_up
from sim.mechanics.clock import VirtualClock
from stages.controller import Channel
from stages.drivers.apt_questions import FAMILIES
from stages.drivers.thorlabs_apt import AptController
from stages.errors import AxisStalled, LimitHit, MotionStopped, NoReply, StageError, StageUsageError, WrongDevice
from stages.protocols import thorlabs_apt as apt
from stages.protocols.apt_words import Kind
from stages.states import AxisState

SERVO = {"lead_mm": 1.0, "steps_per_rev": 34_304}


@pytest.fixture
def cube(bench, monkeypatch):
    """A KDC101 with one MTS stage of 34304 counts/mm; the second axis of the fixture is its second channel."""
    monkeypatch.setattr(AptController, "example_channels", ("1", "2"))

    def make(**changes):
        settings = {
            "steps_per_mm": 34_304.0, "speed_mm_s": 2.0, "acceleration_mm_s2": 4.0, "limits_mm": [1.0, 50.0],
            "approach": {"side": "from_below", "distance_mm": 0.3, "speed_mm_s": 0.5},
        }  # fmt: skip
        return bench("thorlabs_apt", sim=SERVO, **(settings | changes))

    return make


def written(made, kind):
    """Messages of one kind that the program has sent, and when."""
    found = []
    for chunk in made.controller.port.trace:
        if chunk.sent:
            found += [(chunk.time_s, m) for m in apt.CommandStream().feed(chunk.data) if _kind(m) == kind]
    return found


def _kind(message):
    return Kind.MOT_SET_VELPARAMS if isinstance(message, apt.SetSpeeds) else message.kind


# ---- units ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "counts_per_mm", "speed", "acceleration", "tolerance"),
    [
        ("KDC101", 34304.0, 767_367.49, 261.93, 1e-5),  # seven open clients quote these of issue 15, MTS50-Z8
        ("TDC001", 34554.96, 772_981.3692, 263.8443072, 1e-8),  # eight quote these of issue 23, Z8 actuators
        ("BBD203", 20000.0, 134_217.73, 13.744, 1e-5),  # DDS600, by 102.4 us
        ("BSC203", 409600.0, 21_987_328.0, 4506.0, 1e-4),  # DRV250: thorlabs-apt-device; LTS300C: a lab's own
        ("LTS300C", 409600.0, 21_987_328.0, 4506.0, 1e-4),
        ("BSC103", 25600.0, 25600.0, 25600.0, 1e-9),  # DRV014: InstrumentKit
    ],
)
def test_the_units_of_the_families_are_those_that_are_published(
    model, counts_per_mm, speed, acceleration, tolerance
):
    family = next(family for family in FAMILIES if re.fullmatch(family.models, model))
    assert counts_per_mm * family.speed == pytest.approx(speed, rel=tolerance)
    assert counts_per_mm * family.acceleration == pytest.approx(acceleration, rel=tolerance)


@pytest.mark.parametrize("model", ["KIM101", "PPC001", "K10CR1", "BSC", "XKDC101", "TST0011", "", "KDC"])
def test_a_model_of_unknown_units_is_refused(bench, model):
    with pytest.raises(WrongDevice, match="families"):
        bench("thorlabs_apt", firmware={"model": model or "?"})


def test_true_speed_of_a_servo(cube):
    made = cube().homed()
    begun_s = made.clock.now_s()
    made.stage.move({"a": 40.0})
    took_s = made.clock.now_s() - begun_s
    assert 39.0 / 2.0 < took_s < 39.0 / 2.0 + 4.0
    assert made.world.true_mm("a") == pytest.approx(40.0, abs=0.05)


@pytest.mark.parametrize("model", ["BSC103", "KBD101"])
def test_true_speed_of_the_others(bench, model):
    made = bench("thorlabs_apt", firmware={"model": model}).homed({"a": 10.0})
    begun_s = made.clock.now_s()
    made.stage.move({"a": 110.0})
    assert 100.0 / 20.0 < made.clock.now_s() - begun_s < 100.0 / 20.0 + 1.5


def test_a_speed_that_is_not_taken_is_said(bench, monkeypatch):
    made = bench("thorlabs_apt").homed()
    take = made.line.emulator._take

    def slower(data):
        take(data)
        channel = made.line.emulator.channel("bay1")
        channel.speeds = (*channel.speeds[:2], min(channel.speeds[2], 50_000))

    monkeypatch.setattr(made.line.emulator, "_take", slower)
    with pytest.raises(StageUsageError, match=r"2\.329 mm/s"):  # 50000 / 53.68 / 400
        made.stage.move({"a": 50.0})


# ---- how motions end -----------------------------------------------------------------------------


def test_a_servo_that_is_held_says_so(cube):
    made = cube().homed({"a": 10.0})
    motor = made.world.motors["a"]
    motor.obstacle_mm = motor.carriage_mm + 5.0
    with pytest.raises(AxisStalled, match="position error was too large; clear the way and home it"):
        made.stage.move({"a": 30.0})
    assert made.stage.axis("a").state is AxisState.UNREFERENCED
    motor.obstacle_mm = None
    assert made.again().axis("a").state is AxisState.UNREFERENCED  # nor does the next program believe it


def test_after_a_limit_switch_the_next_program_believes_nothing(bench):
    made = bench("thorlabs_apt").homed({"a": 50.0})
    motor = made.world.motors["a"]
    motor.mechanics = type(motor.mechanics)(
        **{name: getattr(motor.mechanics, name) for name in motor.mechanics.__slots__}
        | {"high_switch_mm": motor.carriage_mm + 30.0}
    )
    with pytest.raises(LimitHit):
        made.stage.move({"a": 110.0})
    assert made.again().axis("a").state is AxisState.UNREFERENCED


@pytest.mark.parametrize(("make", "how"), [("cube", 1), ("bench", 2)])
def test_a_servo_stops_at_once_and_a_stepper_along_its_ramp(request, make, how):
    made = request.getfixturevalue(make)(*(["thorlabs_apt"] if make == "bench" else []))
    made.stage.home()
    homed_s = made.clock.now_s()
    made.clock.at(homed_s + 2.0, made.stage.stop)
    with pytest.raises(MotionStopped):
        made.stage.move({"a": 45.0})
    stops = [message for time_s, message in written(made, Kind.MOT_MOVE_STOP) if time_s > homed_s]
    assert {message.second for message in stops} == {how}
    assert {(message.first, message.to) for message in stops} == (
        {(1, 0x50), (2, 0x50)} if make == "cube" else {(1, 0x21), (1, 0x22)}
    )


def test_a_box_that_begins_late_is_waited_for(bench, monkeypatch):
    made = bench("thorlabs_apt").homed()
    channel = made.line.emulator.channel("bay1")
    move = channel.move
    monkeypatch.setattr(
        type(channel), "move", lambda one, target: made.clock.at(made.clock.now_s() + 0.15, lambda: move(target))
    )
    made.stage.move({"a": 50.0})
    assert made.world.true_mm("a") == pytest.approx(50.0, abs=0.05)


def test_a_box_that_does_not_begin_says_why(bench, monkeypatch):
    made = bench("thorlabs_apt").homed()

    def refuse(one, target):
        words = struct.pack("<HH64s", 0x0453, 17, b"out of range")
        made.line.emulator.say(apt.Unasked(Kind.HW_RICHRESPONSE, words, False, 0x21).to_bytes())

    monkeypatch.setattr(type(made.line.emulator.channel("bay1")), "move", refuse)
    before_mm = made.world.true_mm("a")
    with pytest.raises(StageError, match=r"refused to move: out of range \(17\)"):
        made.stage.move({"a": 50.0})
    assert made.world.true_mm("a") == before_mm


def test_a_box_that_just_does_nothing_holds_the_bench(bench, monkeypatch):
    made = bench("thorlabs_apt").homed()
    monkeypatch.setattr(type(made.line.emulator.channel("bay1")), "move", lambda one, target: None)
    with pytest.raises(MotionStopped, match="at the box"):
        made.stage.move({"a": 50.0})
    assert made.stage.is_held


def test_a_person_who_stops_while_answers_are_lost_has_stopped(bench, monkeypatch):
    """One look has found rest, then nothing is heard; our own halt must not hide whose stop it was."""
    made = bench("thorlabs_apt").homed({"a": 10.0})
    agreed, lost = made.controller._ask_until_equal, []

    def nothing_heard(*arguments):
        if lost and len(lost) < 3:
            lost.append(1)
            raise NoReply("nothing")
        return agreed(*arguments)

    def press():
        made.line.emulator.person_stops()
        lost.append(1)

    monkeypatch.setattr(made.controller, "_ask_until_equal", nothing_heard)
    made.clock.at(made.clock.now_s() + 2.0, press)
    with pytest.raises(MotionStopped, match="short of its target"):
        made.stage.move({"a": 110.0})
    assert made.stage.is_held
    assert made.world.true_mm("a") < 60.0


def test_its_own_backlash_correction_is_off_before_anything_moves(bench):
    """It would drive past the target, where nobody has looked."""
    made = bench("thorlabs_apt", approach=None, backlash_um=0.0).homed({"a": 60.0})
    lowest = []
    motor = made.world.motors["a"]
    motor.watcher = lambda glide: lowest.append(min(glide.begin_mm, glide.end_mm))
    made.stage.move({"a": 40.0})
    assert min(lowest) == pytest.approx(motor.carriage_mm, abs=0.003)
    made.line.emulator.channel("bay1").backlash = 160  # set behind our back: the judge must be able to see it
    made.stage.move({"a": 30.0})
    assert min(lowest) < motor.carriage_mm - 0.3


def test_a_wheel_that_is_turned_moves_the_axis_and_the_position_is_known(bench):
    made = bench("thorlabs_apt").homed({"a": 60.0})
    made.line.emulator.turn_wheel("bay1", 800)
    with pytest.raises(StageUsageError, match="wait until it stops"):
        _ = made.stage.axis("a").position_mm
    made.clock.sleep_s(5.0)
    made.line.receive()
    assert made.stage.axis("a").position_mm == pytest.approx(62.0, abs=0.01)
    made.stage.move({"a": 60.0})
    assert made.stage.where_mm()["a"] == pytest.approx(60.0, abs=0.01)


@pytest.mark.parametrize("cut", range(1, 12))
def test_half_a_command_of_a_program_that_died_moves_nothing(bench, cut):
    """The box takes the next bytes for the rest of the target, whatever they mean."""
    made = bench("thorlabs_apt").homed({"a": 60.0})
    stood_mm = made.world.true_mm("a")
    made.stage.close()
    made.line.send(apt.Setting(Kind.MOT_MOVE_ABSOLUTE, 1, 16_000, 0x21).to_bytes()[:cut])
    again = made.again()
    made.clock.sleep_s(10.0)
    made.line.receive()
    assert made.world.true_mm("a") == pytest.approx(stood_mm, abs=0.06)  # its play at most
    again.home()
    again.move({"a": 40.0})
    assert again.where_mm()["a"] == pytest.approx(40.0, abs=0.01)


# ---- the wire ------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [None, 5, 13])
def test_what_boxes_say_by_themselves_is_nobodys_answer(bench, monkeypatch, cut):
    """Another program has asked for the state ten times a second; it stands before and behind each answer."""
    made = bench("thorlabs_apt")
    send = Line.send
    told = apt.Unasked(Kind.MOT_GET_STATUSUPDATE, b"\1\0" + b"\x39" * 12, False, 0x21).to_bytes()

    def talkative(line, data):
        line.emulator.say(told)
        send(line, data)
        for piece in (told,) if cut is None else (told[:cut], told[cut:]):
            line.emulator.say(piece)

    monkeypatch.setattr(Line, "send", talkative)
    made.stage.home()
    made.stage.move({"a": 30.0, "b": 70.0})
    assert made.stage.where_mm() == pytest.approx({"a": 30.0, "b": 70.0}, abs=0.01)


def published():
    """Answers of strangers' tests by their question, each with what is said before it."""
    path = Path(__file__).parents[1] / "sim" / "emulators" / "dialogues" / "thorlabs_apt_published.txt"
    answers, question = {}, b""
    for line in path.read_text().splitlines():
        text = line[2:].replace("{53 zeros}", "00 " * 53)
        if line.startswith("> "):
            question = bytes.fromhex(text)
        elif line.startswith("< "):
            answers[question] = answers.get(question, b"") + bytes.fromhex(text)
    return answers


class Strangers(Emulator):
    """Answers as strangers' tests let a box answer."""

    def _take(self, data):
        for place in range(0, len(data), 6):  # only short messages are sent to it
            self.say(published().get(data[place : place + 6], b""))


def test_the_driver_reads_what_strangers_let_a_box_say():
    clock = VirtualClock()
    box = AptController("box", {"1": Channel("1", 400.0)}, clock)
    with put_up(Line(Strangers({}, clock), clock)) as url, closing(box):
        identity = box.connect(url)
        assert identity == "Thorlabs KDC101 serial 67305985 firmware 163.162.161"
        assert box.position_mm("1") == -50.0
        how = box._homing_settings("1")
        assert (how.direction, how.switch, how.speed, how.offset) == (1, 1, 100, 7000)
        assert box._value("1", Kind.MOT_REQ_GENMOVEPARAMS) == -20_000
        assert box._speeds("1") == (0xCCCCCD, 0x35B0)
        assert not box.moving("1")
        assert not box.has_reference("1")  # it is homed, and has no mark of ours


def test_automatic_messages_are_switched_off(bench, monkeypatch):
    """Also those of a box that needs no thanks and would go on for ever."""
    monkeypatch.setattr("sim.emulators.thorlabs_apt.UNTHANKED", 10**6)
    made = bench("thorlabs_apt")
    made.line.send(bytes.fromhex("11 00 00 00 21 01"))
    made.again()
    made.clock.sleep_s(0.5)
    made.line.receive()
    made.clock.sleep_s(2.0)
    assert made.line.receive() == b""


def test_an_answer_about_another_channel_is_not_taken(bench):
    """The position of bay 2, in the place of that of bay 1."""
    made = bench("thorlabs_apt").homed({"a": 30.0, "b": 70.0})
    said = made.line.emulator.take_answers
    count = [0]

    def swapped():
        answers = []
        for one in said():
            is_position = one.data[:2] == b"\x12\x04"
            count[0] += is_position
            answers.append(one._replace(data=one.data[:5] + b"\x22" + one.data[6:] if is_position else one.data))
        return answers

    made.line.emulator.take_answers = swapped
    with pytest.raises(StageError, match=r"something else|clear answer"):
        _ = made.stage.axis("a").position_mm
    assert count[0] >= 3


def test_an_empty_bay_is_said(bench, monkeypatch):
    monkeypatch.setattr("sim.emulators.thorlabs_apt.AptEmulator._obey", _with_bay_2_empty())
    with pytest.raises(WrongDevice, match="no card in bay2"):
        bench("thorlabs_apt")


def _with_bay_2_empty():
    from sim.emulators.thorlabs_apt import AptEmulator

    obey = AptEmulator._obey

    def without(box, order):
        if (order.kind, order.first) == (Kind.RACK_REQ_BAYUSED, 1):
            box.say(apt.Reply(Kind.RACK_GET_BAYUSED, 1, 2, 0x11).to_bytes())
        else:
            obey(box, order)

    return without


@pytest.mark.parametrize("channels", [("1", "bay1"), ("bay0",), ("bay11",), ("5",), ("0",), ("bay",), ("1/1",)])
def test_impossible_channels(channels):
    with pytest.raises(StageUsageError, match="channel"):
        AptController("box", {name: Channel(name, 400.0) for name in channels})


def test_a_box_that_falls_silent_without_server_alive_is_driven_for_minutes(cube):
    """APT protocol, issue 26, p. 30: once a second, or no answer after about fifty commands."""
    made = cube(firmware={"falls_silent": True}).homed()
    for _ in range(3):
        made.stage.move({"a": 40.0})
        made.clock.sleep_s(30.0)
        assert made.stage.where_mm()["a"] == pytest.approx(40.0, abs=0.01)
        made.stage.move({"a": 5.0})
    times = [time_s for time_s, _ in written(made, Kind.MOT_ACK_DCSTATUSUPDATE)]
    asked = [time_s for time_s, _ in written(made, Kind.MOT_REQ_STATUSBITS)]
    assert len(times) < 0.5 * len(asked)
    assert all(any(0.0 <= at - said <= 0.6 for said in times) for at in asked if at > times[0])


def test_without_server_alive_such_a_box_says_nothing_any_more(cube, monkeypatch):
    monkeypatch.setattr("stages.drivers.apt_questions.ALIVE_S", 1e9)
    made = cube(firmware={"falls_silent": True})
    made.clock.sleep_s(2.0)
    with pytest.raises(NoReply):
        made.stage.home()


@pytest.mark.parametrize("shape", ["rack", "cube"])
def test_the_start_of_a_conversation_is_that_of_the_protocol(shape, request, bench):
    """Flow control, buffers emptied with dwells, and the word that nobody is about to write firmware."""
    made = request.getfixturevalue("cube")() if shape == "cube" else bench("thorlabs_apt")
    assert made.controller.port._serial.rtscts
    assert made.line.emulator.started_by == ([0x50] if shape == "cube" else [0x11, 0x21, 0x22])
