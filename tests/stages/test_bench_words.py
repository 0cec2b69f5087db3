"""The first day at a bench: each way in which a box does not answer is a sentence of its own, with its cure."""

from contextlib import ExitStack, nullcontext

import pytest
import serial

from sim.emulators.device import Emulator
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES, put_up
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock, VirtualClock
from sim.stages import SimulatedStages
from stages.config import StagesTable
from stages.controller import Channel
from stages.drivers_by_name import DRIVERS, driver_class
from stages.errors import (
    CommandRejected,
    DeviceLost,
    NoReply,
    PortUnavailable,
    StageError,
    StageUsageError,
    WrongDevice,
)
from stages.stage import Stage
from stages.who_answers import kind_of_box
from tests.loops import loop_over
from tests.stages.benches import screws, stages_table

USUAL = {"zaber_ascii": 115_200, "isel_dnc": 19_200, "pi_gcs2": 115_200, "grbl": 115_200, "thorlabs_apt": 115_200}


class Mute(Emulator):
    """Hears everything and says nothing."""

    def _take(self, data):
        pass


def driver_of(sort_of_box, clock=None):
    made = driver_class(sort_of_box)
    names = made.example_channels
    scale = 400.0 if made.counts_steps else None
    return made("rail", {name: Channel(name, scale) for name in names}, clock or VirtualClock())


@pytest.fixture
def box(request):
    """Put a box of any sort_of_box on a line in memory; the line."""

    def put(sort_of_box, baud=None):
        clock, table = VirtualClock(), stages_table(sort_of_box)
        world = SimulatedStages(table, clock, screws(table))
        table = request.getfixturevalue("stack").enter_context(world.in_process())
        url = table.controllers["box"].port
        line = LINES[url.removeprefix("sim://")]
        line.baud = baud
        return url, line, clock

    return put


@pytest.fixture
def stack():
    with ExitStack() as up:
        yield up


@pytest.fixture
def mute():
    clock = VirtualClock()
    with put_up(Line(Mute({}, clock), clock)) as url:
        yield url, clock


@pytest.mark.parametrize("sort_of_box", DRIVERS)
def test_silence(mute, sort_of_box):
    url, clock = mute
    rate = USUAL[sort_of_box]
    words = rf"rail on {url} at {rate} baud says nothing; is it switched on, .* rtpiv doctor --probe {url}"
    with pytest.raises(NoReply, match=words):
        driver_of(sort_of_box, clock).connect(url)


@pytest.mark.parametrize("sort_of_box", ["zaber_ascii", "grbl", "pi_gcs2", "isel_dnc"])
def test_a_wrong_rate(box, sort_of_box):
    url, _, clock = box(sort_of_box, baud=57_600)
    with pytest.raises(
        StageError, match=r"rail on sim://.* at \d+ baud (gives \d+ bytes that are no|says nothing)"
    ):
        driver_of(sort_of_box, clock).connect(url)
    assert driver_of(sort_of_box, clock).connect(url, 57_600)


@pytest.mark.parametrize(("sort_of_box", "rate"), [("pi_gcs2", 38_400), ("pi_gcs2", 9600), ("isel_dnc", 9600)])
def test_a_usual_rate_is_tried_where_the_bench_says_none(box, sort_of_box, rate):
    """PI: 38400 by the front switches; C142: 9600 (the protocol file of an open client)."""
    url, _, clock = box(sort_of_box, baud=rate)
    made = driver_of(sort_of_box, clock)
    assert made.connect(url)
    assert made.baud == rate
    made.close()
    with pytest.raises(NoReply):
        driver_of(sort_of_box, clock).connect(
            url, USUAL[sort_of_box]
        )  # what a bench file says is taken at its word


