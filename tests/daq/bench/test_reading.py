"""Readings of the lab: from a file that grows, from a box that is asked or streams; silent ones are missing."""

import math
import time
from datetime import UTC, datetime, timedelta

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.gauges import FileGauge, PortGauge
from daq.bench.kinds import kind_of
from daq.bench.reading import ReadingSection
from daq.errors import ReadingMissing
from daq.runner.progress import Progress
from daq.runner.step_readings import Gauges
from ground.errors import ConfigError
from sim.emulators.device import Emulator
from sim.emulators.flow_meter import FlowMeter
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock, VirtualClock
from stages.clock import SYSTEM_CLOCK
from tests.daq.small_bench import write_bench

FOUND = r"F=([-+\d.]+)"


def from_file(path, text, **more):
    path.write_text(text)
    return FileGauge(ReadingSection(unit="l/min", file="meter.csv", **more), path).reading()


def stamp(age_s=0.0):
    return (datetime.now(UTC) - timedelta(seconds=age_s)).isoformat()


def test_the_newest_whole_row_of_a_file_counts(tmp_path):
    path, now = tmp_path / "meter.csv", time.time()
    found = from_file(path, f"time,flow,T\n{now - 3},5.1,20.5\n{now - 1},5.3,20.7\n{now},9")
    assert (found.value, found.unit, found.missing) == (5.3, "l/min", "")
    assert datetime.fromisoformat(found.utc).timestamp() == pytest.approx(now - 1, abs=2e-3)
    assert from_file(path, f"{stamp()};5.1;20.5\r\n", column=3).value == 20.5
    assert from_file(path, "x" * 200_000 + f"\n{stamp()}\t4\n").value == 4.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no row with 2 columns"),
        ("time,flow\n", "'time' is not a time"),
        ("{old},5.2\n", "30 s old"),
        ("{coming},5.2\n", "30 s in the future"),
        ("{now},\n", "'' is no number"),
        ("{now},1O.0\n", "'1O.0' is no number"),
        ("{now},nan\n", "'nan' is no value"),
        ("1e400,5.2\n", "is not a time"),
        ("\x00\x00\n", "no row with 2 columns"),
    ],
)
def test_a_row_that_says_nothing_is_missing(tmp_path, text, words):
    told = text.format(old=stamp(30.0), coming=stamp(-30.0), now=stamp())
    found = from_file(tmp_path / "meter.csv", told)
    assert words in found.missing
    assert math.isnan(found.value)
    assert "value" not in found.to_dict()


def test_a_file_that_is_not_there_or_is_none_is_missing(tmp_path):
    section = ReadingSection(unit="", file="meter.csv")
    assert "No such file" in FileGauge(section, tmp_path / "meter.csv").reading().missing
    assert FileGauge(section, tmp_path).reading().missing


@pytest.fixture
def meter():
    clock = ScaledClock(1.0)
    emulator = FlowMeter(clock)
    with PtyPort(Line(emulator, clock)) as port:
        yield emulator, port.path


def test_a_meter_is_asked_and_falls_silent_and_speaks_again(meter):
    emulator, path = meter
    gauge = PortGauge(ReadingSection(unit="l/min", port=path, ask="F?\r\n", find=FOUND, wait_s=0.3), SYSTEM_CLOCK)
    try:
        assert gauge.reading().value == pytest.approx(5.2, rel=0.011)
        emulator.is_silent = True
        assert "no answer" in gauge.reading().missing
        emulator.is_silent = False
        assert gauge.reading().missing == ""
    finally:
        gauge.close()


def test_a_stream_gives_what_flows_now_and_not_what_lay_in_the_buffer(meter):
    emulator, path = meter
    section = ReadingSection(unit="l/min", port=path, find=FOUND)
    gauge = PortGauge(section, SYSTEM_CLOCK)
    try:
        gauge._open_port().write(b"S1\r\n")
        assert gauge.reading().value == pytest.approx(5.2, rel=0.011)
        time.sleep(0.35)
        emulator.flow = 8.0
        time.sleep(0.15)  # a line that was being sent has arrived; lines of before lie in front of it
        assert gauge.reading().value == pytest.approx(8.0, rel=0.011)
    finally:
        gauge.close()


