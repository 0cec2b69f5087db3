"""PIVlab's boxes: no count, no reading back, and what is made of that."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from daq.errors import DaqError
from daq.timing.conditions import Conditions, Rules
from daq.timing.drivers.pivlab_synchroniser import OltSyncBox, XmSyncBox
from daq.timing.errors import LaserDoubt, LaserStopped, NotArmed, PulsesRefused, WrongBox
from daq.timing.laser import Laser
from daq.timing.low_energy import LowEnergyRules
from daq.timing.pulses import LaserHead, PairExposures, PulseTiming, Role
from daq.timing.states import LaserState
from daq.timing.supervisor import LaserSupervisor
from sim.emulators.faults import KINDS, Fault, FaultSchedule
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes.pivlab_synchroniser import OltSyncEmulator, XmSyncEmulator
from stages.clock import SYSTEM_CLOCK
from stages.errors import CommandRejected, StageError
from tests.loops import loop_over

WIRING = {Role.CAMERA: "1", Role.Q_SWITCH_1: "2"}
HEAD = LaserHead(max_rate_hz=100.0, pulse_us=50.0)
EXPOSURES = PairExposures(9_900.0, 9_900.0, 100.0, start_delay_us=17.0, two_triggers=True)  # rate 50 Hz and less
RULES = Rules(uncounted=True, warmup_s=0.0, align=LowEnergyRules(pulse_us=2.0))
GOOD = Conditions(True, True, True, 5.0, 1000)
FIRMWARE = {OltSyncBox: OltSyncEmulator, XmSyncBox: XmSyncEmulator}


@contextmanager
def desk(driver=OltSyncBox, faults=(), rules=RULES):
    clock = VirtualClock()
    emulator = FIRMWARE[driver](clock)
    line = Line(emulator, clock, FaultSchedule(faults))
    box = driver("laser", WIRING, clock)
    box.address = emulator.name
    LINES["desk"] = line
    try:
        yield Laser("laser", box, HEAD, rules, clock), emulator, line, clock
    finally:
        LINES.pop("desk")


def to_armed(laser, dt_us=250.0, rate_hz=40.0):
    laser.open("sim://desk")
    if laser.state is LaserState.UNKNOWN:
        laser.safe()
    laser.warm(rate_hz)
    laser.set(PulseTiming(dt_us, rate_hz), EXPOSURES)
    laser.arm(GOOD, laser.challenge)


@pytest.mark.parametrize("driver", FIRMWARE)
def test_a_chunk_is_ended_by_our_clock(driver):
    with desk(driver) as (laser, emulator, _line, clock):
        to_armed(laser)
        laser.fire(20)
        laser.wait()
        assert laser.state is LaserState.READY
        clock.sleep_s(1.0)
        emulator.advance()
        light = [pulse for pulse in emulator.outputs.recent if pulse.output == "2"]
        assert 40 <= len(light) <= 44  # a wish, not a count
        assert light[1].rises_s - light[0].rises_s == pytest.approx(250e-6, abs=1e-9)
        assert light[0].falls_s - light[0].rises_s == pytest.approx(50e-6, abs=1e-9)
        frames = [pulse.rises_s for pulse in emulator.outputs.recent if pulse.output == "1"]
        assert len(frames) >= len(light)
        assert laser.dt_us == 250.0


def test_light_falls_into_both_exposures():
    with desk() as (laser, emulator, _, _):
        to_armed(laser, 300.0)
        laser.fire(2)
        laser.wait()
        frame_s = next(pulse.rises_s for pulse in emulator.outputs.recent if pulse.output == "1")
        first_s, second_s = [pulse.rises_s for pulse in emulator.outputs.recent if pulse.output == "2"][:2]
        end_a_s = frame_s + (17.0 + 9_900.0) * 1e-6
        assert first_s < end_a_s < end_a_s + 100e-6 < second_s


def test_without_a_word_in_the_bench_file_it_does_not_fire():
    with (
        desk(rules=replace(RULES, uncounted=False)) as (laser, _, _, _),
        pytest.raises(NotArmed, match="uncounted"),
    ):
        to_armed(laser)


def test_the_other_one_is_named():
    with desk() as (laser, emulator, _, _):
        emulator.name = "SYNC_UOA1"
        with pytest.raises(WrongBox, match="pivlab_xmsync"):
            laser.open("sim://desk")


def test_what_ran_before_us_is_off():
    with desk() as (laser, emulator, line, clock):
        line.send(b"TALKINGTO:oltSync:0012:sequence:50000:0,0:100,1100\r\nTALKINGTO:oltSync:0012:start\r\n")
        clock.sleep_s(1.0)
        assert emulator.is_running
        line.receive()
        laser.open("sim://desk")
        assert laser.state is LaserState.SAFE
        assert not emulator.is_running


def test_alignment_is_short_pulses():
    with desk() as (laser, emulator, _, _):
        laser.open("sim://desk")
        laser.align(laser.challenge, 5.0, 2.0)
        laser.wait()
        light = [pulse for pulse in emulator.outputs.recent if pulse.output == "2"]
        assert 10 <= len(light) <= 11
        assert max(pulse.falls_s - pulse.rises_s for pulse in light) == pytest.approx(2e-6)
        assert laser.state is LaserState.SAFE


def test_a_refused_sequence_is_said():
    with desk() as (laser, _, _, _):
        laser.open("sim://desk")
        laser.warm(40.0)
        too_near = replace(EXPOSURES, exposure_a_us=5.0, exposure_b_us=9_000.0, gap_us=2.0)
        with pytest.raises((CommandRejected, PulsesRefused), match="run into each other"):
            laser.set(PulseTiming(250.0, 40.0), too_near)


@pytest.mark.parametrize("dt_us", [250.4, 250.0])
def test_dt_is_what_the_box_can_do(dt_us):
    with desk() as (laser, _, _, _):
        to_armed(laser, dt_us)
        assert laser.dt_us == 250.0


@pytest.mark.slow
@loop_over("driver", FIRMWARE)
@loop_over("kind", KINDS)
def test_one_fault_at_any_answer(driver, kind):
    for answer in range(0, 30):
        with desk(driver, faults=[Fault(kind, answer, delay_s=2.0)]) as (laser, emulator, line, clock):
            try:
                to_armed(laser)
                laser.fire(3)
                laser.wait()
                assert not emulator.is_running
            except (DaqError, StageError):
                assert laser.state is LaserState.UNKNOWN
                if not line.dead:
                    clock.sleep_s(3.0)
                    assert not emulator.is_running
                    laser.safe()
                    assert laser.state is LaserState.SAFE


@pytest.mark.parametrize("driver", FIRMWARE)
@pytest.mark.parametrize("kind", ["late", "lost", "cut", "garbled"])
def test_light_ends_soon_after_a_start_without_an_answer(driver, kind):
    with desk(driver) as (laser, emulator, line, clock):
        to_armed(laser)
        begun_s = clock.now_s()
        line.faults.strike(Fault(kind, 0, delay_s=2.0))
        with pytest.raises(StageError):
            laser.fire(300)
        clock.sleep_s(5.0)
        emulator.advance()
        light = [pulse.rises_s for pulse in emulator.outputs.recent if pulse.output == "2"]
        assert light
        assert max(light) - begun_s < 0.3  # as after any off; the answer to a question may take 1.5 s


def test_a_box_that_stays_on_is_doubted(mocker):
    with desk() as (laser, emulator, _, _):
        to_armed(laser)
        laser.fire(20)
        mocker.patch.object(emulator, "_end_periods")
        with pytest.raises(LaserDoubt, match="still on"):
            laser.wait()
        assert laser.state is LaserState.UNKNOWN


def put_out_and_in(line):
    """A cable that is loose for a moment; what the host has open is dead, and the box has noticed nothing."""
    line.unplug()
    line.plug_in()


def light_after(emulator, clock, seconds):
    """Pulses of light that leave in the next so many seconds."""
    now_s = clock.now_s()
    clock.sleep_s(seconds)
    emulator.advance()
    return [pulse for pulse in emulator.outputs.recent if pulse.output == "2" and pulse.rises_s > now_s]


@pytest.mark.parametrize("driver", FIRMWARE)
def test_a_condition_that_is_lost_after_a_loose_cable_ends_the_light(driver):
    """Nobody has asked the box anything between the two, so only the supervisor can find the port dead."""
    with desk(driver) as (laser, emulator, line, clock):
        to_armed(laser)
        laser.fire(200)
        clock.sleep_s(0.5)
        put_out_and_in(line)
        moves = replace(GOOD, at_rest=False)
        with LaserSupervisor(laser, lambda: moves, clock, SYSTEM_CLOCK) as supervisor, pytest.raises(LaserStopped):
            supervisor.wait()
        assert laser.state is LaserState.FAULT
        assert not light_after(emulator, clock, 3.0)


@pytest.mark.parametrize("driver", FIRMWARE)
def test_leaving_the_bench_after_a_loose_cable_ends_the_light(driver):
    with desk(driver) as (laser, emulator, line, clock):
        to_armed(laser)
        laser.fire(200)
        clock.sleep_s(0.5)
        put_out_and_in(line)
        laser.close()
        assert not light_after(emulator, clock, 3.0)
