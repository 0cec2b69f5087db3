"""Two strangers judge our APT box and our APT grammar; neither of them shares anything with us.

`thorlabs-apt-protocol` (MIT) reads and writes messages, `pylablib` (GPL) drives boxes: tools of a bench, nothing
of ours imports them. Where one is not installed its tests are skipped.
"""

import time
from contextlib import contextmanager

import pytest

from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.emulators.thorlabs_apt import AptEmulator
from sim.mechanics.clock import ScaledClock
from sim.mechanics.motion import Mechanics, Motor
from stages.protocols import apt_words as words
from stages.protocols import thorlabs_apt as apt
from stages.protocols.apt_words import Kind

SERVO = Mechanics(lead_mm=1.0, steps_per_rev=34_304, high_switch_mm=50.0, index_mm=25.0, power_up_mm=12.0)
STEPPER = Mechanics(lead_mm=1.0, steps_per_rev=409_600, high_switch_mm=50.0, index_mm=25.0, power_up_mm=12.0)


@contextmanager
def box_on_a_port(motors, speed=20.0, **options):
    clock = ScaledClock(speed)
    line = Line(AptEmulator(motors, clock, **options), clock)
    with PtyPort(line) as port:
        yield port.path, line


def wait_until(condition, limit_s=10.0):
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


# ---- the words, against thorlabs-apt-protocol ----------------------------------------------------


