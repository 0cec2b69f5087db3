"""A simulated reading: a flow meter answers in its place in words of its own, or a recording in those of yours."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from daq.bench.reading import ReadingSection
from sim.emulators.device import Clock
from sim.emulators.flow_meter import FlowMeter
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.emulators.recorded import RecordedBox
from sim.mechanics.clock import VirtualClock
from sim.world import World


@contextmanager
def simulated_reading(section: ReadingSection, world: World, clock: Clock) -> Iterator[ReadingSection]:
    """Put a meter up while the block runs; yield the section that asks it."""
    line = Line(FlowMeter(clock, unit=section.unit), clock)
    with ExitStack() as stack:
        if isinstance(clock, VirtualClock):
            port = stack.enter_context(_here(line))
        else:
            from sim.emulators.pty import PtyPort  # not every system has such terminals

            port = stack.enter_context(PtyPort(line)).path
        yield ReadingSection(
            unit=section.unit, port=port, ask="F?\r\n", find=r"F=([-+\d.]+)", wait_s=section.wait_s
        )


@contextmanager
def recorded_reading(section: ReadingSection, path: Path, clock: Clock) -> Iterator[ReadingSection]:
    """Put up what answers from a recording while the block runs; yield the section with its port."""
    with _here(Line(RecordedBox(path, clock), clock)) as port:
        yield section.model_copy(update={"port": port})


@contextmanager
def _here(line: Line) -> Iterator[str]:
    """A port of this process for a line."""
    address = f"reading-{id(line):x}"
    LINES[address] = line
    try:
        yield f"sim://{address}"
    finally:
        LINES.pop(address)
