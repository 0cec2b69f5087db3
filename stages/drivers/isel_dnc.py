"""Driver for isel iMC-S8 and C142 in DNC mode.

Channels are X, Y, Z. The controller is mute from the moment it takes a motion until the motion has ended, so
`moving` only looks whether the one character has come; one motion at a time. Moves are sent as relative motions
of the axis that is meant, with zero for the others: a wrong idea about another axis can then never move it.
Positions are read twice.

A controller that was switched off and on answers 4 (no axes defined) to everything but the version until it is
initialised. It is initialised on connecting and before a reference run, never before a move: so an answer to the
question for the position also says that there was no restart since.

A C142 does not know the version command and answers 5; it gets no acceleration, and its 5 serves as identity. A
limit switch (2) or a fault (9) forgets every reference. A stop at the box is reported by the one character (F)
alone: if that is lost, an axis that rests short of its target counts as stopped by a person. The controller has no
encoder: a stalled motor is not noticed.
"""

from collections.abc import Sequence

from stages.controller import Channel, Controller
from stages.errors import (
    CommandRejected,
    DeviceError,
    LimitHit,
    MotionStopped,
    NoReply,
    NotReferenced,
    OutOfRange,
    ProtocolViolation,
    StageUsageError,
)
from stages.link import QUIET_S
from stages.protocols import isel_dnc as dnc

AXES = ("X", "Y", "Z")
C142 = "C142"
IDLE = 30  # steps/s of an axis that does not move, as in the examples of the guide
FASTEST_RAMP = 4000  # Hz/ms
NOT_INITIALISED = "4"


