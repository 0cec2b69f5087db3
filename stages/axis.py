"""One axis in mm: limits, reference, arrival from one side, settling, reading back, trying again.

    axis_mm = sign * controller_mm + offset_mm

An axis moves only when it knows where it is NOW. It does not after power-up (unless the controller remembers),
after a limit switch, a stall, a lost port or a restart of its controller; then absolute moves are refused until
it has been homed on request. The reference is asked for after every reading and before every leg, so a controller
that has restarted unnoticed is never believed (`stages.states` has the table). Targets are judged before anything
is sent: not finite or outside the limits, approach included, raises and moves nothing; nothing is ever clipped.

An arrival is what the controller reports at rest after the settling time, compared with the target. Outside the
tolerance, or after an answer that was lost or damaged, the whole way is judged and driven again, `retries` times
at most.

Axes of one bench take turns: who moves holds `Turn.lock` from the judgement to the arrival, so two moves that were
judged one by one can never meet. Stops need no turn (`stages.stop_latch`).

Other devices may bar motion, a laser while light may leave: who has taken the turn asks them before the first
byte. They look in turn whether it is taken once they have said that they bar it; so at least one of the two always
sees the other, and no lock has to be shared.
"""

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from typing import TypeVar

from stages.axis_settings import ROUNDING_UM, AxisSettings
from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import (
    AxisStalled,
    DeviceError,
    DeviceLost,
    LimitHit,
    MotionBarred,
    MotionStopped,
    NoReply,
    NotInPosition,
    NotReferenced,
    OutOfRange,
    PortError,
    ProtocolViolation,
    StageUsageError,
)
from stages.motion_controller import MotionController
from stages.profile import Leg, duration_s, legs
from stages.states import MAY_HOME, MAY_MOVE, MAY_READ, AxisState, Event, after
from stages.stop_latch import StopLatch
from stages.stop_signals import StopSignals

MOTION_POLL_S = 0.03
STOP_SETTLE_S = 3.0  # time given to a motion to end after a stop
SETTLE_READINGS = 3  # in a row that must find rest after a stop: a command under way may still begin
NAP_S = 0.1  # a settling axis looks at the latch this often

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Arrival:
    """Target and reported position of an axis."""

    axis: str
    target_mm: float
    measured_mm: float
    attempts: int
    duration_s: float

    @property
    def error_um(self) -> float:
        """Measured minus target."""
        return (self.measured_mm - self.target_mm) * 1000.0


@dataclass
class Turn:
    """Shared state of all axes of a bench: the stop, the turn, and the guard that checks every path first.

    Parameters
    ----------
    latch : StopLatch
        Asked before every byte that moves.
    lock : RLock
        Held from the judgement of a move to its arrival.
    signals : StopSignals, optional
        Held back while the main thread has the turn.
    judge : callable, optional
        Gets an axis' name and target; returns fresh positions of the axes it looked at, that one included, or
        raises.
    bars : list of callable
        Each says why nothing may move now, as a sentence, or None.
    """

    latch: StopLatch = field(default_factory=StopLatch)
    lock: threading.RLock = field(default_factory=threading.RLock)
    judge: Callable[[str, float], Mapping[str, float]] | None = None
    signals: StopSignals | None = None
    bars: list[Callable[[], str | None]] = field(default_factory=list)
    holds: int = 0  # how often the one who has the turn has taken it

    @contextmanager
    def take(self) -> Iterator[None]:
        """Take the turn; what a signal asks for beyond the stop waits for the end of it.

        Raises
        ------
        MotionBarred
            Another device must not see motion now.
        """
        with self.signals.turn() if self.signals is not None else nullcontext(), self.lock:
            self.holds += 1  # before others are asked: those that bar motion look at this afterwards
            try:
                for bar in self.bars:
                    if why := bar():
                        raise MotionBarred(f"nothing has moved: {why}")
                yield
            finally:
                self.holds -= 1


