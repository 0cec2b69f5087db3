"""Documented and recorded dialogues, replayed against the emulators."""

import fnmatch
import json
from functools import partial
from pathlib import Path

from sim.emulators import emulator_class
from sim.emulators.isel_dnc import IselEmulator
from sim.mechanics.clock import VirtualClock
from sim.mechanics.motion import Mechanics, Motor
from sim.timing_boxes import pivlab_synchroniser, quantum_composers, srs_dg645
from stages.drivers_by_name import DRIVERS
from tests.loops import loop_over

TIMING = {
    "quantum_composers": quantum_composers.EMULATOR, "pivlab_synchroniser": pivlab_synchroniser.EMULATOR,
    "srs_dg645": srs_dg645.EMULATOR,
}  # fmt: skip
HEXADECIMAL = ("thorlabs_apt",)  # what has no text is written as its bytes, a message a line
FOLDER = Path(__file__).parent / "dialogues"
SCREW = Mechanics(lead_mm=5.0, steps_per_rev=1600, high_switch_mm=200.0, index_mm=100.0, power_up_mm=60.0)


def dialogues():
    for protocol in (*DRIVERS, *TIMING):
        path = FOLDER / f"{protocol}.txt"
        assert path.exists(), f"{protocol} has no documented dialogue"
        head, *parts = path.read_text().split("\n== ")
        setup = json.loads(next(line for line in head.splitlines() if line.startswith("@")).removeprefix("@"))
        for part in parts:
            title, *lines = part.splitlines()
            yield f"{protocol}: {title}", protocol, setup, lines


def spoken(text):
    return text.encode("latin-1").decode("unicode_escape").encode("latin-1")


class Replay:
    def __init__(self, protocol, setup):
        self.clock = VirtualClock()
        motors = {name: Motor(SCREW) for name in setup["motors"]}
        options = {key: value for key, value in setup.items() if key != "motors"}
        if "settings" in options:
            options["settings"] = {int(number): value for number, value in options["settings"].items()}
        if "variant" in options:
            options["variant"] = quantum_composers.Variant(**options["variant"])
        made = TIMING[protocol] if protocol in TIMING else partial(emulator_class(protocol), motors)
        self.device = made(self.clock, **options)
        self.framed = protocol != "isel_dnc"
        self.is_hexadecimal = protocol in HEXADECIMAL
        self.heard = []

    def listen(self):
        if self.is_hexadecimal:
            self.heard += [said.data.hex(" ") for said in self.device.take_answers()]
            return
        data = b"".join(said.data for said in self.device.take_answers()).decode("latin-1")
        if self.framed:
            self.heard += [line.removesuffix("\r") for line in data.split("\n") if line.strip("\r")]
        elif data:
            self.heard.append(data)

    def step(self, line):
        verb, _, rest = line.partition(" ")
        if verb == ">":
            self.device.feed(bytes.fromhex(rest) if self.is_hexadecimal else spoken(rest))
            self.clock.sleep_s(0.001)
            self.listen()
        elif verb == "wait":
            self.clock.sleep_s(float(rest))
            self.listen()
        elif verb == "homed":
            for quiet in ("> $H\\n", "wait 120"):
                self.step(quiet)
            assert self.heard.pop(0) == "ok"
        elif verb == "<":
            pattern = rest.replace("_", " ") if rest.endswith("_") else spoken(rest).decode("latin-1")
            assert self.heard, f"nothing heard where {rest!r} was expected"
            heard = self.heard.pop(0)
            assert fnmatch.fnmatchcase(heard, pattern), f"{heard!r} is not {rest!r}"


@loop_over("title, protocol, setup, lines", dialogues())
def test_documented_dialogue(title, protocol, setup, lines):
    replay = Replay(protocol, setup)
    for line in lines:
        if line and not line.startswith("#"):
            before = list(replay.heard)
            assert line.startswith("<") or line.startswith("wait") or not before, f"unexpected: {before}"
            replay.step(line)
    assert not replay.heard


def test_a_c142_knows_no_version():
    device = IselEmulator({"X": Motor(SCREW)}, VirtualClock(), model=None)
    device.feed(b"@0V\r@01\r@0J100\r")
    assert b"".join(said.data for said in device.take_answers()) == b"505"


def test_an_isel_box_has_inputs_and_outputs():
    device = IselEmulator({"X": Motor(SCREW)}, VirtualClock())
    device.feed(b"@0b0\r@0B0,8\r@0B0,256\r@0B0\r")
    assert [said.data for said in device.take_answers()] == [b"000", b"0", b"1", b"5"]