class IselController(Controller):
    """One iMC-S8 or C142."""

    default_baud = 19_200
    other_bauds = (9600,)  # a C142
    example_channels = ("X", "Y")
    decoder = dnc.AckStream
    counts_steps = True

    _initialised: bool = False
    _motion_pending: bool
    _homing: str | None
    _ramp: int | None
    _sent_to: tuple[int, int] | None = None  # index and steps of a move whose end was not heard of yet

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move, sent as the difference to where the axis is.

        OutOfRange if the target has more than 24 bit of steps, NotReferenced if the controller has restarted.
        """
        scale, index = self._scale(channel), AXES.index(channel)
        steps = round(target_mm * scale)
        if abs(steps) >= dnc.STEPS_LIMIT:
            raise OutOfRange(f"{self.name} channel {channel}: {target_mm} mm is beyond the controller's 24 bit")
        with self._lock:
            self._refuse_while_moving()
            if not self._initialised:
                raise NotReferenced(f"{self.name} has lost its reference (was it switched off?); home it")
            self._set_ramp(scale, acceleration_mm_s2)
            distance = steps - self._steps()[index]
            self._stopped, self._sent_to = False, None
            if distance:
                self._sent_to = index, steps
                self._begin(self._motion(index, distance, round(speed_mm_s * scale)))

    def start_home(self, channel: str) -> None:
        """Begin the reference run of one axis."""
        with self._lock:
            self._refuse_while_moving()
            if not self._initialised or self._has_restarted():
                self._initialise()
            self._referenced.discard(channel)
            self._stopped = False
            self._homing, self._sent_to = channel, None
            self._begin(dnc.Numbered("R", 1 << AXES.index(channel)))

    def moving(self, channel: str) -> bool:
        """Look whether the one character has come; never waits."""
        with self._lock:
            if not self._motion_pending:
                return False
            data = self.port.pending()
            if not data:
                return True
            homed, self._motion_pending, self._homing = self._homing, False, None
            if len(data) > 1:
                self._suspect = True
            try:
                code = dnc.parse_ack(data[:1]).code
            except ProtocolViolation:
                self._suspect = True
                raise
            self._sent_to = None
            if code == "0":
                self._referenced |= {homed} if homed else set()
                return False
            self._raise(code, f"moving {channel}")
            return False

    def position_mm(self, channel: str) -> float:
        """Steps / scale, read twice."""
        with self._lock:
            self._refuse_while_moving()
            return self._steps()[AXES.index(channel)] / self._scale(channel)

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """StageUsageError if the speed is outside 1..30000 steps/s or the ramp above 4000 Hz/ms."""
        scale = self._scale(channel)
        if not dnc.SLOWEST <= round(speed_mm_s * scale) <= dnc.FASTEST:
            low, high = dnc.SLOWEST / scale, dnc.FASTEST / scale
            raise StageUsageError(f"{self.name} channel {channel}: speed must be {low:.3g} to {high:.3g} mm/s")
        if acceleration_mm_s2 * scale / 1000 > FASTEST_RAMP:
            raise StageUsageError(f"{self.name} channel {channel}: acceleration is more than 4000 steps/s per ms")

    def _check_channel(self, channel: Channel) -> None:
        super()._check_channel(channel)
        if channel.name not in AXES:
            raise StageUsageError(f"{self.name}: channel {channel.name!r} should be X, Y or Z")

    def _reset_state(self) -> None:
        self._motion_pending = False
        self._homing = None
        self._ramp = None

    @property
    def _axes(self) -> int:
        return max(AXES.index(name) for name in self._channels) + 1

    def _identify(self) -> str:
        """Version, collected until silence because nothing ends it; older answers can only stand before it."""
        port = self.port
        port.write(dnc.Identify().to_bytes())
        raw = port.read(self.clock.now_s() + self.reply_timeout_s)
        while True:
            try:
                raw += port.read(self.clock.now_s() + QUIET_S)
            except NoReply:
                break
        if raw == b"5":
            return C142
        if self.identity and raw.rstrip(b"\r\n").endswith(self.identity.encode()):
            return self.identity
        return dnc.parse_identity(raw).text

    def _set_up(self) -> None:
        self._initialise()

    def _initialise(self) -> None:
        self._ask_again(lambda: self._acknowledge(dnc.Initialise((1 << self._axes) - 1)))
        self._initialised = True

    def rest_position_mm(self, channel: str) -> float:
        """Steps / scale; the answer itself says that there was no restart.

        NotReferenced if there was one, or the axis was never homed.
        """
        position_mm = self.position_mm(channel)
        if not self.has_reference(channel):
            raise NotReferenced(f"{self.name} channel {channel} is not referenced; home it")
        return position_mm

    def resolve_missing_reply(self, channel: str) -> None:
        """Only the one character tells of a stop at the box: where it was lost, short of the target is one."""
        if self._sent_to is None:
            return
        (index, steps), self._sent_to = self._sent_to, None
        if not self._near(channel, self._scale(channel))(self._steps()[index], steps):
            raise MotionStopped(f"{self.name} channel {channel} stopped short of its target for no known reason")

    def _still_referenced(self, channel: str) -> bool:
        self._refuse_while_moving()
        return not self._has_restarted()

    def _has_restarted(self) -> bool:
        if self._ask_again(self._steps_once) is not None:
            return False
        return self._ask_until_equal(self._steps_once) is None  # one damaged answer is no restart

    def _forget_references(self) -> None:
        super()._forget_references()
        self._initialised = False
        self._ramp = None

    def _stop_bytes(self) -> Sequence[bytes]:
        return [dnc.Stop().to_bytes()] if self._motion_pending else []

    def watchdog_bytes(self) -> Sequence[bytes]:
        """The stop of a motion; whether there is one is not known any more."""
        return [dnc.Stop().to_bytes()]

    def _refuse_while_moving(self) -> None:
        if self._motion_pending:
            raise StageUsageError(f"{self.name} does not answer while it moves; wait until the motion has ended")

    def _begin(self, command: dnc.Numbered | dnc.Move) -> None:
        """Send a command whose answer comes when the motion has ended."""
        self._clear_line()
        with self._gate(moves=True):
            # before the bytes: a stop from another thread must not take it for idle
            self._motion_pending = True
            self.port.write(command.to_bytes())

    def _motion(self, index: int, distance: int, speed: int) -> dnc.Move:
        pairs = [(0, IDLE)] * (4 if self._axes == 3 else self._axes)
        pairs[index] = (distance, speed)
        return dnc.Move(tuple(pairs), absolute=False)

    def _set_ramp(self, scale: float, acceleration_mm_s2: float) -> None:
        ramp = max(1, round(acceleration_mm_s2 * scale / 1000))
        if self.identity != C142 and ramp != self._ramp:
            self._ask_again(lambda: self._acknowledge(dnc.Numbered("J", ramp)))
            self._ramp = ramp

    def _acknowledge(self, command: dnc.Initialise | dnc.Numbered) -> None:
        def accept(answer: object) -> str | None:
            return answer.code if isinstance(answer, dnc.Ack) else None

        code = self._transact(command.to_bytes(), accept)
        if code != "0":
            self._raise(code, f"taking {command.to_bytes()!r}")

    def _steps(self) -> tuple[int, ...]:
        steps = self._settle_reading("P", self._steps_once, self._agree)
        if steps is None:
            self._forget_references()
            raise NotReferenced(f"{self.name} has lost its reference (was it switched off?); home it")
        return steps

    def _agree(self, first: tuple[int, ...] | None, second: tuple[int, ...] | None) -> bool:
        """Return whether two readings are of one place, whatever else is wrong; two refusals agree as well."""
        if first is None or second is None:
            return first is second
        return all(
            self._near(name, self._scale(name))(a, b) if name in self._channels else a == b
            for name, a, b in zip(AXES, first, second, strict=False)
        )

    def _steps_once(self) -> tuple[int, ...] | None:
        """Steps of every axis; None if the controller says that it is not initialised, so has restarted."""
        stream = dnc.PositionStream(self._axes)

        def accept(answer: object) -> dnc.Position | dnc.Ack | None:
            if isinstance(answer, dnc.Ack) and answer.code != NOT_INITIALISED:
                # a lone character is not a position; it may belong to an older command
                raise ProtocolViolation(f"{self.name}: no position", answer.to_bytes())
            return answer if isinstance(answer, dnc.Position | dnc.Ack) else None

        answer = self._transact(dnc.AskPosition().to_bytes(), accept, stream=stream)
        return answer.steps if isinstance(answer, dnc.Position) else None

    def _raise(self, code: str, doing: str) -> None:
        """Turn an error character into what it means for the axes."""
        cure = "; change speed_mm_s: the guide has 30 to 10000 steps/s" if code == "D" else ""
        meaning = f"{self.name}, {doing}: {dnc.MEANING[code]} ({code}){cure}"
        if code in "29" + NOT_INITIALISED:
            self._forget_references()
        if code == "2":
            raise LimitHit(f"{meaning}; home its axes")
        if code == "9":
            raise DeviceError(f"{meaning}; look at the machine, then home its axes")
        if code == "F":
            self._suspect = True  # a late 0 or F of the interrupted motion may follow
            raise MotionStopped(meaning)
        if code == NOT_INITIALISED:
            raise NotReferenced(f"{meaning}: it was switched off and on; home its axes")
        if code == "R":
            self._referenced.clear()
        raise CommandRejected(meaning, code)
