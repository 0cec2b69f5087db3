"""A timing unit as a device of a bench: opened dark, simulated on either transport, checked by its section."""

import time
from contextlib import suppress

import pytest

from daq.bench.bench_file import load_bench
from daq.bench.opened import open_bench
from daq.timing.conditions import Conditions
from daq.timing.errors import TimingUsageError
from daq.timing.opened import open_laser
from daq.timing.pulses import PairExposures, PulseTiming, Role
from daq.timing.states import LaserState
from ground.errors import ConfigError
from stages.errors import MotionBarred
from tests.daq.small_bench import write_bench
from tests.loops import loop_over

CHANNELS = "lamp_1: A, q_switch_1: B, lamp_2: C, q_switch_2: D, camera: E, marker: F"
HEAD = "max_rate_hz: 15.0, lamp_to_q_switch_us: [180.0, 185.0], warmup_s: 0.0"
DIODE = "q_switch_1: B, camera: E"
GOOD = Conditions(True, True, True, 5.0, 1000)


def bench_with(folder, channels=CHANNELS, head=HEAD, more="", transport="memory", box="qc9520"):
    path = write_bench(folder)
    section = f"{{kind: timing, box: {box}, port: /dev/one, channels: {{{channels}}}, head: {{{head}}}{more}}}"
    text = path.read_text() + f"devices:\n  laser: {section}\n"
    if transport == "pty":
        text = text.replace("simulation:\n", "simulation:\n  transport: pty\n  speed: 1.0\n")
    path.write_text(text)
    return load_bench(path)


@pytest.mark.parametrize("transport", ["memory", "pty"])
def test_a_chunk_on_a_simulated_bench(tmp_path, transport):
    bench = bench_with(tmp_path, transport=transport)
    with open_bench(bench, True, only={"laser"}) as hardware:
        laser = hardware.devices["laser"]
        (unit,) = hardware.simulation.world.timing
        heard = []
        unit.listen(Role.CAMERA, heard.append)
        assert laser.state is LaserState.SAFE
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        laser.arm(GOOD, laser.challenge)
        laser.fire(5)
        laser.wait()
        assert laser.state is LaserState.READY
        assert unit.pulses(Role.Q_SWITCH_1) == unit.pulses(Role.Q_SWITCH_2) == 5
        assert len(heard) == 5
        lit = next(pulse for pulse in unit.outputs.recent if pulse.output == "B")
        assert unit.is_high(Role.MARKER, lit.rises_s)
        assert unit.pulses(Role.LAMP_1) > 0
    assert not any(unit.line.emulator.is_on_at(number) for number in range(9))
    assert hardware.simulation.world.timing == []


def test_leaving_by_an_error_switches_off(tmp_path):
    with suppress(ZeroDivisionError), open_bench(bench_with(tmp_path), True, only={"laser"}) as hardware:
        laser = hardware.devices["laser"]
        (unit,) = hardware.simulation.world.timing
        laser.warm(10.0)
        assert unit.line.emulator.is_on_at(0)
        _ = 1 / 0
    assert not unit.line.emulator.is_on_at(0)


@loop_over(
    "changes, words",
    [
        ({"channels": CHANNELS.replace("D", "B")}, "two things are connected to one output"),
        ({"channels": CHANNELS.replace("q_switch_1", "q_switch")}, "'q_switch' is none of"),
        ({"channels": "camera: E"}, "at least q_switch_1 and camera"),
        ({"channels": "q_switch_1: B, camera: E"}, "belong together"),
        ({"head": "max_rate_hz: 15.0"}, "belong together"),
        ({"head": HEAD.replace("15.0", "0.0")}, "max_rate_hz: should be greater than 0"),
        ({"head": HEAD + ", min_dt_us: 10.0, max_dt_us: 5.0"}, "min_dt_us is larger"),
        ({"more": ", align: {}"}, "is made weak by it"),
        ({"more": ", align: {q_switch_delay_us: 200.0}"}, "within 20% of the best one"),
        (
            {"channels": "q_switch_1: B, camera: E", "head": "max_rate_hz: 9.0", "more": ", align: {}"},
            "less than 10",
        ),
        ({"box": "qc1"}, "no timing unit 'qc1'; there are qc9510"),
        ({"more": ", chunk_s: 20.0"}, "chunk_s: should be 10 or less"),
        ({"more": ", clear: 3.0"}, "unknown key"),
    ],
)
def test_what_is_wrong_in_the_section_is_said_with_its_line(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words) as caught:
        bench_with(tmp_path, **changes)
    assert "bench.yaml:" in str(caught.value)


