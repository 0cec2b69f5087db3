"""A simulated world that is listened to: every wire, every shutter, every light; faults of a rehearsal wait there.

They are carried out when their moments come.  A step begins because the run says so; a second because the clock
calls; a word because the wire is listened to.  What a word brings about happens before the box hears it.
"""

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.bench.fault_table import Fault
from daq.timing.pulses import Q_SWITCHES
from sim.camera.device import SimCamera
from sim.emulators.faults import Fault as WireFault
from sim.emulators.line import Line
from sim.event_log import Event, EventLog, Kept
from sim.mechanics.clock import VirtualClock
from sim.stages import SimulatedStages
from sim.timing import CLOSED, SimulatedTiming
from sim.timing_boxes.pulsing import Pulse
from sim.witness.witness import Violation
from sim.world import World

BY_A_PERSON = ("stop", "run", "door", "off")
DARK_S = 0.3  # after a person has ended the light, until which pulses may leave
ON_THE_WIRE = ("late", "split", "lost", "cut", "doubled", "garbled")


@dataclass(frozen=True)
class Struck:
    """Parts of a simulated bench that faults can strike.

    Parameters
    ----------
    lines : mapping of str to Line
        Of every box.
    stages : SimulatedStages
        Of every axis.
    cameras : mapping of str to SimCamera
        Every camera.
    worlds : mapping of str to World
        What each camera sees; who dims the light dims it for all.
    units : mapping of str to SimulatedTiming
        Timing units.
    """

    lines: Mapping[str, Line]
    stages: SimulatedStages
    cameras: Mapping[str, SimCamera]
    worlds: Mapping[str, World]
    units: Mapping[str, SimulatedTiming]


