"""Interface of motion controllers: the calls of axes, and the state kept between them.

A controller is a box with one or more channels (motors). It knows mm of its own coordinate; offsets, directions,
limits and backlash belong to `stages.axis`. Two ways lead to one: bytes on a port (`stages.controller`), and a
third-party library (`stages.foreign`).

Life of a motion: ``start_move`` or ``start_home`` returns once the controller has taken the command, ``moving``
is asked until it says False or raises what ended the motion, then ``rest_position_mm`` is read.

A position means something only as long as the controller has not restarted since it was referenced. So every
position that is believed is read FIRST and vouched for AFTERWARDS: a box that still knows its reference now knew
it when the position was read. What vouches is each controller's `_still_referenced`.

Whatever moves passes the gate of the bench's stop latch; ``stop`` may be called from any thread at any time and
does not wait.
"""

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from stages.axis_settings import LONGEST_TOLERANCE_UM
from stages.clock import SYSTEM_CLOCK, Clock
from stages.controller_tables import AnyControllerTable
from stages.errors import NotReferenced, StageUsageError
from stages.scale_question import Person
from stages.stop_latch import StopLatch
from stages.watchdog import Watchdog


@dataclass(frozen=True, slots=True)
class Channel:
    """One motor of a controller.

    Parameters
    ----------
    name : str
        Its name there.
    steps_per_mm : float, optional
        The scale of controllers that count steps.
    axis : str
        What the bench file calls the axis; for a person, who knows no channels.
    limits_mm : (float, float)
        Those of the axis, in the controller's own coordinate; for what a person says.
    tolerance_mm : float
        How far from its target the axis may rest; the same.
    """

    name: str
    steps_per_mm: float | None = None
    axis: str = ""
    limits_mm: tuple[float, float] = (-math.inf, math.inf)
    tolerance_mm: float = math.inf


NOISE_COUNTS = 40  # a servo at rest may flicker by 20 counts to each side