WRITTEN = {
    "hw_req_info": ({"dest": 0x11}, apt.Order(Kind.HW_REQ_INFO, to=0x11)),
    "hw_stop_updatemsgs": ({}, apt.Order(Kind.HW_STOP_UPDATEMSGS)),
    "hw_no_flash_programming": ({}, apt.Order(Kind.HW_NO_FLASH_PROGRAMMING)),
    "mot_ack_dcstatusupdate": ({}, apt.Order(Kind.MOT_ACK_DCSTATUSUPDATE)),
    "rack_req_bayused": ({"dest": 0x11, "bay_ident": 2}, apt.Order(Kind.RACK_REQ_BAYUSED, 2, 0, 0x11)),
    "mod_set_chanenablestate": (
        {"chan_ident": 1, "enable_state": 1},
        apt.Order(Kind.MOD_SET_CHANENABLESTATE, 1, words.ON),
    ),
    "mot_move_home": ({"dest": 0x23, "chan_ident": 1}, apt.Order(Kind.MOT_MOVE_HOME, 1, 0, 0x23)),
    "mot_move_stop": ({"chan_ident": 2, "stop_mode": 2}, apt.Order(Kind.MOT_MOVE_STOP, 2, words.STOP_SLOWING)),
    "mot_move_absolute": ({"chan_ident": 1, "position": -77}, apt.Setting(Kind.MOT_MOVE_ABSOLUTE, 1, -77)),
    "mot_req_poscounter": ({"chan_ident": 1}, apt.Order(Kind.MOT_REQ_POSCOUNTER, 1)),
    "mot_req_velparams": ({"chan_ident": 1}, apt.Order(Kind.MOT_REQ_VELPARAMS, 1)),
    "mot_req_homeparams": ({"chan_ident": 1}, apt.Order(Kind.MOT_REQ_HOMEPARAMS, 1)),
    "mot_req_genmoveparams": ({"chan_ident": 1}, apt.Order(Kind.MOT_REQ_GENMOVEPARAMS, 1)),
    "mot_req_moverelparams": ({"chan_ident": 1}, apt.Order(Kind.MOT_REQ_MOVERELPARAMS, 1)),
    "mot_set_genmoveparams": (
        {"chan_ident": 1, "backlash_distance": 70_000},
        apt.Setting(Kind.MOT_SET_GENMOVEPARAMS, 1, 70_000),
    ),
    "mot_set_moverelparams": (
        {"chan_ident": 1, "relative_distance": 900},
        apt.Setting(Kind.MOT_SET_MOVERELPARAMS, 1, 900),
    ),
    "mot_set_velparams": (
        {"dest": 0x21, "chan_ident": 1, "min_velocity": 7, "acceleration": 4506, "max_velocity": 21_987_328},
        apt.SetSpeeds(1, 7, 4506, 21_987_328, 0x21),
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_stranger_writes_the_same_bytes(name):
    theirs = pytest.importorskip("thorlabs_apt_protocol", reason="thorlabs-apt-protocol is not installed")
    named, ours = WRITTEN[name]
    written = getattr(theirs, name)(**{"dest": 0x50, "source": 0x01} | named)
    assert written == ours.to_bytes()
    assert apt.CommandStream().feed(written) == [ours]


READ = [
    (apt.Info(27_123_456, "KDC101", 16, (1, 2, 3), "", 5, 6, 1), {
        "serial_number": 27_123_456, "model_number": b"KDC101\0\0", "hw_version": 5, "mod_state": 6, "nchs": 1,
    }),
    (apt.Reply(Kind.RACK_GET_BAYUSED, 2, words.ON, 0x11), {"bay_ident": 2, "occupied": True}),
    (apt.Value(Kind.MOT_GET_POSCOUNTER, 1, -123_456), {"chan_ident": 1, "position": -123_456}),
    (apt.Value(Kind.MOT_GET_GENMOVEPARAMS, 1, 4321), {"chan_ident": 1, "backlash_distance": 4321}),
    (apt.Value(Kind.MOT_GET_MOVERELPARAMS, 1, 777), {"chan_ident": 1, "relative_distance": 777}),
    (apt.Speeds(1, 0, 262, 767_367), {"min_velocity": 0, "acceleration": 262, "max_velocity": 767_367}),
    (apt.Homing(1, 2, 1, 767_367, -200), {
        "home_dir": 2, "limit_switch": 1, "home_velocity": 767_367, "offset_distance": -200,
    }),
    (apt.Status(1, words.HOMED | words.ENABLED | words.LOWER_SWITCH), {
        "homed": True, "homing": False, "channel_enabled": True, "reverse_limit_switch": True,
        "forward_limit_switch": False, "moving_forward": False, "motion_error": False,
    }),
    (apt.Status(1, words.HOMING | 0x20 | 0x4000), {
        "homed": False, "homing": True, "moving_reverse": True, "moving_forward": False, "motion_error": True,
    }),
    (apt.Unasked(Kind.MOT_MOVE_HOMED, b"\1\0", True), {"chan_ident": 1}),
]  # fmt: skip


@pytest.mark.parametrize(("ours", "means"), READ, ids=[type(message).__name__ for message, _ in READ])
def test_a_stranger_reads_what_we_mean(ours, means):
    theirs = pytest.importorskip("thorlabs_apt_protocol", reason="thorlabs-apt-protocol is not installed")
    unpacker = theirs.Unpacker(on_error="raise")
    unpacker.feed(ours.to_bytes())
    read = next(unpacker)._asdict()
    assert {key: read[key] for key in means} == means


# ---- the box, against a client ----------------------------------------------------------------


@pytest.fixture
def kinesis_motor(monkeypatch):
    """The client's class for motors; it pulls RTS on opening, which a pseudo-terminal does not have."""
    thorlabs = pytest.importorskip("pylablib.devices.Thorlabs", reason="pylablib is not installed")
    monkeypatch.setattr(thorlabs.KinesisMotor, "_cycle_rts", staticmethod(lambda instrument: None))
    return thorlabs.KinesisMotor


def test_pylablib_homes_moves_stops_and_reads_the_servo(kinesis_motor):
    motor = Motor(SERVO)
    with (
        box_on_a_port({"1": motor}, model="KDC101") as (path, _),
        kinesis_motor(("serial", path), scale="MTS50-Z8") as client,
    ):
        assert client.get_device_info().model_no == "KDC101"
        assert not client.is_homed()
        client.send_comm(0x0210, 1, 1)
        client.setup_gen_move(backlash_distance=0)
        client.setup_velocity(max_velocity=2e-3, acceleration=4e-3)
        client.home(timeout=20.0)
        assert client.is_homed()
        assert motor.carriage_mm == pytest.approx(0.0, abs=0.001)
        client.move_to(7.5e-3)
        client.wait_move(timeout=20.0)
        assert client.get_position() == pytest.approx(7.5e-3, abs=1e-6)
        assert motor.carriage_mm == pytest.approx(7.5, abs=0.002)
        client.move_by(-2.5e-3)
        client.wait_move(timeout=20.0)
        assert motor.carriage_mm == pytest.approx(5.0, abs=0.002)
        client.move_to(45e-3)
        wait_until(lambda: client.is_moving())
        client.stop(immediate=False, timeout=20.0)
        assert 5.0 < motor.carriage_mm < 44.0
        assert client.get_position() * 1e3 == pytest.approx(motor.carriage_mm, abs=0.002)
        speeds = client.get_velocity_parameters()
        assert speeds.max_velocity == pytest.approx(2e-3, rel=1e-3)


def test_pylablib_drives_a_bay_of_a_rack_and_no_other(kinesis_motor):
    motors = {"bay1": Motor(STEPPER), "bay3": Motor(STEPPER)}
    with (
        box_on_a_port(motors, model="BSC203") as (path, _),
        kinesis_motor(("serial", path), scale="DRV013", is_rack_system=True, default_channel=3) as client,
    ):
        client.set_supported_channels([1, 3])
        assert client._find_bays() == [0, 2]
        client.send_comm(0x0210, 1, 1, dest=("channel", 3))
        client.setup_gen_move(backlash_distance=0)
        client.setup_velocity(max_velocity=5e-3, acceleration=10e-3)
        client.home(timeout=20.0)
        client.move_to(4e-3)
        client.wait_move(timeout=20.0)
        assert motors["bay3"].carriage_mm == pytest.approx(4.0, abs=0.002)
        assert motors["bay1"].carriage_mm == 12.0
