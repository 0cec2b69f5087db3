"""A box is named by questions alone, at the rate that it has; what it said is a file that answers it again."""

import re
from contextlib import contextmanager

import pytest

from daq.bench.probe import RATES, Found, no_reply_reason, probe
from rtpiv.command_line.cli import DEVICE, DONE, main
from sim.emulators.device import Emulator
from sim.emulators.line import Line
from sim.emulators.pi_gcs2 import PiEmulator
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from sim.stages import SimulatedStages
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from sim.timing_boxes.quantum_composers import MODELS, QuantumComposersEmulator, Variant
from stages.drivers.pi_gcs2 import PiController
from stages.drivers_by_name import DRIVERS
from stages.errors import PortUnavailable
from tests.stages.benches import screws, stages_table

QUESTIONS = (  # every line that may be sent, whoever listens
    rb"/\d+ 0( get (deviceid|system\.serial|version|system\.axiscount))?", rb"(\d+ )?(\*IDN\?|CSV\?|SAI\?)",
    rb":(PULSE\d:(STAT|ICL|ICL:MOD)|INST:CAT|SYST:AUT)\?", rb"\$I|\?|@0[VP]|", rb"WhoAreYou\?|WhichFirmWare\?",
    rb"\x05\x00\x00\x00[\x50\x11]\x01|\x00\x32\x00\x00\x00\x00",
)  # fmt: skip


class ZaberInBinary(Emulator):
    """An A-series device as it ships."""

    def _take(self, data):
        if data == bytes((0, 50, 0, 0, 0, 0)):
            self.say(bytes((1, 50)) + (20_021).to_bytes(4, "little"))


@contextmanager
def on_a_line(emulator, clock, baud):
    line = Line(emulator, clock)
    line.baud = baud
    LINES["probed"] = line
    try:
        yield line
    finally:
        LINES.pop("probed")


@contextmanager
def stage_box(kind, clock, baud):
    table = stages_table(kind)
    world = SimulatedStages(table, clock, screws(table))
    with world.in_process() as table:
        line = LINES[table.controllers["box"].port.removeprefix("sim://")]
        before = [world.true_mm(name) for name in "ab"]
        line.baud = baud
        LINES["probed"] = line
        yield line
        LINES.pop("probed")
        clock.sleep_s(5.0)
        assert [world.true_mm(name) for name in "ab"] == before


def sent_of(asked):
    return [bytes.fromhex(line[2:]) for line in asked.dialogue if line.startswith("> ")]


def only_questions(asked):
    for data in sent_of(asked):
        for line in re.split(rb"[\r\n]+", data):
            assert any(re.fullmatch(each, line) for each in QUESTIONS), line
    return True


@pytest.mark.parametrize(("kind", "baud", "box", "facts"), [
    ("zaber_ascii", 115_200, "Zaber devices", "firmware 7.33, 2 axes"),
    ("pi_gcs2", 38_400, "PI controller", "command set 2.0"), ("pi_gcs2", 115_200, "PI controller", "axes 1, 2"),
    ("grbl", 115_200, "Grbl board", "state Alarm"), ("thorlabs_apt", 115_200, "Thorlabs box", "firmware 3.0.2"),
    ("isel_dnc", 9600, "isel controller", "not initialised"), ("isel_dnc", 19_200, "isel controller", "position"),
])  # fmt: skip
def test_a_stage_box_is_named(tmp_path, kind, baud, box, facts):
    clock = VirtualClock()
    with stage_box(kind, clock, baud):
        found, asked = probe("sim://probed", clock)
    assert found is not None
    assert (found.box, found.baud) == (box, baud)
    assert facts in " ".join(found.facts)
    assert f"driver: {kind}" in found.lines
    assert (f"baud: {baud}" in found.lines) is (baud not in (115_200, 19_200))
    assert only_questions(asked)


def test_every_driver_is_probed_for():
    assert set(DRIVERS) == {"zaber_ascii", "pi_gcs2", "grbl", "thorlabs_apt", "isel_dnc"}


