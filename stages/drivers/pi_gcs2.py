"""Driver for PI controllers with the General Command Set 2.0.

A channel is the controller's name of the axis ("1", "A"); in a chain of several controllers on one port its
address stands before it ("2/1"). Lengths are mm, so there is no steps_per_mm here.

**Reference.** A stage with a reference switch is referenced at it (FRF), one that has limit switches only at the
negative one (FNL): ``TRS?`` and ``LIM?`` tell, as pipython's startup asks. Where the positive one is meant, a
subclass says ``at_limit = "FPL"`` (docs/add-a-stage.md).

Failures show only in ``ERR?``, which is sent behind every command in the same write. A stop (#24) leaves error
10 behind, which would look like a failure of the next command; it is read away before that. While a reference
move runs, only the one-byte commands are answered. Error -1024 means that the motor did not follow and the
servo has switched itself off. ``ONT?`` is not used: its window is the controller's, ours is in the bench file.
**Command sets.** ``CSV?`` tells which one a controller has; one beyond 2.0 (pipython calls it GCS 3) is another
language: STP for #24, STV? for #5 and #7, EAX for SVO. It is refused before anything else is asked of it.

After a restart ``FRF?`` says 0 (an axis with an absolute encoder keeps its reference), the servo is off and the
velocity is the parameter's: `_forget_references` forgets all of it.
"""

import re
from collections.abc import Mapping, Sequence

from stages.controller import Channel, Controller
from stages.errors import (
    AxisStalled,
    CommandRejected,
    LimitHit,
    MotionStopped,
    NoReply,
    ProtocolViolation,
    StageUsageError,
    WrongDevice,
)
from stages.protocols import pi_gcs2 as gcs

ON_LIMIT_SWITCH = (49, 216)
_MAKER = re.compile(r"(?i)physik|\bPI\b")  # a Grbl board answers the ? in *IDN? with commas as well
COMMAND_SET = 2.0  # the newest that is spoken here


