"""A simulated timing unit put up for a bench: a port that leads to it, and its place in the world."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from daq.timing.timing_table import TimingTable
from sim.emulators.device import Clock
from sim.emulators.protocol_sim import LINES
from sim.emulators.pty import PtyPort
from sim.mechanics.clock import VirtualClock
from sim.timing import SimulatedTiming
from sim.world import World


@contextmanager
def simulated_timing(section: TimingTable, world: World, clock: Clock) -> Iterator[TimingTable]:
    """Put a timing unit up; yield the section with its simulated port."""
    unit = SimulatedTiming(section, clock)
    with ExitStack() as stack:
        if isinstance(clock, VirtualClock):
            address = f"timing-{id(unit):x}"
            LINES[address] = unit.line
            stack.callback(LINES.pop, address)
            port = f"sim://{address}"
        else:
            port = stack.enter_context(PtyPort(unit.line)).path
        world.timing.append(unit)
        stack.callback(world.timing.remove, unit)
        unit.start()
        stack.callback(unit.close)
        yield section.model_copy(update={"port": port, "identity": None})
