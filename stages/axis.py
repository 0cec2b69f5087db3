"""One axis in mm: limits, reference, arrival from one side, settling, reading back, trying again.

    axis_mm = sign * controller_mm + offset_mm

An axis moves only when it knows where it is. It does not after power-up (unless the controller remembers),
after a limit switch, a stall or a lost port; then absolute moves are refused until it has been homed on
request. Targets are judged before anything is sent: not finite or outside the limits, approach included, raises
and moves nothing; nothing is ever clipped.

An arrival is what the controller reports at rest after the settling time, compared with the target. Outside the
tolerance, or after an answer that was lost or damaged, the whole way is driven again, `retries` times at most.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

from stages.axis_settings import AxisSettings
from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller import Controller
from stages.errors import (
    AxisStalled,
    DeviceError,
    DeviceLost,
    LimitHit,
    MotionStopped,
    NoReply,
    NotInPosition,
    NotReferenced,
    OutOfRange,
    ProtocolViolation,
)
from stages.profile import Leg, duration_s, legs

POLL_S = 0.03
STOP_AGAIN_S = 0.2
CALM_S = 3.0  # time given to a motion to end after a stop

T = TypeVar("T")


class AxisState(Enum):
    """What may be asked of an axis now."""

    UNREFERENCED = "unreferenced"  # home it
    READY = "ready"
    LOST = "lost"  # reconnect, then home it


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where an axis was sent and where it says it is."""

    axis: str
    target_mm: float
    measured_mm: float
    attempts: int
    duration_s: float

    @property
    def error_um(self) -> float:
        """Measured minus target."""
        return (self.measured_mm - self.target_mm) * 1000.0


class StopSwitch:
    """Counts stop requests; a motion that began before the last one must end."""

    def __init__(self) -> None:
        self._count = 0

    @property
    def count(self) -> int:
        """Number of stop requests so far."""
        return self._count

    def press(self) -> None:
        """Request a stop of everything that has begun."""
        self._count += 1