def test_a_stream_without_a_pause_is_read_at_once(monkeypatch):
    """Lines every 5 ms: to wait until nothing comes would be to wait for ever."""
    monkeypatch.setattr("sim.emulators.flow_meter.EVERY_S", 0.005)
    clock = VirtualClock()
    monkeypatch.setitem(LINES, "stream", Line(FlowMeter(clock), clock))
    gauge = PortGauge(ReadingSection(unit="l/min", port="sim://stream", find=FOUND), clock)
    try:
        gauge._open_port().write(b"S1\r\n")
        clock.sleep_s(1.0)
        begun_s = clock.now_s()
        assert gauge.reading().value == pytest.approx(5.2, rel=0.011)
        assert clock.now_s() - begun_s < 0.1
    finally:
        gauge.close()


class Babbler(Emulator):
    """Says whatever it was told to, asked or not."""

    def __init__(self, clock, words):
        super().__init__({}, clock)
        self.words = words

    def _take(self, data):
        self.say(self.words)


@pytest.mark.parametrize(
    ("words", "more", "told"),
    [
        (b"x" * 5000, {}, "without the end of a line"),
        (b"\xff\xfe?\n", {}, "is not what find looks for"),
        (b"1,2\n", {"column": 3}, "has no column 3"),
        (b"1,two\n", {"column": 2}, "'two' is no number"),
        (b"1e999\n", {}, "is no value"),
        (b"half", {}, "no answer"),
    ],
)
def test_what_comes_over_the_wire_is_not_believed(words, more, told):
    clock = ScaledClock(1.0)
    with PtyPort(Line(Babbler(clock, words), clock)) as port:
        gauge = PortGauge(ReadingSection(unit="", port=port.path, ask="?", wait_s=0.2, **more), SYSTEM_CLOCK)
        try:
            found = gauge.reading()
        finally:
            gauge.close()
    assert told in found.missing


def test_a_port_that_is_not_there_is_looked_for_again(meter, tmp_path):
    path = tmp_path / "meter"
    gauge = PortGauge(ReadingSection(unit="", port=str(path), ask="F?\r\n"), SYSTEM_CLOCK)
    assert str(path) in gauge.reading().missing
    path.symlink_to(meter[1])
    try:
        assert gauge.reading().value > 0.0
    finally:
        gauge.close()


class Scripted:
    """A gauge that shows one thing after the other."""

    def __init__(self, *texts):
        self.texts = list(texts)

    def reading(self):
        from daq.bench.reading import reading_of

        return reading_of(ReadingSection(unit="C", file="f"), self.texts.pop(0), datetime.now(UTC))


def test_a_silent_gauge_is_said_once_each_time_and_stops_only_who_needs_it():
    progress, gauges = Progress(), Gauges({"T": Scripted("20", "-", "-", "21", "-"), "camera": object()})
    found = [gauges.read(progress) for _ in range(5)]
    assert [one["T"].get("value") for one in found] == [20.0, None, None, 21.0, None]
    assert [remark.split(":")[0] for remark in progress.remarks] == ["no reading of T"] * 2
    with pytest.raises(ReadingMissing, match="no reading of T, which the plan needs: '-' is no number"):
        Gauges({"T": Scripted("-")}, {"T"}).read(progress)


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("{kind: reading, unit: C}", "comes from a file or a port"),
        ("{kind: reading, unit: C, file: a.csv, port: b}", "comes from a file or a port"),
        ("{kind: reading, unit: C, file: a.csv, baud: 9600}", "receives no query; remove baud"),
        ("{kind: reading, unit: C, file: a.csv, column: 1}", "is the time of its rows"),
        ("{kind: reading, unit: C, port: a, oldest_s: 3}", "leave oldest_s out"),
        ("{kind: reading, unit: C, port: a, find: '(', }", "not a regular expression"),
        ("{kind: reading, unit: C, port: a, find: 'F=', }", "needs a group"),
        ("{kind: reading, unit: C, port: a, colum: 2}", "unknown key 'colum'"),
        ("{kind: reading, file: a.csv}", "unit"),
    ],
)
def test_what_is_wrong_in_a_bench_file_is_said_with_its_line(tmp_path, device, words):
    path = write_bench(tmp_path)
    path.write_text(path.read_text() + f"devices:\n  T: {device}\n")
    with pytest.raises(ConfigError, match=rf"bench\.yaml:\d+: .*{words}"):
        load_bench(path)


def test_its_place_is_said():
    section = ReadingSection(unit="C", file="meter.csv")
    assert list(kind_of("reading").places(section)) == ["reading: meter.csv"]
