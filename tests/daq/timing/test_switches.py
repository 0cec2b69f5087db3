"""Door, shutter and key: read before and while light is on, dark within 50 ms, and doubt is no light."""

import io
import os
import re
import signal
import threading
import time
from contextlib import contextmanager

import pytest
from pydantic import ValidationError

from daq.bench.opened import open_bench
from daq.timing.errors import LaserDoubt, LaserStopped, NotArmed, NotNow
from daq.timing.in_use import OffRequest
from daq.timing.opened import open_laser
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import LaserState
from daq.timing.switches import NO_SWITCH, Switches, SwitchTable
from daq.timing.timing_table import TimingTable
from ground.config import Table
from ground.errors import UntrustedProgram
from rtpiv.verbs.operator import TerminalOperator
from sim.emulators.line import Line
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import ScaledClock
from sim.timing import CLOSED
from sim.timing_boxes.quantum_composers import QuantumComposersEmulator
from stages.clock import SYSTEM_CLOCK
from stages.errors import PortUnavailable, StageUsageError
from stages.port import ModemLine
from stages.watchdog import SHORT_LIFE_S
from tests.daq.bench.test_timing_kind import bench_with
from tests.daq.timing.armed_laser import GOOD, armed
from tests.daq.timing.quantum_desk import PUMPED, desk


class Contact:
    """A switch that a test opens; it notes when it was first read open."""

    made: "Contact"

    def __init__(self):
        self.closed, self.read_open_s = True, None
        Contact.made = self

    def is_closed(self):
        if self.closed is None:
            raise OSError("pulled out")
        if not self.closed and self.read_open_s is None:
            self.read_open_s = time.monotonic()
        return self.closed

    def close(self):
        self.closed = None


DOORS = int(os.environ.get("RTPIV_DOORS", "40"))
BY_TEST = SwitchTable(by="tests.daq.timing.test_switches:Contact")


def test_a_modem_line_is_a_switch():
    line = ModemLine("loop://", "cts")  # whose RTS is wired to its CTS
    assert line.is_closed()
    line._serial.rts = False
    assert not line.is_closed()
    line.close()


def test_a_port_without_modem_lines_is_refused():
    clock = ScaledClock()
    box, words = QuantumComposersEmulator(clock), "has no line CTS that could be read"
    with PtyPort(Line(box, clock)) as port, pytest.raises(PortUnavailable, match=words):
        ModemLine(port.path, "cts")
    with pytest.raises(PortUnavailable, match="does not exist"):
        ModemLine("/dev/no-switch", "dsr")


@pytest.mark.parametrize("words", [
    {}, {"port": "/dev/one"}, {"line": "cts"}, {"by": "nothing"}, {"by": "a:B", "port": "/dev/one"},
    {"port": "/dev/one", "line": "rts"}, {"port": "/dev/one", "line": "cts", "options": {"a": 1}},
])  # fmt: skip
def test_half_a_switch_is_refused(words):
    with pytest.raises(ValidationError):
        SwitchTable(**words)
    assert issubclass(SwitchTable, Table)


@pytest.fixture(autouse=True)
def trusted(monkeypatch):
    monkeypatch.setenv("RTPIV_TRUST", f"{BY_TEST.by},tests.daq:Nothing")


def test_a_program_that_nobody_trusts_is_not_called(monkeypatch):
    monkeypatch.setenv("RTPIV_TRUST", "")
    with pytest.raises(UntrustedProgram):
        Switches.open({"door": BY_TEST})


def test_a_program_that_is_no_switch_is_one_sentence():
    with pytest.raises(StageUsageError, match=r"the switch tests\.daq:Nothing cannot be opened"):
        Switches.open({"door": BY_TEST, "key": SwitchTable(by="tests.daq:Nothing")})
    assert Contact.made.closed is None, "what was opened before is given back"


