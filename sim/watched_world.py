"""A simulated world that is listened to: every wire, every shutter, every light; faults wait there."""

import zlib
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.bench.fault_table import Fault
from daq.timing.pulses import Q_SWITCHES
from sim.emulators.line import Line
from sim.emulators.recorded import RecordedBox
from sim.fault_strikes import FaultStrikes, Struck
from sim.happened import Event, Happened, Kept
from sim.mechanics.clock import VirtualClock
from sim.timing import SimulatedTiming
from sim.timing_boxes.outputs import Pulse
from sim.witness.witness import Violation


class WatchedWorld:
    """Hangs on everything of a simulated bench.

    Parameters
    ----------
    bench : Struck
        Wires, axes, cameras and what they see.
    units : mapping of str to SimulatedTiming
        Timing units.
    clock : VirtualClock
        Time of the world.
    faults : sequence of Fault
        What is to go wrong.
    """

    def __init__(
        self,
        bench: Struck,
        units: Mapping[str, SimulatedTiming],
        clock: VirtualClock,
        faults: Sequence[Fault],
    ) -> None:
        self._clock, self._kept = clock, Kept()
        self._recorded = {
            name: line.emulator for name, line in bench.lines.items() if isinstance(line.emulator, RecordedBox)
        }
        self._strikes = FaultStrikes(faults, bench, clock, self._kept)
        for name, line in bench.lines.items():
            line.on_told = partial(self._told, name, line)
        for name, world in bench.worlds.items():
            world.on_exposed = partial(self._exposed, name)
        for name, unit in units.items():
            for number, role in enumerate(Q_SWITCHES):
                unit.listen(role, partial(self._lit, name, number, unit.light_delay_s(number)))

    def step_begins(self, number: int) -> None:
        """Hear that a step of a run begins."""
        self._kept.note(self._clock.now_s(), "step", "run", number)
        self._strikes.step_begins(number)

    def happened(self, violations: Sequence[Violation]) -> Happened:
        """Everything so far, with what the witness has seen, faults that wait, and what recordings miss."""
        now_s = self._clock.now_s()
        seen = [Event(each.time_s, "violation", each.what, str(each)) for each in violations]
        waiting = [
            Event(now_s, "waiting", fault.of, {"what": fault.what, "due": fault.moment})
            for fault in self._strikes.waiting
        ]
        differs = [
            Event(now_s, "differs", name, box.differs) for name, box in self._recorded.items() if box.differs
        ]
        return Happened((*self._kept.events(), *seen, *waiting, *differs))

    def _told(self, box: str, line: Line, data: bytes) -> None:
        self._strikes.told(box, data)
        if not line.dead:
            self._kept.note(self._clock.now_s(), "told", box, data.decode("latin-1"))

    def _exposed(self, camera: str, number: int, image: NDArray[np.uint16], true_mm: dict[str, float]) -> None:
        said: dict[str, Any] = {"number": number, "crc32": f"{zlib.crc32(image.tobytes()):08x}"}
        said["true_mm"] = {axis: round(mm, 6) for axis, mm in true_mm.items()}
        self._kept.note(self._clock.now_s(), "exposed", camera, said)

    def _lit(self, unit: str, number: int, delay_s: float, pulse: Pulse) -> None:
        self._kept.note(pulse.rises_s + delay_s, "light", unit, {"pulse": number})
