"""docs/devices.md: every word that a driver sends stands there with its source, or is called unproven; no more."""

import re
from pathlib import Path

import pytest

from daq.timing.drivers.pivlab_synchroniser import OltSyncBox, XmSyncBox
from daq.timing.drivers_by_name import DRIVERS as BOXES
from daq.timing.protocols import pivlab_synchroniser as pivlab
from daq.timing.protocols import pulse_box, srs_dg645
from daq.timing.protocols import quantum_composers as qc
from daq.timing.pulses import PairExposures, Pulse
from sim.emulators.pi_gcs2 import StageMake
from sim.timing_boxes.quantum_composers import MODELS
from stages.drivers_by_name import DRIVERS, driver_class
from stages.errors import StageError
from stages.protocols import grbl, isel_dnc, pi_gcs2, thorlabs_apt, zaber_ascii
from stages.protocols.apt_words import Kind
from tests.daq.timing import test_pivlab_synchroniser as sync
from tests.daq.timing import test_srs_dg645 as dg645
from tests.daq.timing.quantum_desk import PUMPED, LaserHead, desk
from tests.daq.timing.test_pulse_box import counter

PAGE = Path(__file__).resolve().parents[2] / "docs" / "devices.md"
STATES = ("foreign client", "foreign firmware", "text", "unproven")


def rows():
    """Section, word, answer, source, bytes, state of every row."""
    section, found = "", []
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            section = line.removeprefix("## `").partition("`")[0]
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 5 and cells[0].startswith("`"):
            word, answer, source, example, state = cells
            found.append((section, word.strip("`").replace("\\|", "|"), answer, source, example.strip("`"), state))
    return found


def words_on_the_page(section):
    return {row[1] for row in rows() if row[0] == section}


# ---- what is sent, as words ------------------------------------------------------------------------


def _numbers(text):
    return re.sub(r"-?\d+(\.\d+)?", "n", text)


def _zaber(message):
    return _numbers(message.text) or "(nothing)"


def _isel(message):
    if isinstance(message, isel_dnc.Stop):
        return "byte 253"
    text = message.to_bytes().decode().strip()
    return "@0" + re.sub(r"n(,n)*", "n", _numbers(text[2:]))


def _pi(message):
    if isinstance(message, pi_gcs2.SingleByte):
        return f"#{message.code}"
    return message.name


def _grbl(message):
    if isinstance(message, grbl.RealTime):
        return "?" if message.code == grbl.STATUS else f"0x{message.code:02x}"
    if message.text.startswith("$J"):
        return "$J=G53G90G21Xn Fn"
    return "Tn" if message.text.startswith("T") else message.text or "(empty line)"


def _apt(message):
    if isinstance(message, thorlabs_apt.SetSpeeds):
        return Kind.MOT_SET_VELPARAMS.name
    return Kind(message.kind).name


def _qc(message):
    keyword = re.sub(r"PULSE\d", "PULSEn", message.keyword)
    return keyword + ("?" if message.asks else "")


def _pivlab(message):
    return message.text if isinstance(message, pivlab.Question) else type(message).__name__.lower()


SPOKEN = {
    "zaber_ascii": (zaber_ascii.CommandStream, _zaber), "isel_dnc": (isel_dnc.CommandStream, _isel),
    "pi_gcs2": (pi_gcs2.CommandStream, _pi), "grbl": (grbl.CommandStream, _grbl),
    "thorlabs_apt": (thorlabs_apt.CommandStream, _apt),
}  # fmt: skip


def words_of(data, stream, word):
    return {word(message) for message in stream().feed(data) if not isinstance(message, Exception)}


VARIANTS = {
    "zaber_ascii": ({}, {"firmware": "6.28"}), "isel_dnc": ({}, {"model": None}),
    "pi_gcs2": ({}, {"stages": StageMake(switches="limits")}, None), "grbl": ({},), "thorlabs_apt": ({},),
}  # fmt: skip


def said_by(bench, driver, monkeypatch):
    """What a driver says in a life: opened, homed, moved, stopped, lost and opened again, and by its watchdog."""
    said = set()
    for firmware in VARIANTS[driver]:
        if firmware is None:  # a chain
            monkeypatch.setattr(driver_class(driver), "example_channels", ("1/1", "2/1"))
        made = bench(driver, firmware=firmware)
        stream, word = SPOKEN[driver]
        heard, feed = [], made.line.emulator.feed
        made.line.emulator.feed = lambda data, heard=heard, feed=feed: (heard.append(data), feed(data))[1]
        made.again()
        made.stage.home()
        made.stage.move({"a": 60.0})
        made.stage.where_mm()
        made.clock.at(made.clock.now_s() + 0.5, made.stage.stop)
        with pytest.raises(StageError):
            made.stage.move({"a": 100.0})
        made.stage.clear_stop()
        made.stage.home()
        made.line.power_cycle(0.1)
        made.clock.sleep_s(3.0)
        made.stage.where_mm()
        data = b"".join(heard) + b"".join(made.controller.watchdog_bytes())
        said |= words_of(data, stream, word)
    return said


