"""A timing unit and the laser that it triggers."""

from collections.abc import Iterator
from contextlib import AbstractContextManager

from daq.bench.bench_table import Bench
from daq.timing.laser import Laser
from daq.timing.opened import open_laser
from daq.timing.timing_table import TimingTable
from stages.clock import Clock


class TimingKind:
    """A device of kind `timing`."""

    section = TimingTable
    simulator = "sim.timing_port:simulated_timing"

    def open(self, section: TimingTable, bench: Bench, clock: Clock) -> AbstractContextManager[Laser]:
        """Switch everything off and read it back; leaving does the same."""
        return open_laser(section, clock)

    def places(self, section: TimingTable) -> Iterator[str]:
        """Port of the box."""
        yield f"timing unit: {section.box} on {section.port}"