class PiController(Controller):
    """One PI controller."""

    default_baud = 115_200  # by USB
    other_bauds = (38_400, 19_200, 9600)  # set by switches at the front; 38400 is usual
    example_channels = ("1", "2")
    decoder = gcs.AnswerStream
    senses_stall = True
    at_limit = "FNL"  # what finds the reference of a stage without a reference switch

    _axes: Mapping[int | None, tuple[str, ...]] = {}  # by address; replaced as a whole
    _profile: dict[str, tuple[str, str]]
    _homing: set[str]

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move."""
        profile = (f"{speed_mm_s:.6f}", f"{acceleration_mm_s2:.6f}")
        if self._profile.get(channel) != profile:
            self._profile.pop(channel, None)
            self._ask_again(lambda: self._command("SVO", channel, "1"))
            self._ask_again(lambda: self._command("VEL", channel, profile[0]))
            for name in ("ACC", "DEC"):
                self._if_known(name, channel, profile[1])
            self._profile[channel] = profile
        self._command("MOV", channel, f"{target_mm:.6f}", moves=True)

    def start_home(self, channel: str) -> None:
        """Begin the reference move."""
        self._referenced.discard(channel)
        self._profile.pop(channel, None)
        how = self._how_referenced(channel)
        self._ask_again(lambda: self._command("SVO", channel, "1"))
        self._homing.add(channel)
        # without ERR? behind it, which not every firmware answers meanwhile
        self._send(_command_for(how, channel).to_bytes(), moves=True)

    def _how_referenced(self, channel: str) -> str:
        """FRF, or at a limit switch where there is no reference switch; StageUsageError where there is neither."""
        for question, answer in (("TRS?", "FRF"), ("LIM?", self.at_limit)):
            try:
                if self._ask_again(lambda question=question: self._value(question, channel)) == 1:  # type: ignore[misc]
                    return answer
            except NoReply:
                if self._error_of(channel) != gcs.UNKNOWN_COMMAND:
                    raise
                return "FRF"  # a controller that does not know the question
        raise StageUsageError(
            f"{self.name} axis {channel} has neither reference nor limit switches (TRS?, LIM?); its position has "
            "to be set with the vendor's program"
        )

    def moving(self, channel: str) -> bool:
        """Ask by byte 5, twice if the answer is no; then for errors, of which 10 is MotionStopped."""
        if self._ask_again(lambda: self._moves(channel)) or self._ask_again(lambda: self._moves(channel)):
            return True
        homing = channel in self._homing
        if homing and not self._ask_again(lambda: self._ready(channel)):
            return True
        self._homing.discard(channel)
        code = self._ask_again(lambda: self._error_of(channel))
        if self._stopped or code == gcs.STOPPED:
            self._stopped = False
            raise MotionStopped(f"{self.name} axis {channel} was stopped")
        if code:
            self._raise(code, f"axis {channel} moving")
        if homing and self._ask_again(lambda: self._value("FRF?", channel)) == 1:
            self._referenced.add(channel)
        return False

    def position_mm(self, channel: str) -> float:
        """Position in mm of an axis that rests, read until two readings agree within the noise of an encoder.

        StageUsageError if the axis moves.
        """

        def ask() -> float:
            if self._moves(channel):  # by a joystick or another program: two readings may agree by chance
                raise StageUsageError(f"{self.name} axis {channel} is moving; wait until it stops")
            return self._value("POS?", channel)

        return self._settle_reading(channel, ask, self._near(channel))

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Nothing to check: the controller refuses what it cannot do, with error 8."""

    def _check_channel(self, channel: Channel) -> None:
        if channel.steps_per_mm is not None:
            raise StageUsageError(
                f"{self.name}: remove steps_per_mm of {channel.name}; PI controllers count in mm"
            )
        if not re.fullmatch(r"([1-9]|1[0-6])/\w{1,16}|\w{1,16}", channel.name):
            raise StageUsageError(
                f"{self.name}: channel {channel.name!r} is neither an axis, nor address and axis of a chain as 2/1"
            )
        if len({"/" in name for name in self._channels}) > 1:
            raise StageUsageError(
                f"{self.name}: either all channels have an address or none, not {', '.join(self._channels)}"
            )

    def _reset_state(self) -> None:
        self._profile = {}
        self._homing = set()

    def _identify(self) -> str:
        """Answer to *IDN? of each controller; every older answer stands before the first and is skipped."""
        return "; ".join(self._introduction(address) for address in self._addresses)

    def _introduction(self, address: int | None) -> str:
        def accept(answer: object) -> str | None:
            if not isinstance(answer, gcs.Answer) or answer.sender != address:
                return None
            text = " ".join(answer.lines)
            return text if text.count(",") >= 3 and _MAKER.search(text) else None

        return self._converse(gcs.Command("*IDN?", address=address).to_bytes(), accept)

    @property
    def _addresses(self) -> list[int | None]:
        """Of the controllers on this port; None of one that is alone."""
        return sorted({_address_of(name) for name in self._channels}, key=lambda address: address or 0)

    def _set_up(self) -> None:
        for address in self._addresses:
            self._require_command_set(address)
        self._axes = {
            address: self._ask_again(lambda a=address: self._ask("SAI?", address=a)).lines  # type: ignore[misc]
            for address in self._addresses
        }
        for channel in self._channels:
            there = self._axes[_address_of(channel)]
            if _axis_of(channel) not in there:
                raise WrongDevice(f"{self.name} has axes {', '.join(there)}, not {channel}")
            self._ask_again(lambda c=channel: self._error_of(c))  # type: ignore[misc]  # whatever stands there is not ours

    def _require_command_set(self, address: int | None) -> None:
        """WrongDevice if a controller has another one than GCS 2; older ones do not know the question."""

        def ask() -> float:
            answer = self._ask("CSV?", address=address)
            try:
                return gcs.number(" ".join(answer.lines))
            except ProtocolViolation:
                self._suspect = True
                raise

        try:
            said = self._ask_again(ask)
        except NoReply:
            return
        if said > COMMAND_SET:
            raise WrongDevice(
                f"{self.name} ({self.identity}) has command set {said}, which is GCS 3, and pi_gcs2 speaks GCS 2; "
                "put a controller of GCS 2 there, or write a driver for it (docs/add-a-stage.md)"
            )

    def _still_referenced(self, channel: str) -> bool:
        return self._remembers_reference(channel)

    def _forget_references(self) -> None:
        super()._forget_references()
        self._profile = {}

    def _remembers_reference(self, channel: str) -> bool:
        return self._ask_again(lambda: self._value("FRF?", channel)) == 1

    def _stop_bytes(self) -> Sequence[bytes]:
        stops = [gcs.SingleByte(gcs.STOP_ALL, address).to_bytes() for address in self._addresses]
        # in a chain by a line as well: how one byte is addressed is unproven
        return stops + [gcs.Command("STP", address=a).to_bytes() for a in self._addresses if a is not None]

    def _ask(self, name: str, *arguments: str, address: int | None = None) -> gcs.Answer:
        return self._talk(gcs.Command(name, arguments, address).to_bytes(), address)

    def _talk(self, data: bytes, address: int | None, moves: bool = False) -> gcs.Answer:
        """Return the answer of the controller that was asked; one of another is older, or damaged."""

        def accept(answer: object) -> gcs.Answer | None:
            if not isinstance(answer, gcs.Answer):
                return None
            if answer.sender != address:
                raise ProtocolViolation(f"{self.name}: another controller of the chain answers", answer.to_bytes())
            return answer

        return self._transact(data, accept, moves=moves)

    def _value(self, name: str, channel: str) -> float:
        """The number behind ``axis=``; an answer about anything else is a violation."""
        axis = _axis_of(channel)
        answer = self._ask(name, axis, address=_address_of(channel))
        try:
            values = answer.values()
            if set(values) != {axis}:
                raise ProtocolViolation(f"{self.name}: {name} {channel} answered", answer.to_bytes())
            return gcs.number(values[axis])
        except ProtocolViolation:
            self._suspect = True
            raise

    def _single(self, code: int, channel: str) -> str:
        address = _address_of(channel)
        lines = self._talk(gcs.SingleByte(code, address).to_bytes(), address).lines
        return lines[0] if len(lines) == 1 else ""

    def _moves(self, channel: str) -> bool:
        text = self._single(gcs.MOVING, channel)
        if not re.fullmatch(r"(0x)?[0-9A-Fa-f]{1,4}", text):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: no motion mask", text.encode("latin-1"))
        return bool(int(text, 16) >> self._axes[_address_of(channel)].index(_axis_of(channel)) & 1)

    def _ready(self, channel: str) -> bool:
        text = self._single(gcs.READY, channel).encode("latin-1")
        if text not in (gcs.READY_BYTE, gcs.BUSY_BYTE):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: not a ready byte", text)
        return text == gcs.READY_BYTE

    def _error_of(self, channel: str) -> int:
        return self._error_code(self._ask("ERR?", address=_address_of(channel)))

    def _error_code(self, answer: gcs.Answer) -> int:
        if len(answer.lines) != 1 or not re.fullmatch(r"-?\d{1,5}", answer.lines[0]):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: no error code", answer.to_bytes())
        return int(answer.lines[0])

    def _command(self, name: str, channel: str, *arguments: str, moves: bool = False) -> None:
        """Send a command about a channel and ask at once whether it went well."""
        if self._stopped:  # the 10 of an earlier stop is not this command's
            for each in self._channels:
                self._ask_again(lambda c=each: self._error_of(c))  # type: ignore[misc]
            self._stopped = False
        address = _address_of(channel)
        data = _command_for(name, channel, *arguments).to_bytes() + gcs.Command("ERR?", address=address).to_bytes()
        if code := self._error_code(self._talk(data, address, moves)):
            self._raise(code, " ".join([name, channel, *arguments]))

    def _if_known(self, name: str, channel: str, *arguments: str) -> None:
        try:
            self._ask_again(lambda: self._command(name, channel, *arguments))
        except CommandRejected as refused:
            if refused.code != gcs.UNKNOWN_COMMAND:
                raise

    def _raise(self, code: int, doing: str) -> None:
        where = f"{self.name}, {doing}"
        if code == gcs.STOPPED:
            raise MotionStopped(f"{where}: stopped")
        if code == gcs.MOTION_ERROR:
            self._forget_references()
            raise AxisStalled(f"{where}: the motor did not follow ({code}); clear the way and home it")
        if code in ON_LIMIT_SWITCH:
            self._forget_references()
            raise LimitHit(f"{where}: limit switch ({code}); home it")
        if code == gcs.NOT_ALLOWED:
            self._forget_references()
        raise CommandRejected(f"{where}: refused with error {code}", code)


def _address_of(channel: str) -> int | None:
    """Address of the controller in its chain; None of one that is alone."""
    address, slash, _ = channel.partition("/")
    return int(address) if slash else None


def _axis_of(channel: str) -> str:
    """Name of the axis in the controller."""
    return channel.rpartition("/")[2]


def _command_for(name: str, channel: str, *arguments: str) -> gcs.Command:
    """A command about a channel."""
    return gcs.Command(name, (_axis_of(channel), *arguments), _address_of(channel))
