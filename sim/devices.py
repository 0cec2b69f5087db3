"""Devices of the simulated bench beside stages and cameras, each behind a port of its own: timing units, readings.

Camera and light are connected to a timing unit:

    camera -> Line1 (a trigger; the box adds camera_b), or wherever a person puts this cable
    marker -> Line2 (high over exposure A; resets the exposure counter)
    Q-switches -> flashes, the laser's own delay later

A camera lives in another process and draws its picture as soon as it has been exposed.  So its pulses are
passed on `LAG_S` late, when all light of that time has fallen; their edges stay where they were.  The marker goes
first: a frame that its trigger has made is judged by it.
"""

from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from daq.bench.bench_table import CameraSection
from daq.bench.kinds import CounterSection
from daq.bench.reading import ReadingSection
from daq.timing.protocols.pivlab_synchroniser import Sequence, Switch
from daq.timing.pulses import Q_SWITCHES, Role
from daq.timing.switches import SwitchTable
from daq.timing.timing_table import TimingTable
from sim.bench_table import SynchroniserTable
from sim.camera.wires import Wires
from sim.emulators.device import Clock
from sim.emulators.flow_meter import FlowMeter
from sim.emulators.line import Line
from sim.emulators.protocol_sim import put_up
from sim.light import LitFlow
from sim.mechanics.clock import PacedClock, ScaledClock, VirtualClock
from sim.timing import SimulatedTiming
from sim.timing_boxes.pulse_box import PulseBoxEmulator
from sim.timing_boxes.pulsing import Pulse
from sim.world import World

TRIGGER_LINE, MARKER_LINE = 1, 2
EXTERNAL: dict[str, Any] = {
    "box": "pivlab_oltsync",
    "port": "of another program",
    "identity": "oltSync:9999",
    "channels": {"camera": "1", "q_switch_1": "2", "q_switch_2": "3", "marker": "4"},
    "head": {"max_rate_hz": 1e4},
}
LAG_S = 0.03  # more than an exposure lasts


@contextmanager
def _port(line: Line, clock: Clock) -> Iterator[str]:
    """Yield the port of a line: in this process, or a terminal where the time of the world runs by itself."""
    if isinstance(clock, VirtualClock):
        with put_up(line, "device") as port:
            yield port
    else:
        from sim.emulators.pty import PtyPort  # not every system has such terminals

        with PtyPort(line) as served:
            yield served.path


@contextmanager
def simulate_timing(section: TimingTable, world: World, clock: Clock) -> Iterator[TimingTable]:
    """Give a timing unit power while the block runs; yield the section with its simulated port."""
    unit = SimulatedTiming(section, clock)
    with ExitStack() as stack:
        port = stack.enter_context(_port(unit.line, clock))
        world.timing.append(unit)
        stack.callback(world.timing.remove, unit)
        unit.start()
        stack.callback(unit.close)
        switches = {
            name: SwitchTable(by="sim.timing:SimulatedSwitch", options={"address": address})
            for name, address in unit.switches.items()
        }
        yield section.model_copy(update={"port": port, "identity": None, "switches": switches})


def external_pulses(table: SynchroniserTable, camera: CameraSection) -> Sequence:
    """Place the pulses of a synchroniser about the gap between the two exposures, as its own program would."""
    assert camera.pairs is not None
    exposure_us, dead_us = float(camera.settings["ExposureTime"]), camera.pairs.dead_us
    gap_us = camera.pairs.start_delay_us + exposure_us + dead_us / 2.0
    lights = [round(gap_us + side * table.dt_us / 2.0) for side in (-1, 1)]
    triggers: tuple[int, ...] = (0, 10)
    if camera.pairs.shape == "straddling":
        again_us = round(exposure_us + dead_us)
        triggers += (again_us, again_us + 10)
    pins = (triggers, *((light_us, light_us + 10) for light_us in lights), (0, round(gap_us)))
    return Sequence(EXTERNAL["identity"], round(1e6 / table.rate_hz), pins)


@contextmanager
def external_synchroniser(pulses: Sequence, world: World, clock: Clock) -> Iterator[SimulatedTiming]:
    """Let a synchroniser run while the block does, started before by its own program."""
    unit = SimulatedTiming(TimingTable(**EXTERNAL), clock)
    unit.line.send(pulses.to_bytes() + Switch(pulses.device, True).to_bytes())
    world.timing.append(unit)
    unit.start()
    try:
        yield unit
    finally:
        unit.close()
        world.timing.remove(unit)


def connect(unit: SimulatedTiming, clock: PacedClock | ScaledClock, wires: Wires, lit: LitFlow | None) -> None:
    """Hang camera and light on a timing unit.

    Parameters
    ----------
    unit : SimulatedTiming
        The unit.
    clock : PacedClock or ScaledClock
        The world's, whose time the pulses carry.
    wires : Wires
        To the camera.
    lit : LitFlow or None
        What the light falls on.
    """
    coming: deque[tuple[float, int, int, int]] = deque()  # rise on the world's clock, line, rise, fall [ns]

    def hold(line: int, pulse: Pulse) -> None:
        edges_ns = (clock.wall_ns(pulse.rises_s), clock.wall_ns(pulse.falls_s))
        coming.append((pulse.rises_s, line, *edges_ns))

    def pass_on(until_s: float) -> None:
        due = []
        while coming and coming[0][0] + LAG_S <= until_s:
            due.append(coming.popleft())
        for _, line, rise_ns, fall_ns in sorted(due, key=lambda pulse: (pulse[2], -pulse[1])):
            wires.pulse(line, rise_ns, fall_ns)

    unit.listen(Role.MARKER, lambda pulse: hold(MARKER_LINE, pulse))
    unit.listen_at_cable(lambda pulse: hold(TRIGGER_LINE, pulse))
    unit.listen_to_time(pass_on)
    if lit is None:
        return
    for number, role in enumerate(Q_SWITCHES):
        delay_s = unit.light_delay_s(number)

        def flash(pulse: Pulse, number: int = number, delay_s: float = delay_s) -> None:
            lit.flash(number, clock.wall_ns(pulse.rises_s + delay_s))

        unit.listen(role, flash)


@contextmanager
def simulate_counter(section: CounterSection, world: World, clock: Clock) -> Iterator[CounterSection]:
    """Hang a pulse box on the trigger cable of the timing unit; yield the section with its port."""
    emulator = PulseBoxEmulator(clock)
    for unit in world.timing:
        unit.listen_at_cable(emulator.hear_pulse)
    with _port(Line(emulator, clock), clock) as port:
        yield section.model_copy(update={"port": port})


@contextmanager
def simulate_reading(section: ReadingSection, world: World, clock: Clock) -> Iterator[ReadingSection]:
    """Put a meter up while the block runs; yield the section that asks it."""
    line = Line(FlowMeter(clock, unit=section.unit), clock)
    with _port(line, clock) as port:
        yield ReadingSection(
            unit=section.unit, port=port, ask="F?\r\n", find=r"F=([-+\d.]+)", wait_s=section.wait_s
        )
