"""The stages of a bench file, simulated: true mechanics behind emulators that speak the controllers' protocols.

For every axis the world holds a `Mechanics` of its own.  What the bench file does not tell (lead, play, errors,
where the carriage stands at power-up) comes from a `SimAxisTable` or from defaults.  The scale of a defaulted
screw is derived from ``steps_per_mm``: to find out whether that number is right, give lead_mm and steps_per_rev.

`true_mm` is where an axis really is, in the coordinate of the bench file:

    true = sign (carriage - carriage where the controller reads zero) + offset.

It comes from the carriage, never from a step counter.  Ports are either ``sim://`` lines of this process
(`put_up`) or pseudo-terminals for any program (`serve`).
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from sim.emulators import emulator_class
from sim.emulators.device import Clock
from sim.emulators.line import Line
from sim.emulators.protocol_sim import LINES
from sim.emulators.pty import PtyPort
from sim.faults_serial import FaultSchedule
from sim.motion import Mechanics, Motor
from stages.config import AxisTable, Positive, StagesTable
from tracer.config import Table

MARGIN_MM = 5.0  # between the limits of the bench file and the switches
USUAL_LEAD_MM = 4.0
USUAL_STEPS_PER_MM = 400.0


class SimAxisTable(Table):
    """What the workshop built, where it differs from the usual."""

    lead_mm: Positive | None = None
    steps_per_rev: Annotated[int, Field(gt=0)] | None = None
    backlash_um: Annotated[float, Field(ge=0.0, le=1000.0)] = 20.0
    lead_error_um: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    scale_error_ppm: Annotated[float, Field(ge=-1e4, le=1e4)] = 0.0
    power_up_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3


class SimulatedStages:
    """The world behind the controllers of a bench file.

    Parameters
    ----------
    config : StagesTable
        The bench's stages; ports are ignored.
    clock : Clock
        `VirtualClock` for one thread and no waiting, `ScaledClock` otherwise.
    axes : mapping of str to SimAxisTable
        Mechanics by axis; the usual one for those not named.
    faults : mapping of str to FaultSchedule
        What happens to the answers, by controller.
    """

    def __init__(
        self,
        config: StagesTable,
        clock: Clock,
        axes: Mapping[str, SimAxisTable] | None = None,
        faults: Mapping[str, FaultSchedule] | None = None,
    ) -> None:
        self.config = config
        self.clock = clock
        self.motors: dict[str, Motor] = {}
        self.lines: dict[str, Line] = {}
        self._zero_mm: dict[str, float] = {}
        for name, axis in config.axes.items():
            upper_zero = emulator_class(config.controllers[axis.controller].driver).zero_at_top
            mechanics = _mechanics(axis, (axes or {}).get(name, SimAxisTable()), upper_zero)
            self.motors[name] = Motor(mechanics)
            self._zero_mm[name] = mechanics.high_switch_mm if upper_zero else mechanics.low_switch_mm
        for name, table in config.controllers.items():
            motors = {
                str(axis.channel): self.motors[axis_name]
                for axis_name, axis in config.axes.items()
                if axis.controller == name
            }
            emulator = emulator_class(table.driver)(motors, clock)
            self.lines[name] = Line(emulator, clock, (faults or {}).get(name))

    def true_mm(self, axis: str) -> float:
        """Where an axis really is, in the coordinate of the bench file."""
        table = self.config.axes[axis]
        line = self.lines[table.controller]
        with line.lock:
            line.emulator.advance()
            carriage_mm = self.motors[axis].carriage_mm
        return table.sign * (carriage_mm - self._zero_mm[axis]) + table.offset_mm

    def put_up(self, prefix: str = "") -> StagesTable:
        """Offer every line as ``sim://<prefix><controller>`` in this process; return the file with these ports."""
        for name, line in self.lines.items():
            LINES[prefix + name] = line
        return self._with_ports({name: f"sim://{prefix}{name}" for name in self.lines})

    @contextmanager
    def serve(self) -> Iterator[StagesTable]:
        """Offer every line as a pseudo-terminal while the block runs; yield the file with these ports."""
        with ExitStack() as stack:
            ports = {name: stack.enter_context(PtyPort(line)).path for name, line in self.lines.items()}
            yield self._with_ports(ports)

    def _with_ports(self, ports: Mapping[str, str]) -> StagesTable:
        controllers = {
            name: table.model_copy(update={"port": ports[name]}) for name, table in self.config.controllers.items()
        }
        return self.config.model_copy(update={"controllers": controllers})


def _mechanics(axis: AxisTable, table: SimAxisTable, upper_zero: bool) -> Mechanics:
    """Screw and switches around the range that the bench file allows."""
    ends_mm = sorted(axis.sign * (limit - axis.offset_mm) for limit in axis.limits_mm)  # on the controller's scale
    low_mm = ends_mm[0] - MARGIN_MM if upper_zero else min(0.0, ends_mm[0] - MARGIN_MM) if ends_mm[0] < 0 else 0.0
    high_mm = 0.0 if upper_zero else ends_mm[1] + MARGIN_MM
    lead_mm = table.lead_mm or USUAL_LEAD_MM
    steps_per_rev = table.steps_per_rev or round((axis.steps_per_mm or USUAL_STEPS_PER_MM) * lead_mm)
    usual = Mechanics(
        lead_mm=lead_mm, steps_per_rev=steps_per_rev, low_switch_mm=low_mm, high_switch_mm=high_mm,
        index_mm=0.5 * (low_mm + high_mm), power_up_mm=low_mm + table.power_up_fraction * (high_mm - low_mm),
    )  # fmt: skip
    return replace(
        usual,
        backlash_um=table.backlash_um,
        lead_error_um=table.lead_error_um,
        scale_error_ppm=table.scale_error_ppm,
    )