@pytest.mark.parametrize("spoken", DRIVERS)
def test_every_word_of_a_stage_driver_stands_on_the_page(bench, spoken, monkeypatch):
    said = said_by(bench, spoken, monkeypatch)
    assert said == words_on_the_page(spoken)


def test_every_word_of_the_pulse_generators_stands_on_the_page():
    said = set()
    for model in MODELS.values():
        for wiring, head in (({}, {}), ({"wiring": PUMPED}, {"head": LaserHead(max_rate_hz=100.0)})):
            with desk(model=model, **wiring, **head) as d:
                heard, feed = [], d.emulator.feed
                d.emulator.feed = lambda data, heard=heard, feed=feed: (heard.append(data), feed(data))[1]
                d.box.gate = "low"
                d.emulator.set_gate(False)
                d.emulator.set_inside(1, "SYNC", "CHB")
                d.emulator.set_inside(0, "MOD", "DCYC")
                d.emulator.set_inside(0, "PER", "0.05")
                d.emulator.set_inside(0, "TRIG:MOD", "TRIG")
                for word, value in (
                    ("POL", "COMP"),
                    ("CGAT", "OUTP"),
                    ("WCO", "1"),
                    ("MUX", "3"),
                    ("CMOD", "DCYC"),
                ):
                    d.emulator.set_inside(2, word, value)
                d.burst() if not wiring else d.to_armed(
                    200.0, 10.0, PairExposures(900.0, 9000.0, 100.0, two_triggers=True)
                )
                d.laser.close()
                said |= words_of(b"".join(heard), qc.CommandStream, _qc)
    assert said == words_on_the_page("qc9510")


def test_every_word_of_the_synchronisers_stands_on_the_page():
    said = set()
    for driver in (OltSyncBox, XmSyncBox):
        with sync.desk(driver) as (laser, emulator, *_):
            heard, feed = [], emulator.feed
            emulator.feed = lambda data, heard=heard, feed=feed: (heard.append(data), feed(data))[1]
            sync.to_armed(laser)
            laser.fire(5)
            laser.wait()
            laser.close()
            said |= words_of(b"".join(heard), pivlab.CommandStream, _pivlab)
    assert said == words_on_the_page("pivlab_oltsync")


def test_every_word_of_the_dg645_stands_on_the_page():
    with dg645.desk() as d:
        heard, feed = [], d.emulator.feed
        d.emulator.feed = lambda data: (heard.append(data), feed(data))[1]
        d.emulator._polarities[1] = 0
        d.to_armed()
        d.burst(3)
        d.laser.close()
    stream = srs_dg645.CommandStream
    assert words_of(b"".join(heard), stream, lambda each: each.word + "?" * each.asks) == words_on_the_page(
        "srs_dg645"
    )


def test_every_word_of_the_pulse_box_stands_on_the_page():
    with counter() as (box, emulator, _):
        heard, feed = [], emulator.feed
        emulator.feed = lambda data: (heard.append(data), feed(data))[1]
        box.connect("sim://counter")
        box.expect(1e5, Pulse(0.0, 10.0))
        box.stop()
    names = ("version", "start", "stop", "interval", "length", "waits", "pulses")
    found = pulse_box.CommandStream().feed(b"".join(heard))
    assert {names[each.code] for each in found} == words_on_the_page("counter")


def test_every_row_has_a_source_or_is_called_unproven():
    found = rows()
    assert len(found) > 60
    for section, word, answer, source, example, state in found:
        where = (section, word)
        assert answer, where
        assert example, where
        assert re.split("[:;]", state)[0] in STATES, where
        assert (len(source) > 5) or state == "unproven", where
        assert ("unproven" in state) or re.search(r"(?i)\d|manual|protocol|guide|md\b|source", source), where


def test_every_box_of_a_bench_file_has_a_section():
    text = PAGE.read_text()
    for name in (*DRIVERS, *BOXES):
        assert f"`{name}`" in text, name
