"""What every controller can do, and the one way of talking that makes late answers harmless.

A controller is a box behind one port with one or more channels (motors). It knows mm and steps of its own
coordinate; offsets, directions, limits and backlash belong to `stages.axis`.

Life of a motion: ``start_move`` or ``start_home`` returns once the controller has taken the command, ``moving``
is asked until it says False or raises what ended the motion, then ``position_mm`` is read.

**Late answers.** Most protocols carry no message number, so the answer to a question that timed out could be
taken for the answer to the next one. After every timeout, unreadable or surplus byte the link is SUSPECT: before
anything else is asked, input is drained, then the controller must identify itself. A wire keeps its order, so
once the identity has come, every older answer has come too. Questions are repeated after that; commands that
move are never repeated here, because only the caller knows what moving twice would do.

**Damaged answers.**  Where the protocol has no checksum, a position counts only when two readings in a row agree.

`stop` may be called from any thread at any time: it bypasses the lock that serialises everything else.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

from stages.clock import SYSTEM_CLOCK, Clock
from stages.errors import DeviceLost, NoReply, ProtocolViolation, StageUsageError, WrongDevice
from stages.port import Port

QUIET_S = 0.12  # silence that ends draining
REPEATS = 3  # times a question is asked
FENCES = 6  # times a controller is asked to identify itself before it is given up

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Channel:
    """One motor of a controller: its name there, and the scale for controllers that count steps."""

    name: str
    steps_per_mm: float | None = None


class Stream(Protocol):
    """A grammar's decoder: bytes in, answers (or violations) out."""

    @property
    def rest(self) -> bytes:
        """Bytes that are no whole answer yet."""
        ...

    def feed(self, chunk: bytes) -> Sequence[object]:
        """Add bytes; return what is complete."""
        ...


