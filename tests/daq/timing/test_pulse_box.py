"""A pulse box counts the plugs of a timing unit by its firmware's rules, quirks included."""

from contextlib import contextmanager, suppress

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.opened import open_bench
from daq.errors import RunUsageError
from daq.runner.laser_trials import BoxTrials
from daq.runner.pulse_counters import BoxCounter
from daq.timing.drivers.pulse_box import PulseBox
from daq.timing.pulses import PairExposures, Pulse, PulseTiming, Role
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.mechanics.clock import VirtualClock
from sim.timing_boxes import pulsing
from sim.timing_boxes.pulse_box import PulseBoxEmulator
from stages.errors import NoReply, StageError, WrongDevice
from tests.daq.bench.test_timing_kind import GOOD, bench_with
from tests.daq.runner.test_laser_trials import TIMING, WRONG, Hands
from tests.daq.timing.quantum_desk import EXPOSURES, desk
from tests.loops import loop_over
from tests.slow_cases import slow


@contextmanager
def counter(clock=None, **firmware):
    clock = clock or VirtualClock()
    emulator = PulseBoxEmulator(clock, **firmware)
    LINES["counter"] = Line(emulator, clock)
    box = PulseBox("counter", clock)
    try:
        box.connect("sim://counter")
        yield box, emulator, clock
    finally:
        box.close()
        LINES.pop("counter")


def give(emulator, clock, number, period_us, width_us, phase_us=0.0):
    begun_s = clock.now_s() + 0.01 + 1e-6 * phase_us
    for at in range(number):
        rises_s = begun_s + 1e-6 * period_us * at
        emulator.hear_pulse(pulsing.Pulse("B", rises_s, rises_s + 1e-6 * width_us))
    clock.advance_to(begun_s + 1e-6 * period_us * number + 0.1)


@loop_over("clock_off", [0.0, 1e-4, -1e-4])
@loop_over("rate_hz, width_us", [(10.0, 10.0), (10.0, 400.0), (1.0, 10.0), (100.0, 10.0)])
def test_every_edge_is_counted_once(clock_off, rate_hz, width_us):
    period_us = 1e6 / rate_hz
    with counter(clock_off=clock_off) as (box, emulator, clock):
        box.expect(period_us, Pulse(0.0, width_us))
        for number in (0, 1, 2, 7, 20, min(100, box.most), 3):
            give(emulator, clock, number, period_us, width_us, phase_us=1234.5 * number)
            assert box.restart() == number


@pytest.mark.parametrize("width_us", [2_000.0, 50_000.0])
def test_pulses_that_are_too_long_are_not_counted_wrong(width_us):
    with counter() as (box, _, _), pytest.raises(RunUsageError, match="too long; count this output by the camera"):
        box.expect(1e5, Pulse(0.0, width_us))


def test_a_firmware_that_is_built_otherwise_is_found():
    with counter(busy_is_high=True) as (box, _, _), pytest.raises(WrongDevice, match="DeviceIsBusy = LOW"):
        box.expect(1e5, Pulse(0.0, 10.0))


def test_another_version_is_refused():
    with pytest.raises(WrongDevice, match="has version 2, not 1"), counter(version=2):
        pass


def test_a_count_whose_answer_is_lost_is_no_count():
    with counter() as (box, _, _):
        box.expect(1e5, Pulse(0.0, 10.0))
        LINES["counter"].faults.unplugged = True
        with pytest.raises(StageError):
            box.restart()


def test_what_a_board_without_the_firmware_needs_is_said():
    clock = VirtualClock()
    LINES["counter"] = Line(Mute(clock), clock)
    with pytest.raises(NoReply, match="TeensyPulseGenerator"):
        PulseBox("counter", clock).connect("sim://counter")
    LINES.pop("counter")


class Mute(PulseBoxEmulator):
    def _take(self, data):
        pass


def tried(d, **firmware):
    """Trials of the box of a desk, counted by a pulse box."""
    with counter(d.clock, **firmware) as (box, emulator, _):
        hands = Hands(d, type("Cable", (), {"output": None})())
        d.emulator.outputs.listen(
            lambda pulse: emulator.hear_pulse(pulse) if pulse.output == hands._counter.output else None
        )
        d.box.wiring.pop(Role.MARKER, None)  # too long to be counted by it
        d.laser.open("sim://desk")
        return list(BoxTrials(d.laser, TIMING, EXPOSURES, BoxCounter(box), hands, d.clock).run())


@pytest.mark.parametrize("clock_off", [0.0, 1e-4])
def test_a_right_box_is_proven_by_it(clock_off):
    with desk() as d:
        found = tried(d, clock_off=clock_off)
        assert all(trial.is_right for trial in found), [trial for trial in found if not trial.is_right]
        assert sum("cable pulled" in trial.what for trial in found) == 3


NEEDS_TIMES = {"a pulse is late", "twice as fast", "a tenth too slow"}  # which a camera's stamps tell
OF_THE_MARKER = {"marker one fewer", "the marker is dead"}


COUNTED_WRONG = sorted(WRONG.keys() - NEEDS_TIMES - OF_THE_MARKER)


@pytest.mark.parametrize("some", [COUNTED_WRONG[::8], slow(COUNTED_WRONG)], ids=["some", "all"])
def test_and_a_wrong_one_is_not(some):
    """The trials themselves are judged on all of them with a camera (`test_laser_trials`)."""
    for wrong in some:
        with desk() as d:
            WRONG[wrong](d)
            found = None
            with suppress(Exception):
                found = tried(d)
            assert found is None or not all(trial.is_right for trial in found), wrong


def test_a_bench_has_a_counter_that_hangs_on_the_trigger_cable(tmp_path):
    bench = bench_with(tmp_path)
    text = bench.path.read_text() + "  counter: {kind: counter, port: /dev/other}\n"
    bench.path.write_text(text)
    with open_bench(load_bench(bench.path), True, only={"laser", "counter"}) as hardware:
        laser, box = hardware.devices["laser"], hardware.devices["counter"]
        (unit,) = hardware.simulation.world.timing
        for output in ("E", "D"):
            unit.trigger_cable = output
            box.expect(1e5, Pulse(0.0, 10.0))
            laser.safe()
            laser.warm(10.0)
            laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
            laser.arm(GOOD, laser.challenge)
            laser.fire(5)
            laser.wait()
            assert box.restart() == 5
        assert unit.pulses(Role.Q_SWITCH_2) == 10


def test_two_triggers_a_pair_are_left_to_the_camera():
    with counter() as (box, _, _), pytest.raises(RunUsageError, match="two triggers a pair"):
        BoxCounter(box).begin((Role.CAMERA, Role.CAMERA_B), 1e5, Pulse(0.0, 10.0))
    assert PulseTiming(20.0, 10.0).period_us == 1e5