@pytest.mark.parametrize(("meant", "there", "words"), [
    ("grbl", "zaber_ascii", "says nothing; is it switched on, is its cable in this socket"),
    ("zaber_ascii", "grbl", "a Grbl board .driver: grbl"),
    ("pi_gcs2", "grbl", "a Grbl board .driver: grbl"),
    ("isel_dnc", "grbl", "a Grbl board .driver: grbl"),
    ("grbl", "isel_dnc", "gives . bytes|gives .. bytes|says nothing"),
])  # fmt: skip
def test_a_wrong_protocol_or_a_swapped_cable(box, meant, there, words):
    url, _, clock = box(there)
    with pytest.raises(StageError, match=rf"rail on sim://.* ({words})") as caught:
        driver_of(meant, clock).connect(url)
    assert "probe" in str(caught.value)


@pytest.mark.parametrize("sort_of_box", DRIVERS)
def test_a_box_that_falls_silent_half_way(box, sort_of_box):
    url, line, clock = box(sort_of_box)
    made = driver_of(sort_of_box, clock)
    made.connect(url)
    channel = made.example_channels[0]
    line.emulator.switch_off()
    words = rf"rail on sim://.* at {USUAL[sort_of_box]} baud has answered before .* switched off"
    with pytest.raises(NoReply, match=words):
        made.position_mm(channel)
    line.unplug()
    with pytest.raises(DeviceLost, match="plug it in"):
        made.position_mm(channel)


def test_a_port_that_is_not_there_busy_or_forbidden(tmp_path, monkeypatch):
    with pytest.raises(
        PortUnavailable, match=r"rail .115200 baud.: /dev/no-port does not exist; is the controller"
    ):
        driver_of("grbl").connect("/dev/no-port")
    clock = ScaledClock()
    with PtyPort(Line(Mute({}, clock), clock)) as port:
        holder = serial.Serial(port.path, exclusive=True)
        with pytest.raises(PortUnavailable, match=r"rail .19200 baud.: /dev/.* is in use by another process"):
            driver_of("isel_dnc", clock).connect(port.path)
        holder.close()

    def forbidden(self):
        raise serial.SerialException(13, "Permission denied")

    monkeypatch.setattr("serial.Serial.open", forbidden)
    with pytest.raises(PortUnavailable, match=r"rail .*may not be opened by this user; add the user to the group"):
        driver_of("grbl", clock).connect("/dev/ttyUSB9")


@pytest.mark.parametrize(("said", "sort_of_box"), [
    (b"QC,9528,02311,1.2\r\n", "box: qc9520"), (b"?3\r\n", "box: qc9520"), (b"ok\r\n", "driver: grbl"),
    (b"oltSync:0012\r\n", "pivlab_oltsync"), (b"\x06\x00T\x00\x81\x50", "thorlabs_apt"), (b"5", None), (b"", None),
])  # fmt: skip
def test_a_hand_is_read(said, sort_of_box):
    found = kind_of_box(said)
    assert found is None if sort_of_box is None else sort_of_box in found


def test_isel_speeds_are_the_boxs_to_refuse():
    """The guide ends at 10 000 steps/s, other drivers run 20 000."""
    made = driver_of("isel_dnc")
    made.check_motion("X", 20_000 / 400.0, 100.0)
    with pytest.raises(StageUsageError, match="speed must be"):
        made.check_motion("X", 31_000 / 400.0, 100.0)


SLOW = {"speed_mm_s": 20.0, "approach": {"side": "from_below", "distance_mm": 0.1, "speed_mm_s": 0.05}}


@loop_over("firmware, motion, moves", [
    ({"fastest": 10_000}, {"speed_mm_s": 50.0}, False), ({"fastest": 30_000}, {"speed_mm_s": 50.0}, True),
    ({"slowest": 30}, SLOW, False), ({"slowest": 10}, SLOW, True),
])  # fmt: skip
def test_speeds_of_a_box_are_its_own_to_refuse(bench, firmware, motion, moves):
    made = bench("isel_dnc", firmware=firmware, **motion).homed()
    with nullcontext() if moves else pytest.raises(CommandRejected, match=r"allowed \(D\).* change speed_mm_s"):
        for target_mm in (60.0, 60.05):  # the second by an approach
            made.stage.move({"a": target_mm})
        assert made.world.true_mm("a") == pytest.approx(60.05, abs=0.1)


