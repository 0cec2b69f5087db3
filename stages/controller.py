"""What every controller can do; how it is talked to is said in `stages.link`.

A controller is a box behind one port with one or more channels (motors). It knows mm and steps of its own
coordinate; offsets, directions, limits and backlash belong to `stages.axis`.

Life of a motion: ``start_move`` or ``start_home`` returns once the controller has taken the command, ``moving``
is asked until it says False or raises what ended the motion, then ``known_mm`` is read.

A position means something only as long as the controller has not restarted since it was referenced. So every
position that is believed is read FIRST and vouched for AFTERWARDS: a box that still knows its reference now knew
it when the position was read. What a box is asked for that (a flag, an error, a mark that a restart wipes out) is
each driver's `_still_referenced`.

Bytes that move go through the gate of the bench's stop latch (`moves=True`); `stop` may be called from any thread
at any time: it bypasses the lock that serialises everything else.
"""

import operator
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import NoReply, NotReferenced, ProtocolViolation, StageUsageError, WrongDevice
from stages.link import QUIET_S, Link
from stages.port import Port
from stages.stop_latch import StopLatch
from stages.watchdog import Watchdog

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Channel:
    """One motor of a controller: its name there, and the scale for controllers that count steps."""

    name: str
    steps_per_mm: float | None = None