def test_a_kind_of_box_that_there_is_not_is_refused(tmp_path):
    section = bench_with(tmp_path).devices["laser"].section.model_copy(update={"box": "qc1"})
    with pytest.raises(TimingUsageError, match="no timing unit 'qc1'; there are qc9510"), open_laser(section):
        pass


def test_time_passes_while_a_chunk_is_waited_for(tmp_path):
    begun_s = time.monotonic()
    with open_bench(bench_with(tmp_path), True, only={"laser"}) as hardware:
        laser = hardware.devices["laser"]
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        laser.arm(GOOD, laser.challenge)
        laser.fire(100)
        laser.wait()
    assert time.monotonic() - begun_s < 5.0


def test_a_second_box_is_data(tmp_path):
    bench = bench_with(tmp_path)
    text = bench.path.read_text()
    diode = (
        '  diode: {kind: timing, box: pivlab_oltsync, port: /dev/two, identity: "oltSync:7", uncounted: true, '
        'channels: {camera: "1", q_switch_1: "2"}, head: {max_rate_hz: 40.0, pulse_us: 50.0}}\n'
    )
    bench.path.write_text(text + diode)
    with open_bench(load_bench(bench.path), True, only={"laser", "diode"}) as hardware:
        first, second = hardware.devices["laser"], hardware.devices["diode"]
        pulsed, modulated = hardware.simulation.world.timing
        assert second.box.identity == "oltSync:7"
        second.warm()
        second.set(PulseTiming(250.0, 40.0), PairExposures(9_900.0, 9_900.0, 100.0, two_triggers=True))
        second.arm(GOOD, second.challenge)
        second.fire(20)
        first.stop("only this one")
        assert second.state is LaserState.FIRING
        second.wait()
        assert modulated.pulses(Role.Q_SWITCH_1) >= 40
        assert pulsed.pulses(Role.Q_SWITCH_1) == 0
        assert first.state is LaserState.UNKNOWN


def test_nothing_moves_while_light_may_leave_and_nothing_is_armed_while_something_moves(tmp_path):
    with open_bench(bench_with(tmp_path), True, only={"stages", "laser"}) as hardware:
        laser, stage = hardware.devices["laser"], hardware.stage
        stage.home()
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        with stage._turn.take(), pytest.raises(TimingUsageError, match="not armed: an axis of the stage"):
            laser.arm(GOOD, laser.challenge)
        assert laser.state is LaserState.READY
        before_mm = stage.where_mm()
        laser.arm(GOOD, laser.challenge)
        for ask in (
            lambda: stage.move({"target_z": -5.0}),
            stage.home,
            lambda: stage.axis("glass_x").move_to(1.0),
        ):
            with pytest.raises(MotionBarred, match=r"nothing has moved: .* is armed; let it end, or"):
                ask()
        laser.fire(5)
        with pytest.raises(MotionBarred, match="is firing"):
            stage.move({"target_z": -5.0})
        assert stage.where_mm() == before_mm
        laser.wait()
        assert stage.move({"target_z": -5.0})["target_z"].measured_mm == pytest.approx(-5.0, abs=0.01)
        laser.arm(GOOD, laser.challenge)
        laser.stop("somebody came in")  # nobody has read back yet that it is off
        with pytest.raises(MotionBarred, match=r"it is unknown whether .* is off"):
            stage.move({"target_z": -6.0})
        laser.safe()
        stage.move({"target_z": -6.0})


def test_a_motion_whose_end_nobody_heard_of_keeps_the_light_off(tmp_path):
    with open_bench(bench_with(tmp_path), True, only={"stages", "laser"}) as hardware:
        laser, stage = hardware.devices["laser"], hardware.stage
        laser.warm(10.0)
        laser.set(PulseTiming(20.0, 10.0), PairExposures(100.0, 20_000.0, 2.0))
        stage.controllers["glass"].under_way = True  # its cable was pulled while it moved
        with pytest.raises(TimingUsageError, match="not armed: glass has not been heard to rest"):
            laser.arm(GOOD, laser.challenge)