@pytest.mark.parametrize(
    ("closed", "words"), [(False, "the switch of the door is open"), (None, "cannot be read")]
)
def test_an_open_door_is_found_before_anything_is_armed_fired_or_aligned(closed, words):
    laser, box, _ = armed()
    laser.switches = Switches({"key": Contact(), "door": Contact()})
    for name in ("key", "door"):
        laser.switches.look(name)
    laser.renew(GOOD)
    Contact.made.closed = closed
    laser.switches.look("door")
    with pytest.raises(NotArmed, match=words):
        laser.fire(5)
    with pytest.raises(NotArmed, match=words):
        laser.renew(GOOD)
    with pytest.raises(NotArmed, match=words):
        laser.arm(GOOD, laser.challenge)
    laser.safe()
    with pytest.raises(NotArmed, match=words):
        laser.align(laser.challenge, 5.0, 1.0)
    assert box.fired == 0


def test_a_switch_that_nobody_has_read_yet_allows_nothing():
    laser, _, _ = armed()
    laser.switches = Switches({"door": Contact()})
    with pytest.raises(NotArmed, match="cannot be read"):
        laser.fire(1)


def test_a_reading_that_hangs_is_no_closed_door(monkeypatch):
    monkeypatch.setattr("daq.timing.switches.SILENCE_S", 0.05)
    hangs = threading.Event()
    contact = Contact()
    contact.is_closed = lambda: hangs.is_set() or True
    switches, told = Switches({"door": contact}), []
    switches.watch(told.append)
    assert switches.objection() is None
    contact.is_closed = lambda: hangs.wait(5.0)
    laser, box, _ = armed()
    laser.fire(50)
    laser.switches = switches
    time.sleep(0.2)
    assert laser.look() is False
    assert "cannot be read" in laser.why
    assert box.burst is None
    hangs.set()
    switches.close()


def test_who_watches_is_told_to_the_one_who_is_asked_for_the_code(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("1234\n"))
    assert Switches({}).sentence() == NO_SWITCH
    assert "door, key" in Switches({"door": Contact(), "key": Contact()}).sentence()
    assert TerminalOperator().confirmation_code("1234", NO_SWITCH) == "1234"
    assert "you alone watch" in " ".join(capsys.readouterr().err.split())


@contextmanager
def firing_box(rate_hz=200.0, **switches):
    """A real box that fires; the laser, and when each of its Q-switch pulses rose on the wall's clock."""
    clock, risen_s = ScaledClock(), []
    emulator = QuantumComposersEmulator(clock)
    emulator.outputs.listen(lambda pulse: risen_s.append(time.monotonic()) if pulse.output == "B" else None)
    with PtyPort(Line(emulator, clock)) as port:
        wired = {"q_switch_1": "B", "q_switch_2": "D", "camera": "E"}
        head = LaserHead(max_rate_hz=rate_hz)
        table = TimingTable(box="qc9530", port=port.path, channels=wired, head=head, switches=switches)
        with open_laser(table, SYSTEM_CLOCK) as laser:
            laser.warm(rate_hz)
            laser.set(PulseTiming(100.0, rate_hz), PairExposures(500.0, 2_000.0, 2.0))
            laser.arm(GOOD, laser.challenge)
            laser.fire(int(5.0 * rate_hz))
            yield laser, risen_s


def wait_for_the_end(laser, longest_s=20.0):
    """Wait until the burst is ended, whatever else the machine does, and for pulses that would come late."""
    end_s = time.monotonic() + longest_s
    while laser.state is LaserState.FIRING and time.monotonic() < end_s:
        time.sleep(0.01)
    time.sleep(0.2)


def seconds_to_dark(closed):
    """Time from the first reading of an open door to the last pulse; nobody else asks or waits for the burst."""
    with firing_box(door=BY_TEST) as (laser, risen_s):
        time.sleep(0.3)
        assert laser.state is LaserState.FIRING
        opened_s, Contact.made.closed = time.monotonic(), closed
        wait_for_the_end(laser)
        assert risen_s[0] < opened_s
        lit_s = max(risen_s) - (Contact.made.read_open_s or opened_s)
        assert laser.state is LaserState.UNKNOWN
        assert re.search("the switch of the door (is open|cannot be read)", laser.why)
        with pytest.raises(LaserStopped, match="door"):
            laser.wait()
        assert laser.confirm_off()
        assert laser.state is LaserState.FAULT
    return lit_s


@pytest.mark.parametrize("closed", [False, None])
def test_a_door_that_opens_is_dark_within_50_ms_of_its_reading(closed):
    assert any(seconds_to_dark(closed) < 0.05 for _ in range(5))  # a busy machine is late, but not five times


