"""Driver for PI controllers with the General Command Set 2.0.

A channel is the controller's name of the axis ("1", "A"). Lengths are mm, so there is no steps_per_mm here.

Failures show only in ``ERR?``, which is sent behind every command in the same write. A stop (#24) leaves error
10 behind, which would look like a failure of the next command; it is read away before that. While a reference
move runs, only the one-byte commands are answered. Error -1024 means that the motor did not follow and the
servo has switched itself off. ``ONT?`` is not used: its window is the controller's, ours is in the bench file.
After a restart ``FRF?`` says 0 (an axis with an absolute encoder keeps its reference), the servo is off and the
velocity is the parameter's: `_forget_references` forgets all of it.
"""

import re
from collections.abc import Sequence

from stages.controller import Channel, Controller
from stages.errors import (
    AxisStalled,
    CommandRejected,
    LimitHit,
    MotionStopped,
    ProtocolViolation,
    StageUsageError,
    WrongDevice,
)
from stages.link import Stream
from stages.protocols import pi_gcs2 as gcs

ON_LIMIT_SWITCH = (49, 216)
NOISE_MM = 0.001  # an encoder at rest may flicker by some counts


class PiController(Controller):
    """One PI controller."""

    default_baud = 115_200
    example_channels = ("1", "2")
    senses_stall = True

    _axes: tuple[str, ...] = ()
    _profile: dict[str, tuple[str, str]]
    _homing: set[str]

    def start_move(self, channel: str, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Begin an absolute move."""
        profile = (f"{speed_mm_s:.6f}", f"{acceleration_mm_s2:.6f}")
        if self._profile.get(channel) != profile:
            self._profile.pop(channel, None)
            self._repeated(lambda: self._command("SVO", channel, "1"))
            self._repeated(lambda: self._command("VEL", channel, profile[0]))
            for name in ("ACC", "DEC"):
                self._if_known(name, channel, profile[1])
            self._profile[channel] = profile
        self._command("MOV", channel, f"{target_mm:.6f}", moves=True)

    def start_home(self, channel: str) -> None:
        """Begin the reference move."""
        self._referenced.discard(channel)
        self._profile.pop(channel, None)
        self._repeated(lambda: self._command("SVO", channel, "1"))
        self._homing.add(channel)
        self._send(
            gcs.Command("FRF", (channel,)).to_bytes(), moves=True
        )  # not every firmware answers ERR? meanwhile

    def moving(self, channel: str) -> bool:
        """Ask by byte 5, twice if the answer is no; then for errors, of which 10 is MotionStopped."""
        if self._repeated(lambda: self._moves(channel)) or self._repeated(lambda: self._moves(channel)):
            return True
        homing = channel in self._homing
        if homing and not self._repeated(self._ready):
            return True
        self._homing.discard(channel)
        code = self._repeated(self._error)
        if self._stopped or code == gcs.STOPPED:
            self._stopped = False
            raise MotionStopped(f"{self.name} axis {channel} was stopped")
        if code:
            self._raise(code, f"axis {channel} moving")
        if homing and self._repeated(lambda: self._value("FRF?", channel)) == 1:
            self._referenced.add(channel)
        return False

    def position_mm(self, channel: str) -> float:
        """Position in mm of an axis that rests, read until two readings agree within the noise of an encoder.

        StageUsageError if the axis moves.
        """

        def ask() -> float:
            if self._moves(channel):  # by a joystick or another program: two readings may agree by chance
                raise StageUsageError(f"{self.name} axis {channel} moves; wait until it rests")
            return self._value("POS?", channel)

        return self._settled(channel, ask, lambda a, b: abs(a - b) <= NOISE_MM)

    def check_motion(self, channel: str, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Nothing to check: the controller refuses what it cannot do, with error 8."""

    def _check_channel(self, channel: Channel) -> None:
        if channel.steps_per_mm is not None:
            raise StageUsageError(
                f"{self.name}: remove steps_per_mm of {channel.name}; PI controllers count in mm"
            )
        if not re.fullmatch(r"\w{1,16}", channel.name):
            raise StageUsageError(f"{self.name}: channel {channel.name!r} is no axis name")

    def _reset_state(self) -> None:
        self._profile = {}
        self._homing = set()

    def _identify(self) -> str:
        """Answer to *IDN?; every older answer stands before it and is skipped."""

        def accept(answer: object) -> str | None:
            text = " ".join(answer.lines) if isinstance(answer, gcs.Answer) else ""
            return text if text.count(",") >= 3 else None

        return self._converse(gcs.Command("*IDN?").to_bytes(), accept)

    def _set_up(self) -> None:
        self._axes = self._repeated(lambda: self._ask("SAI?")).lines
        if missing := set(self._channels) - set(self._axes):
            raise WrongDevice(f"{self.name} has axes {', '.join(self._axes)}, not {', '.join(sorted(missing))}")
        self._repeated(self._error)  # whatever stands there is not ours

    def _still_referenced(self, channel: str) -> bool:
        return self._remembers_reference(channel)

    def _forget_references(self) -> None:
        super()._forget_references()
        self._profile = {}

    def _remembers_reference(self, channel: str) -> bool:
        return self._repeated(lambda: self._value("FRF?", channel)) == 1

    def _stop_bytes(self) -> Sequence[bytes]:
        return [gcs.SingleByte(gcs.STOP_ALL).to_bytes()]

    def _stream(self) -> Stream:
        return gcs.AnswerStream()

    def _ask(self, name: str, *arguments: str) -> gcs.Answer:
        return self._transact(gcs.Command(name, arguments).to_bytes(), _any_answer)

    def _value(self, name: str, channel: str) -> float:
        """The number behind ``channel=``; an answer about anything else is a violation."""
        answer = self._ask(name, channel)
        try:
            values = answer.values()
            if set(values) != {channel}:
                raise ProtocolViolation(f"{self.name}: {name} {channel} answered", answer.to_bytes())
            return gcs.number(values[channel])
        except ProtocolViolation:
            self._suspect = True
            raise

    def _single(self, code: int) -> str:
        lines = self._transact(gcs.SingleByte(code).to_bytes(), _any_answer).lines
        return lines[0] if len(lines) == 1 else ""

    def _moves(self, channel: str) -> bool:
        text = self._single(gcs.MOVING)
        if not re.fullmatch(r"(0x)?[0-9A-Fa-f]{1,4}", text):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: no motion mask", text.encode("latin-1"))
        return bool(int(text, 16) >> self._axes.index(channel) & 1)

    def _ready(self) -> bool:
        text = self._single(gcs.READY).encode("latin-1")
        if text not in (gcs.READY_BYTE, gcs.BUSY_BYTE):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: not a ready byte", text)
        return text == gcs.READY_BYTE

    def _error(self) -> int:
        return self._error_code(self._ask("ERR?"))

    def _error_code(self, answer: gcs.Answer) -> int:
        if len(answer.lines) != 1 or not re.fullmatch(r"-?\d{1,5}", answer.lines[0]):
            self._suspect = True
            raise ProtocolViolation(f"{self.name}: no error code", answer.to_bytes())
        return int(answer.lines[0])

    def _command(self, name: str, *arguments: str, moves: bool = False) -> None:
        """Send a command and ask at once whether it went well."""
        if self._stopped:  # the 10 of an earlier stop is not this command's
            self._repeated(self._error)
            self._stopped = False
        data = gcs.Command(name, arguments).to_bytes() + gcs.Command("ERR?").to_bytes()
        if code := self._error_code(self._transact(data, _any_answer, moves=moves)):
            self._raise(code, " ".join([name, *arguments]))

    def _if_known(self, name: str, *arguments: str) -> None:
        try:
            self._repeated(lambda: self._command(name, *arguments))
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


def _any_answer(answer: object) -> gcs.Answer | None:
    return answer if isinstance(answer, gcs.Answer) else None