@pytest.mark.parametrize(("box", "model"), MODELS.items())
@pytest.mark.parametrize("baud", [38_400, 115_200])
def test_a_pulse_generator_is_named_and_goes_on_as_it_was(tmp_path, box, model, baud):
    clock = VirtualClock()
    emulator = QuantumComposersEmulator(clock, Variant(model))
    emulator.set_inside(2, "STAT", "1")
    emulator.set_inside(0, "STAT", "1")
    words = [dict(channel.words) for channel in emulator._all]
    with on_a_line(emulator, clock, baud):
        found, asked = probe("sim://probed", clock)
    assert found is not None
    assert f"box: {box}" in found.lines
    assert "on now: T0, B" in found.facts
    word = "its clock has a mode" if box in ("qc9530", "bnc577") else "its clock is one word"
    assert any(word in fact for fact in found.facts)
    assert [dict(channel.words) for channel in emulator._all] == words
    assert emulator.is_on_at(0)
    assert emulator.is_on_at(2)
    assert only_questions(asked)


@pytest.mark.parametrize(("made", "box"), [(OltSyncEmulator, "pivlab_oltsync"), (XmSyncEmulator, "pivlab_xmsync")])
def test_a_synchroniser_is_named(made, box):
    clock = VirtualClock()
    emulator = made(clock)
    with on_a_line(emulator, clock, 9600):
        found, asked = probe("sim://probed", clock)
    assert found is not None
    assert f"box: {box}" in found.lines
    assert not emulator.is_running
    assert only_questions(asked)


def test_zaber_devices_in_binary_are_named_with_their_cure():
    clock = VirtualClock()
    with on_a_line(ZaberInBinary({}, clock), clock, 9600):
        found, _ = probe("sim://probed", clock)
    assert found == Found(
        "Zaber devices in Binary", "Zaber, Binary protocol", 9600, ("device 1: id 20021",), found.unknown,
        found.lines,
    )  # fmt: skip
    assert "set the devices to ASCII at 115200" in found.lines


def test_a_chain_of_pi_controllers_is_named_by_address(monkeypatch):
    monkeypatch.setattr(PiController, "example_channels", ("1/1", "3/1"))
    clock = VirtualClock()
    with stage_box("pi_gcs2", clock, 38_400):
        found, asked = probe("sim://probed", clock)
    assert found is not None
    assert '"1/1", "3/1"' in found.lines
    assert only_questions(asked)


def test_a_controller_of_gcs_3_is_named_with_its_cure_and_without_bench_lines():
    clock = VirtualClock()
    motors = {"1": Motor(Mechanics(lead_mm=1.0, steps_per_rev=2000, high_switch_mm=100.0))}
    with on_a_line(PiEmulator(motors, clock, command_set="3.0"), clock, 115_200):
        found, asked = probe("sim://probed", clock)
    assert "command set 3.0" in found.facts
    assert "GCS 3 is not spoken here" in found.lines
    assert "driver:" not in found.lines
    assert only_questions(asked)


def test_nobody_is_said_so_with_what_came(tmp_path, monkeypatch, capsys):
    class Mumbles(Emulator):
        def _take(self, data):
            self.say(b"\x8f\x02")

    clock = VirtualClock()
    monkeypatch.chdir(tmp_path)
    for emulator, words in ((Emulator, "says nothing"), (Mumbles, "bytes that are no answer (8f 02")):
        made = type("Mute", (Emulator,), {"_take": lambda self, data: None}) if emulator is Emulator else emulator
        with on_a_line(made({}, clock), clock, None):
            found, asked = probe("sim://probed", clock)
        assert found is None
        assert words in no_reply_reason(asked)
    assert "115200, 38400, 19200, 9600, 57600 baud" in no_reply_reason(asked)
    assert len([line for line in asked.dialogue if line.startswith("@")]) == len(RATES)
    with pytest.raises(PortUnavailable):
        probe("/dev/no-port")
    assert main(["doctor", "--probe", "/dev/no-port"]) == DEVICE
    assert "does not exist" in capsys.readouterr().err


def test_the_verb_writes_what_was_said(tmp_path, monkeypatch, capsys):
    clock = VirtualClock()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("daq.bench.probe.SYSTEM_CLOCK", clock)
    monkeypatch.setattr("rtpiv.verbs.probe.ask_port", lambda port: probe(port, clock))
    with on_a_line(QuantumComposersEmulator(clock, Variant("BNC,575-8")), clock, 38_400):
        assert main(["doctor", "--probe", "sim://probed"]) == DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "BNC,575-8,02311" in said
    assert "box: bnc575" in said
    text = (tmp_path / "probe-sim-probed.txt").read_text()
    assert text.startswith("# rtpiv doctor --probe sim://probed: BNC,575-8")
    assert "> 2a 49 44 4e 3f 0d 0a" in text