class Controller(Link):
    """Base of all drivers.

    Parameters
    ----------
    name : str
        What the bench file calls it; used in messages.
    channels : mapping of str to Channel
        The motors in use, by their name on the controller.
    clock : Clock
        Clock of every deadline.
    latch : StopLatch, optional
        The bench's stop; one of its own by default.
    """

    default_baud: ClassVar[int]
    example_channels: ClassVar[tuple[str, str]]  # two valid names, for messages and contract tests
    hold_dtr: ClassVar[bool] = False
    wakes_within_s: ClassVar[float] = 0.0  # deaf after opening for as long as this, because opening resets it
    counts_steps: ClassVar[bool] = False  # the protocol speaks steps, so every channel needs steps_per_mm
    homes_together: ClassVar[bool] = False  # one command homes every channel
    senses_stall: ClassVar[bool] = False  # an encoder notices when the motor does not follow

    def __init__(
        self,
        name: str,
        channels: Mapping[str, Channel],
        clock: Clock = SYSTEM_CLOCK,
        latch: StopLatch | None = None,
    ) -> None:
        super().__init__(name, clock)
        self.latch = latch or StopLatch()
        self.token = self.latch.count  # of the motion that may send bytes now; set by `stages.axis`
        self.watchdog: Watchdog | None = None  # set by `stages.stage` where the port outlives the process
        self.under_way = False  # bytes that can move were sent, and no end of the motion was heard of since
        self._channels = dict(channels)
        self._referenced: set[str] = set()
        self._at_rest: dict[str, Any] = {}  # readings that two answers agreed on since the last motion
        self._stopped = False
        for channel in self._channels.values():
            self._check_channel(channel)
        self._reset_state()

    # ---- life ----------------------------------------------------------------------------------

    def connect(self, url: str, baud: int | None = None) -> str:
        """Open the port and find out who answers; nothing moves.

        Parameters
        ----------
        url : str
            What `Port` opens.
        baud : int, optional
            Other than the protocol's usual rate.

        Returns
        -------
        str
            Identity of the controller.

        Raises
        ------
        PortUnavailable, NoReply
            The port cannot be opened, or nobody answers on it.
        WrongDevice
            Another device answers than the first time, or its set-up does not fit the bench file.
        """
        with self._lock:
            self.close()
            self._forget_references()
            self._port = Port(url, baud or self.default_baud, clock=self.clock, hold_dtr=self.hold_dtr)
            try:
                if self.under_way:  # what was moving when the port was lost may move still
                    self.stop()
                self._get_to_know()
            except BaseException:
                self.close()
                raise
            return self.identity

    def _get_to_know(self) -> None:
        first_time = not self.identity
        self._suspect = self._stopped = False
        self._reset_state()
        self.port.drain(QUIET_S)
        identity = self._agreed(self._woken)
        if not first_time and identity != self.identity:
            raise WrongDevice(f"{self.name}: {identity!r} answers instead of {self.identity!r}; check the cables")
        self.identity = identity
        self._set_up()
        if first_time:  # after a loss nobody vouches for the position, whatever the controller says
            self._referenced |= {name for name in self._channels if self._remembers_reference(name)}

    def _woken(self) -> str:
        """Ask who answers until somebody does, or the time is over in which the controller may still wake up."""
        end_s = self.clock.now_s() + self.wakes_within_s
        while True:
            try:
                return self._identify()
            except (NoReply, ProtocolViolation):
                if self.clock.now_s() >= end_s:
                    raise

    def referenced(self, channel: str) -> bool:
        """True if the position of a channel meant something when the controller was last asked; asks nothing."""
        return not self.lost and channel in self._referenced

    def vouch(self, channel: str) -> None:
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

    def known_mm(self, channel: str) -> float:
        """Position of a channel at rest that the controller vouches for now, in its own coordinate.

        Raises
        ------
        NotReferenced
            It does not vouch for it.
        """
        with self._lock:
            position_mm = self.position_mm(channel)
            self.vouch(channel)
            return position_mm

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
            The channel moves; wait until it rests.
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

    def stop(self) -> None:
        """Stop every channel now; harmless when nothing moves; does not wait for other threads."""
        self._stopped = True
        port = self._port
        if port is not None and not port.lost:
            for data in self._stop_bytes():
                port.write(data)
        self._stopped = True  # again: another thread may have consumed the first while the bytes were on their way

    def _look_up(self) -> None:
        """Say stop again if one has come since the motion began: it may have overtaken a command still unread."""
        if self.under_way and self.latch.count != self.token:
            self.stop()

    def watchdog_bytes(self) -> Sequence[bytes]:
        """What stops any motion whatever it is, for a watchdog that knows nothing of what was begun."""
        return self._stop_bytes()

    def rests(self) -> None:
        """Note that the motion under way is known to have ended."""
        self.under_way = False
        if self.watchdog is not None:
            self.watchdog.rests(self.name)

    def abandon(self) -> None:
        """Forget a motion whose end was never heard of; the link is checked before it is used again."""
        with self._lock:
            self._suspect = True
            self._at_rest.clear()
            self._reset_state()

    def judge_unheard(self, channel: str) -> None:
        """Look how a motion of `channel` has ended whose end was not heard of, before it is tried again.

        Nothing to do for boxes that can be asked why they rest.

        Raises
        ------
        MotionStopped
            A person may have stopped it.
        """

    # ---- for drivers ---------------------------------------------------------------------------

    @abstractmethod
    def _stop_bytes(self) -> Sequence[bytes]:
        """What stops the motion, sent without waiting."""

    @abstractmethod
    def _set_up(self) -> None:
        """Read or write what the controller needs after opening."""

    @abstractmethod
    def _reset_state(self) -> None:
        """Forget what belonged to a motion."""

    def _remembers_reference(self, channel: str) -> bool:
        """Ask whether the controller was referenced before we came."""
        return False

    @abstractmethod
    def _still_referenced(self, channel: str) -> bool:
        """Ask whether the controller has kept the reference that it had: no restart since, no flag against it."""

    def _forget_references(self) -> None:
        """Believe nothing of this controller any more; all of its channels restart together."""
        self._referenced.clear()
        self._at_rest.clear()

    def _settled(self, key: str, ask: Callable[[], T], same: Callable[[T, T], bool] = operator.eq) -> T:
        """Return a reading at rest that two answers agree on: of one damaged answer nothing is ever believed.

        The first of the two may be an earlier one, as long as nothing was sent that moves and the link was never
        in doubt since: a controller that rests says the same again.
        """
        if key in self._at_rest:
            now = self._repeated(ask)
            if key in self._at_rest and same(self._at_rest[key], now):
                return now
        found = self._agreed(ask, same)
        self._at_rest[key] = found
        return found

    @contextmanager
    def _gate(self, moves: bool) -> Iterator[None]:
        """Bytes that move are written only while no stop has come since their motion began."""
        if not moves:
            yield
            return
        self._at_rest.clear()
        with self.latch.gate(self.token):
            self.under_way = True
            if self.watchdog is not None:
                self.watchdog.moves(self.name)
            yield

    def _check_channel(self, channel: Channel) -> None:
        if self.counts_steps and not channel.steps_per_mm:
            raise StageUsageError(
                f"{self.name}: channel {channel.name} needs steps_per_mm; this controller counts steps"
            )

    def _scale(self, channel: str) -> float:
        """Steps per mm of a channel of a controller that counts steps."""
        return float(self._channels[channel].steps_per_mm or 0.0)
