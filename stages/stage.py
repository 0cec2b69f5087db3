"""All axes of the bench by name, whatever controllers they hang on.

Several axes move one after the other in the configured order, so the way of everything they carry is a chain of
straight pieces that can be checked against keep-out before the first of them begins. Each axis is judged once
more, with fresh positions of all, before it starts: a controller that has restarted meanwhile is noticed. Judging
and driving happen in one turn; who else wants to move waits for it. If one axis fails, all are halted.

Homing happens on request, in the configured order; when all axes have been homed they leave the homed place by the
configured moves (`after_home`), each judged as every move. A stop goes to every controller at once, past every
queue and every turn, is harmless when nothing moves, and holds until `clear_stop`.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Self

from ground.named_program import require_trust
from stages.axis import Arrival, Axis, Turn
from stages.axis_settings import AxisSettings
from stages.clock import SYSTEM_CLOCK, Clock
from stages.config import StagesTable
from stages.drivers_by_name import controller_class
from stages.errors import DeviceLost, MotionBarred, NotReferenced, StageError, StageUsageError, WrongDevice
from stages.identities import require_identity
from stages.motion_controller import Channel, MotionController
from stages.scale_question import Person, ScaleQuestion
from stages.states import AxisState
from stages.stop_latch import StopLatch
from stages.stop_signals import StopSignals
from stages.watchdog import Watchdog
from stages.way import Guard, Piece


class Stage:
    """Named axes over any mix of controllers.

    Use `Stage.open` as a context manager: however the block ends (by itself, by an error, by a signal) what moves
    is stopped, then every port is closed. Where the process can end without that, a watchdog stops what moves.
    """

    def __init__(self, config: StagesTable, clock: Clock = SYSTEM_CLOCK, guard: Guard | None = None) -> None:
        self.config = config
        self.guard = guard
        self._clock = clock
        self._signals = StopSignals(self.stop)
        self._turn = Turn(judge=self._judge, signals=self._signals)
        self._hand_bars: list[Callable[[], str | None]] = []
        self._watchdog: Watchdog | None = None
        self._just_judged: dict[str, float] | None = None
        self._controllers: dict[str, MotionController] = {}
        self._axes: dict[str, Axis] = {}
        self._said_mm: dict[str, float] = {}
        config.require_own_ports()
        require_trust(program for table in config.controllers.values() for program in table.programs)
        for name, table in config.controllers.items():
            used = {
                str(axis.channel): _channel_of(axis_name, axis)
                for axis_name, axis in config.axes.items()
                if axis.controller == name
            }
            self._controllers[name] = controller_class(table.driver)(name, used, clock, self.latch)
        for name, axis in config.axes.items():
            self._axes[name] = Axis(name, self._controllers[axis.controller], axis, clock, self._turn)

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
        box.open(table)
        try:
            require_identity(controller, table.identity, box.identity, table.place)
        except WrongDevice:
            box.close()
            raise
        box.register_watchdog(table, self._the_watchdog)
        for axis in self._axes.values():
            if axis.controller is box:
                settings = axis.settings
                for speed_mm_s in {
                    settings.speed_mm_s,
                    *([settings.approach.speed_mm_s] if settings.approach else []),
                }:
                    box.check_motion(settings.channel, speed_mm_s, settings.acceleration_mm_s2)
                axis.note_connected()

    def _the_watchdog(self) -> Watchdog:
        self._watchdog = self._watchdog or Watchdog(self._end_unwatched_motion)
        return self._watchdog

    def _end_unwatched_motion(self, why: str) -> None:
        """Stop what moves when its watchdog has died."""
        if self.what_moves():
            with suppress(StageError):
                self.stop(why)

    @property
    def latch(self) -> StopLatch:
        """The one stop of the bench; exposures obey it too."""
        return self._turn.latch

    def bar_motion(self, why: Callable[[], str | None]) -> None:
        """Ask a function before anything moves; a sentence as its answer refuses the motion (`MotionBarred`)."""
        self._turn.bars.append(why)

    def set_operator(self, person: Person) -> None:
        """Say who turns the axes without a motor, and reads their scales.

        Parameters
        ----------
        person : callable
            Puts a question (`stages.scale_question`) and returns what was typed.
        """

        def ask_operator(question: ScaleQuestion, given_up: Callable[[], bool]) -> str | None:
            for why_not in self._hand_bars:
                if why := why_not():
                    raise MotionBarred(f"{question.axis} is moved by hand, and must not be reached now: {why}")
            return person(question, given_up)

        for box in self._controllers.values():
            box.set_operator(ask_operator)

    def bar_hands(self, why: Callable[[], str | None]) -> None:
        """Ask a function before a person reaches in; a sentence as the answer refuses it, with `MotionBarred`."""
        self._hand_bars.append(why)

    def what_moves(self) -> str | None:
        """Say what moves, is about to, or was not heard to rest, as part of a sentence; asks nothing."""
        if self._turn.holds:
            return "an axis of the stage is being moved"
        for name, box in self._controllers.items():
            if box.under_way:
                return f"{name} has not been heard to rest since its last motion; open, home or move it again"
        return None

    @property
    def axes(self) -> Mapping[str, Axis]:
        """The axes by name."""
        return self._axes

    @property
    def controllers(self) -> Mapping[str, MotionController]:
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

    def where_mm(self, only: Iterable[str] | None = None) -> dict[str, float | None]:
        """Measured position of every axis that its controller vouches for now; None where it is not known.

        Parameters
        ----------
        only : iterable of str, optional
            Axes to be asked; all by default.
        """
        where: dict[str, float | None] = {}
        for name in self._axes if only is None else only:
            axis = self.axis(name)
            try:
                where[name] = None if axis.controller.is_lost else axis.position_mm
            except StageUsageError:  # not referenced (any more), or moving
                where[name] = None
        return where

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
        for name in self._homing_order(targets_mm):
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
        MotionStopped
            A stop holds the bench, or came while it moved.
        StageError
            Something came between; everything has been halted.
        """
        for name, target_mm in targets_mm.items():
            self.axis(name).check(target_mm)
        token = self.latch.begin()  # before the turn: a stop while another one moves ends this move too
        with self._turn.take():
            self.latch.check(token)
            start_mm = self._positions_mm(targets_mm)
            self.check(start_mm, targets_mm)
            self._just_judged = start_mm
            try:
                return {
                    name: self._axes[name].carry_out(targets_mm[name], token)
                    for name in self._homing_order(targets_mm)
                }
            except BaseException:
                self.halt_quietly()
                raise
            finally:
                self._just_judged = None

    def confirm(self, name: str, position_mm: float) -> None:
        """Take a person's word for where an axis that is homed by hand rests now; nothing moves.

        Raises
        ------
        StageUsageError
            There is no such axis, it moves, the place is outside its limits, or its box homes by itself.
        """
        self.axis(name).confirm(position_mm)
        self._said_mm[name] = position_mm

    @property
    def operator_mm(self) -> Mapping[str, float]:
        """Axes whose reference is a person's word, and where they were said to be."""
        return {name: mm for name, mm in self._said_mm.items() if self._axes[name].state is AxisState.READY}

    def home(
        self,
        names: Iterable[str] | None = None,
        tell: Callable[[str], None] | None = None,
        ask: Callable[[str], float] | None = None,
    ) -> None:
        """Home axes in the configured order; all of them if none are named.

        Axes that are homed by hand keep their reference if they have one; else a person is asked first.

        Parameters
        ----------
        names : iterable of str, optional
            Which.
        tell : callable, optional
            Called with the name of an axis before it begins: a long rail takes its time.
        ask : callable, optional
            The person at the bench: returns where an axis stands that cannot look for its reference [mm].

        Raises
        ------
        StageUsageError
            An axis is homed by hand and there is no operator to ask, or a controller homes several axes with one
            command and not all of them were named; nothing has moved.
        Obstructed
            All axes are homed, and a move of `after_home` must not be made.
        MotionStopped
            A stop holds the bench, or came meanwhile.
        DeviceLost
            A controller was lost while it moved something, which may move still; nothing has been homed.
        StageError
            A reference was not found; everything has been halted.
        """
        wanted = set(self._axes if names is None else names)
        order = [name for name in self.config.home_order if self.axis(name) and name in wanted]
        if unknown := wanted - set(order):
            raise StageUsageError(f"there is no axis {', '.join(sorted(unknown))}")
        for name in order:
            if missing := set(self._homes_with(name)) - wanted:
                raise StageUsageError(f"homing {name} also homes {', '.join(sorted(missing))}; name them too")
        done = self._confirm_by_hand(order, ask)
        token = self.latch.begin()
        with self._turn.take():
            self._refuse_beside_lost_motion()
            try:
                for name in order:
                    if name in done:
                        continue
                    if tell is not None:
                        tell(name)
                    self.latch.check(token)
                    self._axes[name].home()
                    for other in self._homes_with(name):
                        if other != name:
                            self._axes[other].trust_reference()
                        done.add(other)
            except BaseException:
                self.halt_quietly()
                raise
            if len(done) == len(self._axes):
                self._leave_home()

    def _confirm_by_hand(self, names: Iterable[str], ask: Callable[[str], float] | None) -> set[str]:
        """Those of some axes that are homed by hand, each with a person's word that still holds."""
        by_hand = [name for name in names if self._axes[name].needs_hand_homing]
        for name in by_hand:
            if self._axes[name].state is AxisState.READY:
                continue
            if ask is None:
                raise StageUsageError(
                    f"{name} is homed by hand: read its position, then `confirm {name}=MM` in `rtpiv bench stage`"
                )
            self.confirm(name, ask(name))
        return set(by_hand)

    def stop(self, why: str = "the bench was stopped on request") -> None:
        """Stop everything now, from any thread, and hold the bench until `clear_stop`.

        Every controller is stopped even if one fails.

        Parameters
        ----------
        why : str
            Reason given to callers that want to move meanwhile.

        Raises
        ------
        StageError
            A controller could not be reached; it is the first such error.
        """
        self.latch.stop(why)
        self._tell_all_to_stop()

    def halt(self) -> None:
        """End every motion that has begun, from any thread; what is asked for afterwards may move.

        Raises
        ------
        StageError
            A controller could not be reached; it is the first such error.
        """
        self.latch.halt()
        self._tell_all_to_stop()

    @property
    def is_held(self) -> bool:
        """True if a stop holds the bench."""
        return self.latch.is_held

    def clear_stop(self) -> None:
        """Let the bench move again: a person has looked at it, and asks for it."""
        self.latch.clear()

    def _tell_all_to_stop(self) -> None:
        failures = []
        for controller in self._controllers.values():
            try:
                controller.stop()
            except StageError as failure:
                failures.append(failure)
        if failures:
            raise failures[0]

    def stop_quietly(self) -> None:
        """Stop everything and hold it; for use while another error is on its way."""
        with suppress(StageError):
            self.stop()

    def _refuse_beside_lost_motion(self) -> None:
        """DeviceLost where something may move unnoticed: a reference run is not checked."""
        for name, box in self._controllers.items():
            if box.is_lost and box.under_way:
                raise DeviceLost(f"{name} was lost while it moved and may move still; open it again first")

    def halt_quietly(self) -> None:
        """End every motion; for use while another error is on its way."""
        with suppress(StageError):
            self.halt()

    def close(self) -> None:
        """Close every port in reverse order."""
        for controller in reversed(self._controllers.values()):
            controller.close()
        if self._watchdog is not None:  # after the ports, so that it can open what has not come to rest
            watchdog, self._watchdog = self._watchdog, None
            watchdog.close()

    def __enter__(self) -> Self:
        self._signals.enter()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._signals.leaving(stop=any(box.under_way for box in self._controllers.values())):
            if error is not None:
                self.halt_quietly()
            self.close()

    def _leave_home(self) -> None:
        """Carry out the moves that lead out of the homed place."""
        for number, targets_mm in enumerate(self.config.after_home, start=1):
            try:
                self.move(targets_mm)
            except StageUsageError as error:
                raise type(error)(f"move {number} of after_home: {error}") from error

    def _homing_order(self, names: Iterable[str]) -> list[str]:
        order = self.config.move_order or list(self._axes)
        return [name for name in order if name in set(names)]

    def _homes_with(self, name: str) -> list[str]:
        axis = self._axes[name]
        channels = axis.controller.channels_homed_with(axis.settings.channel)
        return [
            other
            for other, one in self._axes.items()
            if one.controller is axis.controller and one.settings.channel in channels
        ]

    def _positions_mm(self, names: Iterable[str]) -> dict[str, float]:
        """Positions that a move needs, known now: its own axes, and all of them if a guard has to look.

        Raises
        ------
        NotReferenced
            One of them does not know where it is.
        """
        if self.guard is None:
            return {name: self._axes[name].position_mm for name in names}
        found = {}
        for name, axis in self._axes.items():
            try:
                found[name] = axis.position_mm
            except NotReferenced as unknown:
                raise NotReferenced(f"{unknown}; keep-out cannot be checked without it") from unknown
        return found

    def _judge(self, name: str, target_mm: float) -> Mapping[str, float]:
        """Judge the way of one axis from where everything is now; the first of a move has just been judged."""
        start_mm, self._just_judged = self._just_judged, None
        if start_mm is None:
            start_mm = self._positions_mm([name])
            self.check(start_mm, {name: target_mm})
        return start_mm


def _channel_of(axis: str, settings: AxisSettings) -> Channel:
    """An axis as its controller knows it."""
    low_mm, high_mm = sorted(settings.sign * (limit_mm - settings.offset_mm) for limit_mm in settings.limits_mm)
    tolerance_mm = settings.in_position_um * 1e-3
    return Channel(settings.channel, settings.steps_per_mm, axis, (low_mm, high_mm), tolerance_mm)