class Axis:
    """One axis of a controller.

    Parameters
    ----------
    name : str
        As in the bench file.
    controller : MotionController
        What moves it.
    settings : AxisSettings
        Limits, speeds, tolerance.
    clock : Clock
        Clock of every wait.
    turn : Turn
        Shared by all axes of a stage.
    """

    def __init__(
        self,
        name: str,
        controller: MotionController,
        settings: AxisSettings,
        clock: Clock = SYSTEM_CLOCK,
        turn: Turn | None = None,
    ) -> None:
        self.name = name
        self.settings = settings
        self.controller = controller
        self._clock = clock
        self._turn = turn or Turn()
        self._latch = self._turn.latch
        self._state = AxisState.LOST
        self._rests_at_mm: float | None = None

    # ---- what is known -------------------------------------------------------------------------

    @property
    def state(self) -> AxisState:
        """Present state; a controller at rest is asked whether its reference still holds."""
        if self._state_without_asking() is AxisState.READY:
            try:
                self._run_guarded(lambda: self.controller.confirm_reference(self.settings.channel))
            except (PortError, DeviceError):  # silence and nonsense confirm nothing
                return AxisState.LOST if self.controller.is_lost else AxisState.UNREFERENCED
            except StageUsageError:  # not referenced any more, or mute because another of its axes moves
                return self._state_without_asking()
        return self._state

    @property
    def position_mm(self) -> float:
        """Position at rest as the controller reports it, and vouches for now.

        Raises
        ------
        NotReferenced
            The axis does not know where it is, or its controller has restarted.
        DeviceLost
            The controller is gone.
        """
        self._require(MAY_READ)
        return self._run_guarded(self._read_mm)

    def check(self, target_mm: float) -> None:
        """Raise if a target must not be asked for; sends nothing.

        Raises
        ------
        OutOfRange
            Not a finite number, or outside the limits, the way from the approach side included.
        """
        low, high = self.settings.limits_mm
        if not math.isfinite(target_mm):
            raise OutOfRange(f"{self.name}: {target_mm} is not a position")
        if not low <= target_mm <= high:
            raise OutOfRange(f"{self.name}: {target_mm:g} mm is outside its limits {low:g} to {high:g} mm")
        approach = self.settings.approach
        if approach and not low <= approach.before_mm(target_mm) <= high:
            side = "below" if approach.upwards else "above"
            raise OutOfRange(
                f"{self.name}: {target_mm:g} mm cannot be approached from {side} within its limits "
                f"{low:g} to {high:g} mm; {approach.distance_mm:g} mm are needed"
            )

    def legs(self, start_mm: float, target_mm: float) -> tuple[Leg, ...]:
        """Return the motions from one position to another; sends nothing."""
        return legs(start_mm, target_mm, self.settings.speed_mm_s, self.settings.approach)

    def duration_s(self, start_mm: float, target_mm: float) -> float:
        """Time a move will take, settling included; sends nothing."""
        way = self.legs(start_mm, target_mm)
        return self.settings.settle_s + sum(self._leg_s(leg) for leg in way)

    # ---- motion --------------------------------------------------------------------------------

    def move_to(self, target_mm: float) -> Arrival:
        """Move to a position, arriving from the approach side, and wait until the axis rests there.

        Raises
        ------
        OutOfRange, NotReferenced, Obstructed
            Nothing has moved.
        MotionStopped, LimitHit, AxisStalled, NotInPosition, DeviceLost, NoReply
            What came between.
        """
        self.check(target_mm)
        token = self._latch.begin()  # before the turn: a stop while another one moves ends this move too
        with self._turn.take():
            return self.carry_out(target_mm, token)

    def move_by(self, distance_mm: float) -> Arrival:
        """Move by a distance from where the axis is; same rules as `move_to`."""
        return self.move_to(self.position_mm + distance_mm)

    def carry_out(self, target_mm: float, token: int) -> Arrival:
        """Do what `move_to` says, for a caller that holds the turn and has a token; for `stages.stage`.

        Raises
        ------
        NotReferenced, DeviceLost, Obstructed
            The axis must be homed or opened first, or its way is not free.
        MotionStopped, LimitHit, AxisStalled
            What ended the motion; the first of them also for a token that is no longer good.
        NoReply, ProtocolViolation
            The answer to the last attempt was lost or damaged.
        NotInPosition
            The axis rests outside its tolerance after the last attempt.
        """
        self._latch.check(token)
        self._require(MAY_MOVE)
        self.controller.token = token
        begun_s, failure = self._clock.now_s(), None
        for attempt in range(1, self.settings.retries + 2):
            try:
                measured_mm = self._attempt(target_mm, token)
            except (NoReply, ProtocolViolation) as error:
                failure = error
                self._run_guarded(self._settle_after_stop, token)
                self._latch.check(token)
                self._run_guarded(lambda: self.controller.resolve_missing_reply(self.settings.channel), token)
                continue
            if abs(measured_mm - target_mm) * 1000.0 <= self.settings.in_position_um + ROUNDING_UM:
                self._rests_at_mm = target_mm
                return Arrival(self.name, target_mm, measured_mm, attempt, self._clock.now_s() - begun_s)
            self._rests_at_mm, failure = None, None
        if failure is not None:
            raise failure
        raise NotInPosition(
            f"{self.name} rests at {measured_mm:.4f} mm, {abs(measured_mm - target_mm) * 1000:.1f} um from "
            f"its target, after {self.settings.retries + 1} attempts"
        )

    def stop(self) -> None:
        """Stop the whole bench now and hold it until the stop is cleared; from any thread, harmless at rest."""
        self._latch.stop(f"{self.name} was stopped")
        self.controller.stop()

    def home(self) -> None:
        """Look for the reference; moves the axis without knowing where it is, so only on request.

        Raises
        ------
        MotionStopped, LimitHit, AxisStalled, DeviceLost, NoReply
            The reference was not found.
        DeviceError
            The reference run ended without a reference; home it again.
        StageUsageError
            The axis moves already, or homing is switched off at its controller.
        """
        token = self._latch.begin()
        with self._turn.take():
            self._latch.check(token)
            self._require(MAY_HOME)
            self.controller.token = token
            self._happens(Event.HOME)
            try:
                self._run_guarded(lambda: self._find_reference(token), token)
                if not self.controller.has_reference(self.settings.channel):
                    text = f"{self.name} has ended its reference run without a reference; home it again"
                    raise DeviceError(text)
            except BaseException as error:
                try:
                    if isinstance(error, NoReply | ProtocolViolation):
                        self._run_guarded(self._settle_after_stop, token)
                        self._run_guarded(
                            lambda: self.controller.resolve_missing_reply(self.settings.channel), token
                        )
                finally:  # also if an alarm, or anything else, comes while it is brought to rest
                    if self._state is AxisState.HOMING:
                        self._happens(Event.FORGET)
                raise
            self._happens(Event.FOUND)

    @property
    def needs_hand_homing(self) -> bool:
        """True if a person says where the axis stands, because its box cannot look for its reference."""
        return self.controller.needs_hand_homing(self.settings.channel)

    def confirm(self, position_mm: float) -> None:
        """Take a person's word for where the axis rests now; nothing moves.

        Raises
        ------
        OutOfRange
            Not a finite number, or outside the limits.
        StageUsageError
            The axis moves, or its box looks for its reference itself.
        DeviceLost
            The controller is gone.
        """
        low, high = self.settings.limits_mm
        if not low <= position_mm <= high:
            raise OutOfRange(f"{self.name}: {position_mm:g} mm is outside its limits {low:g} to {high:g} mm")
        with self._turn.take():
            self._require(MAY_HOME)
            box_mm = self.settings.sign * (position_mm - self.settings.offset_mm)
            self._run_guarded(lambda: self.controller.confirm(self.settings.channel, box_mm))
            self._happens(Event.FOUND)

    def trust_reference(self) -> None:
        """Accept a reference that a motion of another axis of the same controller has found."""
        self._happens(Event.FOUND)

    # ---- states --------------------------------------------------------------------------------

    def note_connected(self) -> None:
        """Note that the port is open (again): what the controller does not confirm is unknown."""
        self._happens(Event.CUT)
        self._happens(Event.CONNECT)
        if self.controller.has_reference(self.settings.channel):
            self._happens(Event.FOUND)

    def _happens(self, event: Event) -> None:
        self._state = after(self._state, event)
        if event is not Event.REST:
            self._rests_at_mm = None

    def _state_without_asking(self) -> AxisState:
        """State as far as it is known without asking."""
        if self.controller.is_lost:
            self._happens(Event.CUT)
        elif self._state in (AxisState.READY, AxisState.MOVING) and not self.controller.has_reference(
            self.settings.channel
        ):
            self._happens(Event.FORGET)
        return self._state

    def _require(self, states: frozenset[AxisState]) -> None:
        state = self._state_without_asking()
        if state in states:
            return
        if state is AxisState.LOST:
            raise DeviceLost(f"{self.name}: its controller is gone; plug it in, open it again and home the axis")
        if state is AxisState.UNREFERENCED:
            raise NotReferenced(f"{self.name} has no position reference; home it first")
        raise StageUsageError(f"{self.name} is {state.value}; wait for the end of it")

    def _run_guarded(self, action: Callable[[], T], token: int | None = None) -> T:
        """Run, and forget the position if what happens makes it unreliable.

        A motion that was not ended from here was ended by a person at the box: that is a stop of the whole bench.
        """
        try:
            return action()
        except (DeviceLost, LimitHit, AxisStalled, NotReferenced):
            self._happens(Event.CUT if self.controller.is_lost else Event.FORGET)
            raise
        except MotionStopped as stopped:
            self._rests_at_mm = None
            if token is not None and self._latch.count == token:
                self._latch.stop(f"{self.name} was stopped at its controller ({stopped})")
            raise
        except (NoReply, ProtocolViolation):
            self._rests_at_mm = None
            raise
        finally:
            if self._state is AxisState.MOVING:
                self._happens(Event.REST)

    # ---- driving -------------------------------------------------------------------------------

    def _read_mm(self) -> float:
        return (
            self.settings.sign * self.controller.rest_position_mm(self.settings.channel) + self.settings.offset_mm
        )

    def _attempt(self, target_mm: float, token: int) -> float:
        """Judge the way from where the axis is, drive it, return where the axis came to rest."""
        judge = self._turn.judge
        here_mm = self.position_mm if judge is None else judge(self.name, target_mm)[self.name]
        if self._rests_at_mm == target_mm:
            return here_mm
        self._happens(Event.START)
        return self._run_guarded(lambda: self._drive(here_mm, target_mm, token), token)

    def _drive(self, here_mm: float, target_mm: float, token: int) -> float:
        for leg in self.legs(here_mm, target_mm):
            self._drive_leg(leg, token)
        self._settle(token)
        return self._read_mm()

    def _drive_leg(self, leg: Leg, token: int) -> None:
        end_mm = (leg.end_mm - self.settings.offset_mm) * self.settings.sign
        channel, controller = self.settings.channel, self.controller
        controller.confirm_reference(channel)  # a controller that restarted since would drive to another place
        controller.start_move(channel, end_mm, leg.speed_mm_s, self.settings.acceleration_mm_s2)
        self._wait(2.0 + 1.5 * self._leg_s(leg), token)

    def _settle(self, token: int) -> None:
        end_s = self._clock.now_s() + self.settings.settle_s
        while (left_s := end_s - self._clock.now_s()) > 0.0:
            self._clock.sleep_s(min(NAP_S, left_s))
            self._latch.check(token)

    def _find_reference(self, token: int) -> None:
        self.controller.start_home(self.settings.channel)
        self._wait(self.settings.home_timeout_s, token)

    def _leg_s(self, leg: Leg) -> float:
        return duration_s(leg.end_mm - leg.start_mm, leg.speed_mm_s, self.settings.acceleration_mm_s2)

    def _wait(self, limit_s: float, token: int) -> None:
        """Wait for the end of a motion; after a stop, until several looks in a row have found the axis at rest."""
        end_s, looks = self._clock.now_s() + limit_s, 0
        while True:
            stopped = self._latch.count != token
            if stopped:
                self.controller.stop()
            looks = 0 if self._moves(stopped) else looks + 1
            if looks >= (SETTLE_READINGS if stopped else 1):
                break
            if self._clock.now_s() >= end_s:
                raise NoReply(f"{self.name} has not ended its motion within {limit_s:.1f} s; stopped")
            self._clock.sleep_s(MOTION_POLL_S)
        self.controller.rests()
        self._latch.check(token)

    def _moves(self, stopped: bool) -> bool:
        """Ask once; after a stop, whatever else ended the motion is only one more way of resting."""
        try:
            return self.controller.moving(self.settings.channel)
        except ProtocolViolation:
            raise
        except (DeviceError, NotReferenced):
            if not stopped:
                raise
            return False

    def _settle_after_stop(self) -> None:
        """Bring a motion of unknown state to rest, and the link into a known one.

        It is looked at once before our own stop, which would hide that a person has stopped it.
        """
        if self._latch.count == self.controller.token:
            with suppress(NoReply, ProtocolViolation):
                self.controller.moving(self.settings.channel)
        end_s = self._clock.now_s() + STOP_SETTLE_S
        while self._clock.now_s() < end_s:
            self.controller.stop()
            try:
                if not self._moves(True):
                    break
            except (NoReply, ProtocolViolation):
                pass
            self._clock.sleep_s(MOTION_POLL_S)
        self.controller.abandon()