class Controller(ABC):
    """Base of all drivers.

    Parameters
    ----------
    name : str
        What the bench file calls it; used in messages.
    channels : mapping of str to Channel
        The motors in use, by their name on the controller.
    clock : Clock
        Clock of every deadline.
    """

    default_baud: ClassVar[int]
    example_channels: ClassVar[tuple[str, str]]  # two valid names, for messages and contract tests
    hold_dtr: ClassVar[bool] = False
    wakes_within_s: ClassVar[float] = 0.0  # deaf after opening for as long as this, because opening resets it
    counts_steps: ClassVar[bool] = False  # the protocol speaks steps, so every channel needs steps_per_mm
    homes_together: ClassVar[bool] = False  # one command homes every channel
    senses_stall: ClassVar[bool] = False  # an encoder notices when the motor does not follow
    reply_timeout_s: float = 0.5

    def __init__(self, name: str, channels: Mapping[str, Channel], clock: Clock = SYSTEM_CLOCK) -> None:
        self.name = name
        self.clock = clock
        self.identity = ""
        self._channels = dict(channels)
        self._referenced: set[str] = set()
        self._port: Port | None = None
        self._lock = threading.RLock()
        self._suspect = False
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
            self._referenced.clear()
            self._port = Port(url, baud or self.default_baud, clock=self.clock, hold_dtr=self.hold_dtr)
            try:
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

    def close(self) -> None:
        """Close the port; safe at any time."""
        if self._port is not None:
            self._port.close()
            self._port = None

    @property
    def lost(self) -> bool:
        """True if the controller cannot be reached until `connect` is called again."""
        return self._port is None or self._port.lost

    @property
    def port(self) -> Port:
        """The open port.

        Raises
        ------
        DeviceLost
            There is none.
        """
        if self._port is None:
            raise DeviceLost(f"{self.name} is not connected; open it and home its axes")
        return self._port

    def referenced(self, channel: str) -> bool:
        """True if the position of a channel means something."""
        return not self.lost and channel in self._referenced

    # ---- motion --------------------------------------------------------------------------------

    @abstractmethod
    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move; return once the controller has taken it."""

    @abstractmethod
    def start_home(self, channel: str) -> None:
        """Begin to look for the reference of a channel."""

    @abstractmethod
    def moving(self, channel: str) -> bool:
        """Ask once whether a channel moves; raise what ended its motion if that was not the target.

        Raises
        ------
        LimitHit, AxisStalled, MotionStopped
            How the motion ended.
        """

    @abstractmethod
    def position_mm(self, channel: str) -> float:
        """Position of a channel at rest, in the controller's own coordinate."""

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

    def abandon(self) -> None:
        """Forget a motion whose end was never heard of; the link is checked before it is used again."""
        with self._lock:
            self._suspect = True
            self._reset_state()

    # ---- for drivers ---------------------------------------------------------------------------

    @abstractmethod
    def _identify(self) -> str:
        """Ask who answers; also the fence after which no older answer can come."""

    @abstractmethod
    def _stop_bytes(self) -> Sequence[bytes]:
        """What stops the motion, sent without waiting."""

    @abstractmethod
    def _stream(self) -> Stream:
        """Decoder for the next answer."""

    @abstractmethod
    def _set_up(self) -> None:
        """Read or write what the controller needs after opening."""

    @abstractmethod
    def _reset_state(self) -> None:
        """Forget what belonged to a motion."""

    def _drained(self, data: bytes) -> None:  # noqa: B027 - most protocols have no alarms
        """Look at what was swallowed before a fence; alarms must not get lost there."""

    def _remembers_reference(self, channel: str) -> bool:
        """Ask whether the controller was referenced before we came."""
        return False

    def _check_channel(self, channel: Channel) -> None:
        if self.counts_steps and not channel.steps_per_mm:
            raise StageUsageError(
                f"{self.name}: channel {channel.name} needs steps_per_mm; this controller counts steps"
            )

    def _scale(self, channel: str) -> float:
        """Steps per mm of a channel of a controller that counts steps."""
        return float(self._channels[channel].steps_per_mm or 0.0)

    def _unsolicited(self, data: bytes) -> None:
        """Judge bytes that came when nothing was asked; nobody may take them for an answer later."""
        self._suspect = True

    def _transact(
        self,
        data: bytes,
        accept: Callable[[object], T | None],
        timeout_s: float | None = None,
        stream: Stream | None = None,
    ) -> T:
        """Send, and wait for the answer that `accept` recognises.

        `accept` returns None for answers to skip and may raise.  Surplus answers make the link suspect.
        """
        with self._lock:
            self._clear_line()
            return self._converse(data, accept, timeout_s, stream)

    def _send(self, data: bytes) -> None:
        """Send what is answered when its motion has ended, or not at all."""
        with self._lock:
            self._clear_line()
            self.port.write(data)

    def _clear_line(self) -> None:
        """See that nothing older can be taken for the next answer."""
        if self._suspect:
            self._resynchronise()
        if early := self.port.pending():
            self._unsolicited(early)
            if self._suspect:
                self._resynchronise()

    def _converse(
        self,
        data: bytes,
        accept: Callable[[object], T | None],
        timeout_s: float | None = None,
        stream: Stream | None = None,
    ) -> T:
        port, stream = self.port, stream or self._stream()
        deadline_s = self.clock.now_s() + (timeout_s or self.reply_timeout_s)
        try:
            port.write(data)
            while True:
                answers = list(stream.feed(port.read(deadline_s)))
                while answers:
                    answer = answers.pop(0)
                    if isinstance(answer, ProtocolViolation):
                        raise answer
                    if (result := accept(answer)) is not None:
                        if answers or stream.rest:
                            self._surplus(answers, stream.rest)
                        return result
        except (NoReply, ProtocolViolation):
            self._suspect = True
            raise

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        """Judge what came in one chunk with, but after, the answer."""
        self._suspect = True

    def _resynchronise(self) -> None:
        """Drain, then make the controller identify itself; afterwards no older answer can be under way."""
        identity = self.identity
        for _ in range(FENCES):
            self._drained(self.port.drain(QUIET_S))
            self._suspect = False
            try:
                identity = self._identify()
                if not self._suspect and identity == (self.identity or identity):
                    return
            except (NoReply, ProtocolViolation):
                identity = self.identity
            self._suspect = (
                True  # late answers to earlier fences, or the rest of a damaged one before the identity
            )
        if identity != self.identity:
            raise WrongDevice(f"{self.name}: {identity!r} answers instead of {self.identity!r}; check the cables")
        raise NoReply(f"{self.name} gives no clear answer; is it switched on, is the cable good?")

    def _repeated(self, ask: Callable[[], T]) -> T:
        """Ask a question again when its answer was late or damaged; never for commands that move."""
        for _ in range(REPEATS - 1):
            try:
                return ask()
            except (NoReply, ProtocolViolation):
                continue
        return ask()

    def _agreed(self, ask: Callable[[], T], same: Callable[[T, T], bool] = lambda a, b: a == b) -> T:
        """Ask until two readings in a row agree: one damaged answer is then never believed."""
        before = self._repeated(ask)
        for _ in range(2 * REPEATS):
            now = self._repeated(ask)
            if same(before, now):
                return now
            before = now
        raise ProtocolViolation(f"{self.name}: readings at rest do not agree; check the cable")
