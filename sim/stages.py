"""The stages of a bench file, simulated: true mechanics behind emulators that speak the controllers' protocols.

For every axis a `ScrewTable` says what the workshop built; nothing of it is derived from what the bench file
believes.  Where an axis really is, in the coordinate of the bench file, is

    true = sign (carriage - carriage where the controller reads zero) + offset.

It comes from the carriage, never from a step counter.  Ports are either ``sim://`` lines of this process
(`in_process`) or pseudo-terminals for any program (`serve`).
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Annotated, Any, Literal

from pydantic import Field

from ground.config import Table
from sim.emulators import emulator_class
from sim.emulators.by_hand import HandScrews
from sim.emulators.faults import FaultSchedule
from sim.emulators.foreign_box import ForeignBox
from sim.emulators.line import Line
from sim.emulators.protocol_sim import put_up
from sim.mechanics.motion import Mechanics, Motor
from sim.witness.witness import SLACK_MM, Watched, Witness
from stages.clock import Clock
from stages.config import StagesTable
from stages.controller_tables import (
    AnyControllerTable,
    HandTable,
    MicroManagerTable,
    PositionersTable,
    PositionerTable,
)
from stages.profile import Positive
from stages.scale_question import ScaleQuestion

HAND_POLL_S = 0.1  # how often a hand looks whether it is to go on
PATIENCE = 50  # times that a hand tries again
SCREW = ("lead_mm", "steps_per_rev", "backlash_um", "lead_error_um", "scale_error_ppm")


class ScrewTable(Table):
    """One axis as it was built; the low switch closes at 0, the high one at `travel_mm`."""

    lead_mm: Positive
    steps_per_rev: Annotated[int, Field(ge=1, le=10_000_000)]
    travel_mm: Positive
    backlash_um: Annotated[float, Field(ge=0.0, le=1000.0)] = 50.0
    lead_error_um: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.0
    scale_error_ppm: float = 0.0
    power_up_mm: Positive | None = None
    noise_steps: Annotated[int, Field(ge=0, le=1000)] = 0  # by which a reading at rest flickers, to each side
    origin: Literal["low switch", "high switch"] = "low switch"  # where the firmware counts from

    @property
    def zero_mm(self) -> float:
        """Carriage position at which the controller reads zero."""
        return self.travel_mm if self.origin == "high switch" else 0.0

    def mechanics(self) -> Mechanics:
        """Return the same as the motor wants it."""
        return Mechanics(
            **{name: getattr(self, name) for name in SCREW},
            high_switch_mm=self.travel_mm,
            index_mm=self.travel_mm / 2.0,
            power_up_mm=self.power_up_mm or self.travel_mm / 3.0,
        )


class SimulatedStages:
    """The world behind the controllers of a bench file.

    Parameters
    ----------
    config : StagesTable
        The bench's stages; ports are ignored.
    clock : Clock
        `VirtualClock` for one thread and no waiting, `ScaledClock` otherwise.
    screws : mapping of str to ScrewTable
        Mechanics of every axis.
    firmware : mapping of str to dict, optional
        Further options of the emulators, by controller.
    faults : mapping of str to FaultSchedule, optional
        What happens to the answers, by controller.
    """

    def __init__(
        self,
        config: StagesTable,
        clock: Clock,
        screws: Mapping[str, ScrewTable],
        firmware: Mapping[str, Mapping[str, Any]] | None = None,
        faults: Mapping[str, FaultSchedule] | None = None,
    ) -> None:
        self.config = config
        self.clock = clock
        self.motors = {name: Motor(screws[name].mechanics(), screws[name].noise_steps) for name in config.axes}
        self.lines: dict[str, Line] = {}
        self._turns_in_vain = 0
        self._zero_mm = {name: screws[name].zero_mm for name in config.axes}
        for name, table in config.controllers.items():
            motors = {
                str(axis.channel): self.motors[axis_name]
                for axis_name, axis in config.axes.items()
                if axis.controller == name
            }
            made = emulator_class(table.driver)
            options = made.individual(name) | dict((firmware or {}).get(name, {}))
            emulator = made(motors, clock, **options)
            self.lines[name] = Line(emulator, clock, (faults or {}).get(name))
        self.witness = Witness({name: self._watch_axis(name, screws[name]) for name in config.axes}, clock)
        for line in self.lines.values():
            line.after_traffic = self.witness.judge_if_much

    def true_mm(self, axis: str) -> float:
        """Return the true position of an axis, in the coordinate of the bench file."""
        table = self.config.axes[axis]
        with self._up_to_now(axis) as motor:
            carriage_mm = motor.carriage_mm
        return table.sign * (carriage_mm - self._zero_mm[axis]) + table.offset_mm

    @contextmanager
    def _up_to_now(self, axis: str) -> Iterator[Motor]:
        """Hold the line of an axis and let its world catch up with the clock; yield its motor."""
        line = self.lines[self.config.axes[axis].controller]
        with line.lock:
            line.emulator.advance()
            yield self.motors[axis]

    @property
    def is_moving(self) -> bool:
        """Return whether any axis moves."""
        return any(motor.running for motor in self.motors.values())

    def slip(self, axis: str, distance_mm: float) -> None:
        """Let a carriage slip in its coupling now, which no controller can know."""
        self.witness.note_slip(axis, distance_mm)
        with self._up_to_now(axis) as motor:
            motor.slip(distance_mm)

    def place(self, positions_mm: Mapping[str, float]) -> None:
        """Let carriages stand elsewhere from now on, which no controller knows."""
        for axis, there_mm in positions_mm.items():
            self.slip(axis, self.config.axes[axis].sign * (there_mm - self.true_mm(axis)))

    def jam(self, axis: str) -> None:
        """Let the carriage of an axis be stuck from now on; pulses go on, and an encoder notices."""
        with self._up_to_now(axis) as motor:
            motor.is_jammed = True

    def shove(self, axis: str, distance_mm: float) -> None:
        """Turn the screw of an axis by hand now, which encoders count and step counters do not."""
        with self._up_to_now(axis) as motor:
            motor.shove(round(distance_mm / motor.mechanics.lead_mm * motor.mechanics.steps_per_rev))

    def turns(self, question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
        """Turn the screw of an axis without a motor by the simulated hand; return what that types in the end."""
        table = self.config.axes[question.axis]
        line, channel = self.lines[table.controller], str(table.channel)
        hand = line.emulator
        assert isinstance(hand, HandScrews)
        self._turns_in_vain = self._turns_in_vain + 1 if question.wrong else 0
        if self._turns_in_vain > PATIENCE:
            return None  # it cannot read its scale as finely as is asked of it
        with line.lock:
            hand.advance()
            typed = hand.begin(channel, question.target_mm)
        while self.motors[question.axis].running:
            self.clock.sleep_s(HAND_POLL_S)
            with line.lock:
                hand.advance()
                if given_up():
                    hand.let_go(channel)
                    return None
        self.witness.judge_if_much()
        return typed

    def _watch_axis(self, axis: str, screw: ScrewTable) -> Watched:
        """An axis for the witness, with what the workshop built."""
        table = self.config.axes[axis]
        built_mm = screw.backlash_um * 1e-3 + 2e-3 * screw.lead_error_um
        built_mm += abs(screw.scale_error_ppm) * 1e-6 * screw.travel_mm
        return Watched(
            motor=self.motors[axis],
            line=self.lines[table.controller],
            channel=str(table.channel),
            sign=table.sign,
            zero_mm=screw.zero_mm,
            offset_mm=table.offset_mm,
            limits_mm=(table.limits_mm[0], table.limits_mm[1]),
            slack_mm=SLACK_MM + built_mm,
        )

    @contextmanager
    def in_process(self) -> Iterator[StagesTable]:
        """Offer every line under a ``sim://`` address of this process; yield the file with these ports."""
        with ExitStack() as stack:
            ports = {name: stack.enter_context(put_up(line, name)) for name, line in self.lines.items()}
            yield self._with_ports(ports)

    @contextmanager
    def serve(self) -> Iterator[StagesTable]:
        """Offer every line as a pseudo-terminal while the block runs; yield the file with these ports.

        What a library or a hand moves is found in this process alone.
        """
        from sim.emulators.pty import PtyPort  # not every system has such terminals

        with ExitStack() as stack:
            ports = {}
            for name, line in self.lines.items():
                if isinstance(line.emulator, ForeignBox | HandScrews):
                    ports[name] = stack.enter_context(put_up(line, name))
                else:
                    ports[name] = stack.enter_context(PtyPort(line)).path
            yield self._with_ports(ports)

    def _with_ports(self, ports: Mapping[str, str]) -> StagesTable:
        controllers = {name: _at(table, ports[name]) for name, table in self.config.controllers.items()}
        return self.config.model_copy(update={"controllers": controllers})


def _at(table: AnyControllerTable, port: str) -> AnyControllerTable:
    """The same controller, behind a simulated line; a library is replaced by one that moves the simulated box."""
    if isinstance(table, MicroManagerTable):
        return table.model_copy(update={"core": "sim.emulators.micromanager:SimulatedCore", "adapters": port})
    if isinstance(table, PositionersTable):
        one = "sim.emulators.positioners:SimulatedPositioner"
        objects = {
            channel: PositionerTable(object=one, arguments={"address": port, "channel": channel})
            for channel in table.objects
        }
        return table.model_copy(update={"objects": objects})
    return table if isinstance(table, HandTable) else table.model_copy(update={"port": port})