class Axis:
    """One axis of a controller.

    Parameters
    ----------
    name : str
        As in the bench file.
    controller : Controller
        The connected controller.
    settings : AxisSettings
        Limits, speeds, tolerance.
    clock : Clock
        Clock of every wait.
    switch : StopSwitch
        Shared by all axes of a stage.
    """

    def __init__(
        self,
        name: str,
        controller: Controller,
        settings: AxisSettings,
        clock: Clock = SYSTEM_CLOCK,
        switch: StopSwitch | None = None,
    ) -> None:
        self.name = name
        self.settings = settings
        self.controller = controller
        self._clock = clock
        self._switch = switch or StopSwitch()
        self._lock = threading.RLock()
        self._distrusted = False
        self._rests_at_mm: float | None = None

    @property
    def state(self) -> AxisState:
        """What may be asked of the axis now."""
        if self.controller.lost:
            self._distrusted = True
            return AxisState.LOST
        if self._distrusted or not self.controller.referenced(self.settings.channel):
            return AxisState.UNREFERENCED
        return AxisState.READY

    @property
    def position_mm(self) -> float:
        """Position at rest as the controller reports it.

        Raises
        ------
        NotReferenced
            The axis does not know where it is.
        DeviceLost
            The controller is gone.
        """
        self._require_reference()
        return self._guarded(self._read_mm)

    def check(self, target_mm: float) -> None:
        """Raise if a target must not be asked for; sends nothing.

        Raises
        ------
        OutOfRange
            Not a finite number, or outside the limits, the way from the approach side included.
        """
        low, high = self.settings.limits_mm
        if not math.isfinite(target_mm):
            raise OutOfRange(f"{self.name}: {target_mm} is no position")
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

    def move_to(self, target_mm: float) -> Arrival:
        """Move to a position, arriving from the approach side, and wait until the axis rests there.

        Raises
        ------
        OutOfRange, NotReferenced
            Nothing has moved.
        MotionStopped, LimitHit, AxisStalled, NotInPosition, DeviceLost, NoReply
            What came between.
        """
        self.check(target_mm)
        self._require_reference()
        begun_s, token, way_back = self._clock.now_s(), self._switch.count, None
        with self._lock:
            for attempt in range(1, self.settings.retries + 2):
                try:
                    measured_mm = self._guarded(lambda: self._drive(target_mm, token))
                except (NoReply, ProtocolViolation) as failure:
                    way_back = failure
                    self._guarded(self._calm)
                    continue
                if abs(measured_mm - target_mm) * 1000.0 <= self.settings.in_position_um:
                    self._rests_at_mm = target_mm
                    return Arrival(self.name, target_mm, measured_mm, attempt, self._clock.now_s() - begun_s)
                self._rests_at_mm, way_back = None, None
            if way_back is not None:
                raise way_back
            raise NotInPosition(
                f"{self.name} rests at {measured_mm:.4f} mm, {abs(measured_mm - target_mm) * 1000:.1f} um from "
                f"its target, after {self.settings.retries + 1} attempts"
            )

    def move_by(self, distance_mm: float) -> Arrival:
        """Move by a distance from where the axis is; same rules as `move_to`."""
        return self.move_to(self.position_mm + distance_mm)

    def stop(self) -> None:
        """Stop the axis (and whatever shares its controller) now; harmless at rest; from any thread."""
        self._switch.press()
        self.controller.stop()

    def home(self) -> None:
        """Look for the reference; moves the axis without knowing where it is, so only on request.

        Raises
        ------
        MotionStopped, LimitHit, AxisStalled, DeviceLost, NoReply
            The reference was not found.
        """
        token = self._switch.count
        with self._lock:
            self._distrusted, self._rests_at_mm = True, None
            try:
                self._guarded(lambda: self._find_reference(token))
            except (NoReply, ProtocolViolation):
                self._guarded(self._calm)
                raise
            if not self.controller.referenced(self.settings.channel):
                raise DeviceError(f"{self.name} has ended its reference run without a reference; home it again")
            self._distrusted = False

    def trust_reference(self) -> None:
        """Accept a reference that a motion of another axis of the same controller has found."""
        self._distrusted, self._rests_at_mm = False, None

    def _require_reference(self) -> None:
        state = self.state
        if state is AxisState.LOST:
            raise DeviceLost(f"{self.name}: its controller is gone; plug it in, open it again and home the axis")
        if state is AxisState.UNREFERENCED:
            raise NotReferenced(f"{self.name} does not know where it is; home it first")

    def _guarded(self, action: Callable[[], T]) -> T:
        """Run, and forget the position if what happens makes it doubtful."""
        try:
            return action()
        except (DeviceLost, LimitHit, AxisStalled):
            self._distrusted, self._rests_at_mm = True, None
            raise
        except (MotionStopped, NoReply, ProtocolViolation):
            self._rests_at_mm = None
            raise

    def _read_mm(self) -> float:
        return self.settings.sign * self.controller.position_mm(self.settings.channel) + self.settings.offset_mm

    def _drive(self, target_mm: float, token: int) -> float:
        here_mm = self._read_mm()
        if self._rests_at_mm != target_mm:
            self._rests_at_mm = None
            for leg in self.legs(here_mm, target_mm):
                self._drive_leg(leg, token)
            self._clock.sleep_s(self.settings.settle_s)
        measured_mm = self._read_mm()
        self._require_reference()  # a controller that restarted on the way has forgotten it
        return measured_mm

    def _drive_leg(self, leg: Leg, token: int) -> None:
        end_mm = (leg.end_mm - self.settings.offset_mm) * self.settings.sign
        if self._switch.count == token:
            self.controller.start_move(
                self.settings.channel, end_mm, leg.speed_mm_s, self.settings.acceleration_mm_s2
            )
        self._wait(2.0 + 1.5 * self._leg_s(leg), token)

    def _find_reference(self, token: int) -> None:
        self.controller.start_home(self.settings.channel)
        self._wait(self.settings.home_timeout_s, token)

    def _leg_s(self, leg: Leg) -> float:
        return duration_s(leg.end_mm - leg.start_mm, leg.speed_mm_s, self.settings.acceleration_mm_s2)

    def _wait(self, limit_s: float, token: int) -> None:
        """Wait for the end of a motion; a pressed stop switch is repeated until the motion has ended."""
        end_s, stop_s = self._clock.now_s() + limit_s, -math.inf
        while True:
            pressed = self._switch.count != token
            if pressed and self._clock.now_s() >= stop_s:
                self.controller.stop()
                stop_s = self._clock.now_s() + STOP_AGAIN_S
            if not self.controller.moving(self.settings.channel):
                break
            if self._clock.now_s() >= end_s:
                raise NoReply(f"{self.name} has not ended its motion within {limit_s:.1f} s; stopped")
            self._clock.sleep_s(POLL_S)
        if pressed:
            raise MotionStopped(f"{self.name} was stopped")

    def _calm(self) -> None:
        """Bring a motion of unknown state to rest, and the link into a known one."""
        self.controller.stop()
        end_s = self._clock.now_s() + CALM_S
        while self._clock.now_s() < end_s:
            try:
                if not self.controller.moving(self.settings.channel):
                    break
            except MotionStopped:
                break
            except (NoReply, ProtocolViolation):
                pass
            self._clock.sleep_s(POLL_S)
        self.controller.abandon()