@pytest.mark.slow
def test_many_doors(capsys):
    """RTPIV_DOORS says how many open."""
    dark_ms = []
    for number in range(DOORS):
        with firing_box(door=BY_TEST) as (laser, risen_s):
            time.sleep(0.2 + 0.005 * (number % 7))
            opened_s, Contact.made.closed = time.monotonic(), None if number % 2 else False
            time.sleep(0.4)
            dark_ms.append(1e3 * (max(risen_s) - (Contact.made.read_open_s or opened_s)))
            assert laser.confirm_off()
    with capsys.disabled():
        median_ms = sorted(dark_ms)[DOORS // 2]
        print(
            f"\n{DOORS} doors, last pulse after reading: {median_ms:.1f} ms median, {max(dark_ms):.1f} ms at most"
        )
    assert max(dark_ms) < 50.0


def test_a_bench_is_opened_with_its_door_open_and_lets_no_light_out(tmp_path):
    bench = bench_with(tmp_path, more=", switches: {door: {port: /dev/switch, line: dsr}}")
    with open_bench(bench, True, only={"laser"}) as hardware:
        laser = hardware.devices["laser"]
        (unit,) = hardware.simulation.world.timing
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        laser.arm(GOOD, laser.challenge)
        laser.disarm()
        CLOSED[unit.switches["door"]] = False
        time.sleep(0.1)
        for is_closed in (False, True):  # closing it releases nothing
            CLOSED[unit.switches["door"]] = is_closed
            with pytest.raises(NotNow, match="the switch of the door is open"):
                laser.arm(GOOD, laser.challenge)
        assert unit.pulses(Role.Q_SWITCH_1) == 0


@pytest.mark.parametrize("level", ["high", "low"])
def test_the_gate_of_the_box_works_without_the_program(level):
    """What hangs on the box's own gate input needs no computer; that it is set reads back before arming."""
    with desk() as d:
        d.box.gate = level
        d.emulator.set_gate(level == "high")
        d.firing(20)
        before = d.pulses(Role.Q_SWITCH_1)
        assert before > 0
        d.emulator.set_gate(level != "high")
        d.clock.sleep_s(0.5)
        assert d.pulses(Role.Q_SWITCH_1) == before
        d.emulator.set_gate(level == "high")
        d.clock.sleep_s(5.0)
        assert before < d.pulses(Role.Q_SWITCH_1) < 20
        d.laser.wait()
        d.emulator.set_inside(0, "GAT:MOD", "DIS")
        with pytest.raises(LaserDoubt, match="GATE:MOD is DIS, not OUTP"):
            d.laser.arm(GOOD, d.laser.challenge)


def test_without_a_gate_in_the_file_a_gate_that_was_left_on_is_switched_off():
    with desk() as d:
        d.emulator.set_inside(0, "GAT:MOD", "OUTP")
        d.to_armed()
        assert d.emulator._t0.words["GAT:MOD"] == "DIS"
    assert Role.LAMP_1 not in PUMPED


@pytest.mark.posix("kill -9")
def test_a_watchdog_that_is_killed_alone_ends_the_burst_and_is_replaced():
    assert any(seconds_after_watchdog() < 0.1 for _ in range(5))  # a busy machine is late, but not five times


def seconds_after_watchdog():
    """Time from the end of the watchdog to the last pulse."""
    with firing_box() as (laser, risen_s):
        time.sleep(SHORT_LIFE_S + 0.3)
        assert laser.state is LaserState.FIRING
        killed_s, pid = time.monotonic(), laser.box.watchdog.pid
        os.kill(pid, signal.SIGKILL)
        wait_for_the_end(laser)
        assert risen_s[0] < killed_s
        lit_s = max(risen_s) - killed_s
        assert "watchdog of this program was killed" in laser.why
        assert laser.box.watchdog.pid not in (None, pid)
        with pytest.raises(LaserStopped, match="watchdog"):
            laser.wait()
    return lit_s


def test_a_confirmation_that_comes_late_undoes_no_release(tmp_path):
    request = OffRequest(tmp_path / f"{os.getpid()}-0.off")
    request.make()
    request.confirm()
    assert request.is_confirmed()
    request.close()  # a person releases the laser while the thread of the switches still reads back
    request.confirm()
    assert request.is_closed()