class Echo(Emulator):
    """Gives back what it is sent, and may answer as well."""

    answer = b""

    def _take(self, data):
        self.say(data + self.answer)


@loop_over("answer", [b"", b"\r\nok\r\n"])
@loop_over("sort_of_box", DRIVERS)
def test_a_line_with_echo(sort_of_box, answer):
    clock = VirtualClock()
    line = Line(Echo({}, clock), clock)
    line.emulator.answer = answer
    with (
        put_up(line) as url,
        pytest.raises(NoReply, match="gives back what it is sent; switch the") as caught,
    ):
        driver_of(sort_of_box, clock).connect(url)
    assert "swapped" not in str(caught.value)


class OldGrbl(Emulator):
    """Grbl 0.9j, as users of Universal G-code Sender have recorded it."""

    def _take(self, data):
        for line in data.replace(b"?", b"?\n").splitlines():
            if line == b"?":
                self.say(b"<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>\r\n")
            elif line == b"$I":
                self.say(b"[0.9j.20160303:]\r\nok\r\n")
            elif line:
                self.say(b"Grbl 0.9j ['$' for help]\r\n" if line == b"\x18" else b"ok\r\n")


def test_an_old_grbl_is_told_which_one_is_needed():
    clock = VirtualClock()
    words = r"has Grbl 0\.9 or older, and Grbl 1\.1 is needed"
    with put_up(Line(OldGrbl({}, clock), clock)) as url, pytest.raises(NoReply, match=words) as caught:
        driver_of("grbl", clock).connect(url)
    assert "swapped" not in str(caught.value)


class BabblingGrbl(Emulator):
    """A board whose answers are cut."""

    def _take(self, data):
        self.say(b"[VER:1.1h.2019\r\nok\r\n")


def test_the_right_driver_is_not_called_the_wrong_one():
    clock = VirtualClock()
    words = "none that is whole; is the cable good"
    with put_up(Line(BabblingGrbl({}, clock), clock)) as url, pytest.raises(NoReply, match=words) as caught:
        driver_of("grbl", clock).connect(url)
    assert "swapped" not in str(caught.value)


@loop_over("reports", [0, 2, 510])
def test_work_positions_are_refused_before_anything_moves(bench, reports):
    with pytest.raises(WrongDevice, match=r"set \$10=1 on the board"):
        bench("grbl", firmware={"settings": {10: reports}})
    assert bench("grbl", firmware={"settings": {10: reports + 1}}).controller.identity


def test_two_boxes_on_one_port_are_named(tmp_path):
    table = stages_table("grbl").model_dump(exclude_none=True)
    (tmp_path / "by-id").symlink_to("/dev/ttyUSB7")
    for port, other in (("/dev/ttyUSB7", "/dev/ttyUSB7"), ("/dev/ttyUSB7", str(tmp_path / "by-id"))):
        table["controllers"] = {
            "portal": {"driver": "grbl", "port": port},
            "rail": {"driver": "isel_dnc", "port": other},
            "box": {"driver": "grbl", "port": "/dev/ttyUSB8"},
        }
        with pytest.raises(StageUsageError, match=r"portal and rail have the same port /dev/ttyUSB7; give each"):
            Stage(StagesTable.model_validate(table))


@pytest.mark.parametrize("model", ["SCC201", "SCC203", "SCC101"])
def test_a_rack_that_calls_itself_by_its_card_goes_like_its_rack(bench, model):
    made = bench("thorlabs_apt", firmware={"model": model}).homed({"a": 10.0})
    begun_s = made.clock.now_s()
    made.stage.move({"a": 110.0})
    assert 100.0 / 20.0 < made.clock.now_s() - begun_s < 100.0 / 20.0 + 1.5