class FaultStrikes:
    """Waits for the moments of some faults.

    Parameters
    ----------
    faults : sequence of Fault
        What is to go wrong.
    struck : Struck
        The bench.
    clock : VirtualClock
        Time of the world.
    kept : Kept
        Where it is taken down.
    """

    def __init__(self, faults: Sequence[Fault], struck: Struck, clock: VirtualClock, kept: Kept) -> None:
        self._struck, self._clock, self._kept = struck, clock, kept
        self._waiting = list(faults)
        self.stopped_s: dict[str, float] = {}  # units at which a person has ended the light, and when
        self._said: dict[int, int] = {}  # how often the word of a fault, by its identity
        for fault in faults:
            if fault.at_s is not None:
                clock.at(fault.at_s, lambda fault=fault: self._strike(fault))  # type: ignore[misc]

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults whose moment has not come."""
        return tuple(self._waiting)

    def step_begins(self, number: int) -> None:
        """Strike what is due with a step, 1 first."""
        for fault in [each for each in self._waiting if each.step == number]:
            self._strike(fault)

    def count_bytes(self, box: str, data: bytes) -> None:
        """Strike what is due with a word that is on its way to a box."""
        for fault in [each for each in self._waiting if each.word is not None and self._wire_of(each) == box]:
            assert fault.word is not None
            times = self._said[id(fault)] = self._said.get(id(fault), 0) + data.count(fault.word.encode("latin-1"))
            if times >= fault.nth:
                self._strike(fault)

    def _wire_of(self, fault: Fault) -> str:
        """The box whose words a fault waits for: of an axis its controller."""
        axis = self._struck.stages.config.axes.get(fault.of)
        return fault.of if axis is None else axis.controller

    def _strike(self, fault: Fault) -> None:
        self._waiting.remove(fault)
        said = {"what": fault.what, "due": fault.moment}
        self._kept.note(self._clock.now_s(), "fault", fault.of, said)
        if fault.what in BY_A_PERSON:
            self._act_at_unit(fault, self._struck.units[fault.of])
        elif fault.of in self._struck.lines:
            self._strike_line(fault, self._struck.lines[fault.of])
        elif fault.of in self._struck.cameras:
            self._struck.cameras[fault.of].strike(fault.what, fault.delay_s or 0.0)
        elif fault.what == "knock":
            self._struck.stages.slip(fault.of, fault.by_mm or 0.0)
        elif fault.what == "stall":
            self._struck.stages.jam(fault.of)
        else:
            for world in self._struck.worlds.values():
                world.dim(1.0 if fault.share is None else fault.share)

    def _act_at_unit(self, fault: Fault, unit: SimulatedTiming) -> None:
        """Press a key of a timing unit, open its door, or write to it as another program would."""
        if fault.what == "run":
            self.stopped_s.pop(fault.of, None)
        elif fault.what == "door" or unit.firmware.has_something_to_stop:
            self.stopped_s.setdefault(fault.of, self._clock.now_s())
        if fault.what == "door":
            CLOSED.update(dict.fromkeys(unit.switches.values(), False))
        else:
            with unit.line.lock:
                if fault.what == "off":
                    unit.hear_foreign_off()
                    return
                (unit.line.emulator.person_stops if fault.what == "stop" else unit.firmware.person_runs)()

    @staticmethod
    def _strike_line(fault: Fault, line: Line) -> None:
        if fault.what == "unplug":
            line.unplug()
        elif fault.what == "mute":
            line.faults.mute()
        elif fault.what == "restart":
            line.power_cycle(fault.off_s or 0.0)
        else:
            assert fault.what in ON_THE_WIRE
            line.faults.strike(WireFault(fault.what, delay_s=fault.delay_s or 0.0))  # type: ignore[arg-type]


class WatchedWorld:
    """Hangs on everything of a simulated bench.

    Parameters
    ----------
    bench : Struck
        Wires, axes, cameras and what they see, timing units.
    clock : VirtualClock
        Time of the world.
    faults : sequence of Fault
        What is to go wrong.
    """

    def __init__(
        self,
        bench: Struck,
        clock: VirtualClock,
        faults: Sequence[Fault],
    ) -> None:
        self._clock, self._kept = clock, Kept()
        self._strikes = FaultStrikes(faults, bench, clock, self._kept)
        for name, line in bench.lines.items():
            line.on_told = partial(self._note_bytes, name, line)
        for name, world in bench.worlds.items():
            world.on_exposed = partial(self._note_exposure, name)
        for name, unit in bench.units.items():
            for number, role in enumerate(Q_SWITCHES):
                unit.listen(role, partial(self._lit, name, number, unit.light_delay_s(number)))

    def step_begins(self, number: int) -> None:
        """Hear that a step of a run begins."""
        self._kept.note(self._clock.now_s(), "step", "run", number)
        self._strikes.step_begins(number)

    def event_log(self, violations: Sequence[Violation]) -> EventLog:
        """Everything so far, with what the witness has seen, and faults that wait."""
        now_s = self._clock.now_s()
        seen = [Event(each.time_s, "violation", each.what, str(each)) for each in violations]
        waiting = [
            Event(now_s, "waiting", fault.of, {"what": fault.what, "due": fault.moment})
            for fault in self._strikes.waiting
        ]
        return EventLog((*self._kept.events(), *seen, *waiting))

    def _note_bytes(self, box: str, line: Line, data: bytes) -> None:
        self._strikes.count_bytes(box, data)
        if not line.dead:
            self._kept.note(self._clock.now_s(), "told", box, data.decode("latin-1"))

    def _note_exposure(
        self, camera: str, number: int, image: NDArray[np.uint16], true_mm: dict[str, float]
    ) -> None:
        said: dict[str, Any] = {"number": number, "crc32": f"{zlib.crc32(image.tobytes()):08x}"}
        said["true_mm"] = {axis: round(mm, 6) for axis, mm in true_mm.items()}
        self._kept.note(self._clock.now_s(), "exposed", camera, said)

    def _lit(self, unit: str, number: int, delay_s: float, pulse: Pulse) -> None:
        self._kept.note(pulse.rises_s + delay_s, "light", unit, {"pulse": number})
        late_s = pulse.rises_s - self._strikes.stopped_s.get(unit, math.inf)
        if late_s > DARK_S:
            text = f"light of {unit} {late_s:.2f} s after a person has ended it"
            self._kept.note(pulse.rises_s, "violation", unit, text)
