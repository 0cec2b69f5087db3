"""All axes of the bench by name, whatever controllers they hang on.

Several axes move one after the other in the configured order, so the way of everything they carry is a chain of
straight pieces that can be checked against keep-out before the first of them begins. If one fails, all are
stopped.

Homing happens on request, in the configured order. A stop goes to every controller at once, past every queue,
and is harmless when nothing moves.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from stages.axis import Arrival, Axis, AxisState, StopSwitch
from stages.clock import SYSTEM_CLOCK, Clock
from stages.config import StagesTable
from stages.controller import Channel, Controller
from stages.drivers import driver_class
from stages.errors import NotReferenced, StageError, StageUsageError


@dataclass(frozen=True, slots=True)
class Piece:
    """One axis moving while the others rest: part of the way of a move."""

    axis: str
    start_mm: float
    end_mm: float
    others_mm: Mapping[str, float]  # every axis, this one included at its start


class Guard(Protocol):
    """Judges a way before it is driven; `stages.keep_out.KeepOut` is one."""

    def check(self, way: Sequence[Piece]) -> None:
        """Raise `Obstructed` if the way must not be driven."""
        ...


class Stage:
    """Named axes over any mix of controllers.

    Use `Stage.open`; as a context manager it closes every port at the end, and stops first if an error ends
    the block.
    """

    def __init__(self, config: StagesTable, clock: Clock = SYSTEM_CLOCK, guard: Guard | None = None) -> None:
        self.config = config
        self.guard = guard
        self._clock = clock
        self._switch = StopSwitch()
        self._controllers: dict[str, Controller] = {}
        self._axes: dict[str, Axis] = {}
        for name, table in config.controllers.items():
            used = [axis.settings() for axis in config.axes.values() if axis.controller == name]
            channels = {axis.channel: Channel(axis.channel, axis.steps_per_mm) for axis in used}
            self._controllers[name] = driver_class(table.driver)(name, channels, clock)
        for name, axis in config.axes.items():
            self._axes[name] = Axis(name, self._controllers[axis.controller], axis.settings(), clock, self._switch)

    @classmethod
    def open(cls, config: StagesTable, clock: Clock = SYSTEM_CLOCK, guard: Guard | None = None) -> "Stage":
        """Connect every controller; nothing moves.

        Raises
        ------
        PortError, WrongDevice, StageUsageError
            A controller is not there, is another one, or cannot do what the file asks; all ports are closed again.
        """
        stage = cls(config, clock, guard)
        try:
            for name in config.controllers:
                stage.connect(name)
        except BaseException:
            stage.close()
            raise
        return stage

    def connect(self, controller: str) -> None:
        """Open (again) the port of one controller; after a loss its axes have to be homed."""
        table = self.config.controllers[controller]
        box = self._controllers[controller]
        box.connect(table.port, table.baud)
        for axis in self._axes.values():
            if axis.controller is box:
                settings = axis.settings
                for speed_mm_s in {
                    settings.speed_mm_s,
                    *([settings.approach.speed_mm_s] if settings.approach else []),
                }:
                    box.check_motion(settings.channel, speed_mm_s, settings.acceleration_mm_s2)

    @property
    def axes(self) -> Mapping[str, Axis]:
        """The axes by name."""
        return self._axes

    @property
    def controllers(self) -> Mapping[str, Controller]:
        """The controllers by name."""
        return self._controllers

    def axis(self, name: str) -> Axis:
        """Return one axis.

        Raises
        ------
        StageUsageError
            There is none of that name.
        """
        if name not in self._axes:
            raise StageUsageError(f"there is no axis {name!r}; there are {', '.join(self._axes)}")
        return self._axes[name]

    def where_mm(self) -> dict[str, float | None]:
        """Measured position of every axis at rest; None where it is not known."""
        return {
            name: axis.position_mm if axis.state is AxisState.READY else None for name, axis in self._axes.items()
        }

    def way(self, start_mm: Mapping[str, float], targets_mm: Mapping[str, float]) -> list[Piece]:
        """Return the pieces of a move in the order they will be driven; sends nothing.

        Parameters
        ----------
        start_mm : mapping
            Position of every axis.
        targets_mm : mapping
            Where some axes shall go.
        """
        here, pieces = dict(start_mm), []
        for name in self._ordered(targets_mm):
            for leg in self._axes[name].legs(here[name], targets_mm[name]):
                pieces.append(Piece(name, leg.start_mm, leg.end_mm, dict(here)))
                here[name] = leg.end_mm
        return pieces

    def check(self, start_mm: Mapping[str, float], targets_mm: Mapping[str, float]) -> None:
        """Raise if a move must not be made; sends nothing.

        Raises
        ------
        OutOfRange, Obstructed, StageUsageError
            A target is outside the limits, something is in the way, or there is no such axis.
        """
        for name, target_mm in targets_mm.items():
            self.axis(name).check(target_mm)
        if self.guard is not None:
            self.guard.check(self.way(start_mm, targets_mm))

    def duration_s(self, start_mm: Mapping[str, float], targets_mm: Mapping[str, float]) -> float:
        """Time a move will take; sends nothing."""
        return sum(self.axis(name).duration_s(start_mm[name], targets_mm[name]) for name in targets_mm)

    def move(self, targets_mm: Mapping[str, float]) -> dict[str, Arrival]:
        """Move some axes, one after the other, and wait until each rests at its target.

        Raises
        ------
        StageUsageError
            The move must not be made; nothing has moved.
        StageError
            Something came between; everything has been stopped.
        """
        for name, target_mm in targets_mm.items():
            self.axis(name).check(target_mm)
        start_mm = {name: self._axes[name].position_mm for name in self._known_or_needed(targets_mm)}
        self.check(start_mm, targets_mm)
        try:
            return {name: self._axes[name].move_to(targets_mm[name]) for name in self._ordered(targets_mm)}
        except BaseException:
            self.stop_quietly()
            raise

    def home(self, names: Iterable[str] | None = None, tell: Callable[[str], None] | None = None) -> None:
        """Home axes in the configured order; all of them if none are named.

        Parameters
        ----------
        names : iterable of str, optional
            Which.
        tell : callable, optional
            Called with the name of an axis before it begins: a long rail takes its time.

        Raises
        ------
        StageUsageError
            A controller homes several axes with one command and not all of them were named; nothing has moved.
        StageError
            A reference was not found; everything has been stopped.
        """
        wanted = set(self._axes if names is None else names)
        order = [name for name in self.config.home_order if self.axis(name) and name in wanted]
        if unknown := wanted - set(order):
            raise StageUsageError(f"there is no axis {', '.join(sorted(unknown))}")
        for name in order:
            if missing := set(self._homes_with(name)) - wanted:
                raise StageUsageError(f"homing {name} also homes {', '.join(sorted(missing))}; name them too")
        done: set[str] = set()
        try:
            for name in order:
                if name in done:
                    continue
                if tell is not None:
                    tell(name)
                self._axes[name].home()
                for other in self._homes_with(name):
                    self._axes[other].trust_reference()
                    done.add(other)
        except BaseException:
            self.stop_quietly()
            raise

    def stop(self) -> None:
        """Stop everything now, from any thread; every controller is tried even if one fails.

        Raises
        ------
        StageError
            A controller could not be told; it is the first such error.
        """
        self._switch.press()
        failures = []
        for controller in self._controllers.values():
            try:
                controller.stop()
            except StageError as failure:
                failures.append(failure)
        if failures:
            raise failures[0]

    def stop_quietly(self) -> None:
        """Stop everything; for use while another error is on its way."""
        try:
            self.stop()
        except StageError:
            return

    def close(self) -> None:
        """Close every port in reverse order."""
        for controller in reversed(self._controllers.values()):
            controller.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.stop_quietly()
        self.close()

    def _ordered(self, names: Iterable[str]) -> list[str]:
        order = self.config.move_order or list(self._axes)
        return [name for name in order if name in set(names)]

    def _homes_with(self, name: str) -> list[str]:
        controller = self._axes[name].controller
        if not controller.homes_together:
            return [name]
        return [other for other, axis in self._axes.items() if axis.controller is controller]

    def _known_or_needed(self, targets_mm: Mapping[str, float]) -> list[str]:
        """Axes whose position a move needs: its own, and all of them if a guard has to look."""
        if self.guard is None:
            return list(targets_mm)
        for name, axis in self._axes.items():
            if axis.state is not AxisState.READY:
                raise NotReferenced(
                    f"{name} does not know where it is, so keep-out cannot be checked; home it first"
                )
        return list(self._axes)