class MotionController(ABC):
    """Base of everything that moves an axis.

    Parameters
    ----------
    name : str
        What the bench file calls it; used in messages.
    channels : mapping of str to Channel
        The motors in use, by their name on the controller.
    clock : Clock
        Clock of every wait.
    latch : StopLatch, optional
        The bench's stop; one of its own by default.
    """

    senses_stall: ClassVar[bool] = False  # an encoder notices when the motor does not follow

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        self.name = name
        self.clock = clock
        self.identity = ""  # who answers, as it says itself
        self.latch = latch or StopLatch()
        self.token = self.latch.count  # of the motion that may begin now; set by `stages.axis`
        self.under_way = False  # something that can move was begun, and no end of it was heard of since
        self._channels = dict(channels)
        self._referenced: set[str] = set()
        self._lock = threading.RLock()  # of a conversation; `stop` waits for none

    # ---- life ----------------------------------------------------------------------------------

    @abstractmethod
    def open(self, table: AnyControllerTable) -> str:
        """Open (again) what the bench file describes, and return who answers; nothing moves.

        Raises
        ------
        PortUnavailable, NoReply, DeviceLost
            It cannot be opened, or there is no answer.
        WrongDevice
            Another device answers than the first time, or its set-up does not fit the bench file.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it; safe at any time."""

    @property
    @abstractmethod
    def is_lost(self) -> bool:
        """True if the box cannot be reached until `open` is called again."""

    def register_watchdog(  # noqa: B027 - most libraries give no second way to the box
        self, table: AnyControllerTable, start: Callable[[], Watchdog]
    ) -> None:
        """Tell the watchdog of this process how the box is stopped, if it can reach the box by itself.

        Parameters
        ----------
        table : Table
            What was opened.
        start : callable
            Returns the watchdog, which begins its life then.
        """

    def set_operator(self, person: Person) -> None:  # noqa: B027 - most boxes have motors
        """Say who turns the screws of channels without a motor, and reads their scales."""

    def has_reference(self, channel: str) -> bool:
        """True if the position of a channel meant something when the controller was last asked; asks nothing."""
        return not self.is_lost and channel in self._referenced

    def confirm_reference(self, channel: str) -> None:
        """Ask whether the reference of a channel still holds now.

        Raises
        ------
        NotReferenced
            It does not: the controller has restarted, or lost it otherwise.
        """
        with self._lock:
            if channel in self._referenced and not self._still_referenced(channel):
                self._forget_references()
            if channel not in self._referenced:
                raise NotReferenced(f"{self.name} channel {channel} has lost its reference (a restart?); home it")

    def rest_position_mm(self, channel: str) -> float:
        """Position of a channel at rest that the controller vouches for now, in its own coordinate.

        Raises
        ------
        NotReferenced
            It does not confirm it.
        """
        with self._lock:
            position_mm = self.position_mm(channel)
            self.confirm_reference(channel)
            return position_mm

    def noise_mm(self, channel: str) -> float:
        """Largest difference between two readings of a channel at rest.

        Of a controller that does not tell its counts, as far as two readings of an axis in its tolerance may.
        """
        known = self._channels[channel]
        tolerance_mm = 2.0 * min(known.tolerance_mm, LONGEST_TOLERANCE_UM * 1e-3)
        return min(tolerance_mm, NOISE_COUNTS / known.steps_per_mm) if known.steps_per_mm else tolerance_mm

    @abstractmethod
    def _still_referenced(self, channel: str) -> bool:
        """Ask whether the controller has kept the reference that it had: no restart since, no flag against it."""

    def _forget_references(self) -> None:
        """Believe nothing of this controller any more; all of its channels restart together."""
        self._referenced.clear()

    # ---- motion --------------------------------------------------------------------------------

    @abstractmethod
    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move; return once the controller has taken it.

        Raises
        ------
        MotionStopped
            A halt or a stop came since the motion was begun, or the controller is held.
        NotReferenced, LimitHit, AxisStalled
            The controller has restarted, or an older fault stands; home the channel.
        OutOfRange, CommandRejected
            The controller cannot count that far, or refuses the move.
        StageUsageError
            Another of its motions has not ended.
        DeviceLost, NoReply, ProtocolViolation
            The port is gone, or no answer came that makes sense.
        """

    @abstractmethod
    def start_home(self, channel: str) -> None:
        """Begin to look for the reference of a channel.

        Raises
        ------
        MotionStopped
            A halt or a stop came since the motion was begun.
        StageUsageError
            Homing is switched off on the controller, or another of its motions has not ended.
        CommandRejected, DeviceError
            The controller refuses, or cannot be brought out of a fault.
        DeviceLost, NoReply, ProtocolViolation
            The port is gone, or no answer came that makes sense.
        """

    @abstractmethod
    def moving(self, channel: str) -> bool:
        """Ask once whether a channel moves; raise what ended its motion if that was not the target.

        Raises
        ------
        LimitHit, AxisStalled, MotionStopped
            How the motion ended.
        NotReferenced
            The controller has restarted meanwhile; home it.
        CommandRejected, DeviceError
            The controller ended the motion for another reason, which the message names.
        DeviceLost, NoReply, ProtocolViolation
            The port is gone, or no answer came that makes sense.
        """

    @abstractmethod
    def position_mm(self, channel: str) -> float:
        """Position of a channel at rest, in the controller's own coordinate.

        Raises
        ------
        StageUsageError
            The channel is moving; wait until it stops.
        NotReferenced, DeviceError
            The controller has restarted, or an alarm came; home it.
        DeviceLost, NoReply, ProtocolViolation
            The port is gone, no answer came, or the readings do not agree.
        """

    @abstractmethod
    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Raise if the controller cannot do this speed or acceleration.

        Raises
        ------
        StageUsageError
            It cannot; the message says what it can.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop every channel now; harmless when nothing moves; does not wait for other threads."""

    def channels_homed_with(self, channel: str) -> frozenset[str]:
        """Channels that a reference run of this one homes, itself included."""
        return frozenset({channel})

    def needs_hand_homing(self, channel: str) -> bool:
        """Return whether a person says where the channel stands, because the box cannot look for it."""
        return False

    def confirm(self, channel: str, position_mm: float) -> None:
        """Take a person's word for where a channel stands, in its own coordinate; nothing moves.

        Raises
        ------
        StageUsageError
            This box looks for its reference itself.
        """
        raise StageUsageError(f"{self.name} looks for its reference itself; home channel {channel}")

    def rests(self) -> None:
        """Note that the motion under way is known to have ended."""
        self.under_way = False

    @abstractmethod
    def abandon(self) -> None:
        """Forget a motion whose end was never heard of."""

    def resolve_missing_reply(self, channel: str) -> None:  # noqa: B027
        """Look how a motion of `channel` has ended whose end was not heard of, before it is tried again.

        Nothing to do for boxes that can be asked why they rest.

        Raises
        ------
        MotionStopped
            A person may have stopped it.
        """
