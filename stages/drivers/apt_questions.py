"""Questions to a Thorlabs box, which answers are believed, and in which units its numbers are.

An answer carries no number and no checksum. It counts if it is of the kind that was asked for, about the channel
and from the place that was asked; any other is older than the question, or damaged, and makes the link suspect.
What boxes say unasked may stand before, between and behind answers and is none of them; an error reported like
that is kept, because it may be why a motion does not begin.

The protocol sends integers whose unit depends on the electronics: servos count 1/65536 encoder counts per period
of their control loop, older steppers microsteps per second, newer ones what their motion chip counts in. Nothing
in an answer shows which. So each line of the table of families says what 1 count/s and 1 count/s2 are on the wire,
and who has written it down or tried it; a box of a model that is not in it is refused.
"""

import math
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from stages.controller import Channel, Controller
from stages.errors import ProtocolViolation, StageUsageError
from stages.protocols import apt_words as words
from stages.protocols import thorlabs_apt as apt
from stages.protocols.apt_words import Kind

SERVO_S, BRUSHLESS_S = 2048 / 6e6, 102.4e-6  # period of the control loop


class Family(NamedTuple):
    """Units of the boxes of one kind: what 1 count/s and 1 count/s2 are on the wire; whether an encoder counts."""

    models: str
    speed: float
    acceleration: float
    has_encoder: bool


FAMILIES = (
    # APT protocol, "Motor scaling"; pylablib 1.4.5 KinesisMotor; thorlabs-apt-device 0.3.8 utils: T = 2048/6e6 s
    Family(r"[TK]DC\d+", 65536 * SERVO_S, 65536 * SERVO_S**2, True),
    # the same three: T = 102.4 us
    Family(r"[TK]BD\d+|BBD[12]0\d", 65536 * BRUSHLESS_S, 65536 * BRUSHLESS_S**2, True),
    # InstrumentKit, pylablib: microsteps as they are
    Family(r"TST001|BSC00\d|(BSC|SCC)10\d|MST601", 1.0, 1.0, False),
    # pylablib, in whose issues 14, 21, 46 a BSC20x calls itself SCC20x; thorlabs-apt-device BSC: 409600
    # microsteps/mm, 21987328 for 1 mm/s, 4506 for 1 mm/s2; for LTS also pyAPT and thorpy
    # (github.com/freespace/pyAPT/pull/8, UniNE-CHYN/thorpy/pull/2), tried on an LTS300
    Family(r"TST101|KST[12]01|(BSC|SCC)20\d|MST602|LTS(150|300)\w*", 53.68, 1.0 / 90.9, False),
)


LARGEST_CHANNEL = 4
ALIVE_S = 0.5  # a second is what a box is said to wait

A = TypeVar("A", bound=apt.Answer)


class AptQuestions(Controller):
    """Questions and commands of a Thorlabs box."""

    decoder = apt.AnswerStream
    _complaint: str  # the last error that the box has reported unasked
    _alive_s: float = -math.inf  # time of the last keep-alive message
    _told_homed: set[str]  # channels whose homing was reported as ended

    def _check_channel(self, channel: Channel) -> None:
        super()._check_channel(channel)
        if not re.fullmatch(rf"[1-{LARGEST_CHANNEL}]|bay([1-9]|10)", channel.name):
            raise StageUsageError(
                f"{self.name}: channel {channel.name!r} should be 1, 2, .. of a unit, or bay1, bay2, .. of a rack"
            )
        if len({name.startswith("bay") for name in self._channels}) > 1:
            raise StageUsageError(
                f"{self.name}: a box has either channels or bays, not {', '.join(self._channels)}"
            )

    @property
    def _is_rack(self) -> bool:
        return any(name.startswith("bay") for name in self._channels)

    @property
    def _places(self) -> list[int]:
        """Addresses of all that is talked to."""
        cards = sorted({place_of(name) for name in self._channels})
        return [words.RACK, *cards] if self._is_rack else cards

    def _clear_line(self) -> None:
        """And send a keep-alive message if the last is old."""
        super()._clear_line()
        if self.clock.now_s() - self._alive_s > ALIVE_S:
            self._alive_s = self.clock.now_s()
            for to in self._places:
                self.port.write(apt.Order(Kind.MOT_ACK_DCSTATUSUPDATE, to=to).to_bytes())

    def _identify(self) -> str:
        """Read the identity of the box; everything older stands before it and is skipped."""
        to = words.RACK if self._is_rack else words.UNIT

        def accept(answer: object) -> apt.Info | None:
            return answer if isinstance(answer, apt.Info) and answer.sender == to else None

        question = apt.Order(Kind.HW_REQ_INFO, to=to).to_bytes()
        info = self._converse(question, accept, stream=apt.IdentityStream(to))
        minor, interim, major = info.firmware
        return f"Thorlabs {info.model.strip()} serial {info.serial} firmware {major}.{interim}.{minor}"

    def _take_unsolicited(self, data: bytes) -> None:
        """Take unsolicited messages, which answer no question; only whole ones leave the link in order."""
        stream = apt.AnswerStream()
        self._surplus(stream.feed(data), stream.rest)

    def _surplus(self, answers: Sequence[object], rest: bytes) -> None:
        if rest or not all(self._is_unasked(answer) for answer in answers):
            self._suspect = True

    def _is_unasked(self, answer: object) -> bool:
        if not isinstance(answer, apt.Unasked):
            return False
        self._complaint = answer.complaint or self._complaint
        if answer.kind == Kind.MOT_MOVE_HOMED:
            self._told_homed |= {name for name in self._channels if _tells_of(answer, name)}
        return True

    def _ask(self, question: bytes, kind: type[A], fits: Callable[[A], bool], moves: bool = False) -> A:
        """Return the answer of a kind; one that does not fit is older than the question, or damaged."""

        def accept(answer: object) -> A | None:
            if self._is_unasked(answer):
                return None
            if isinstance(answer, kind) and fits(answer):
                return answer
            raise ProtocolViolation(f"{self.name} answers something else than the question")

        return self._transact(question, accept, moves=moves)

    def _about(self, channel: str, kind: Kind, answer: type[A], before: bytes = b"") -> A:
        """Ask a channel something, behind a command that moves if there is one."""

        def fits(found: A) -> bool:
            return (getattr(found, "channel", None), found.sender) == (ident_of(channel), place_of(channel))

        question = apt.Order(kind, ident_of(channel), 0, place_of(channel)).to_bytes()
        return self._ask(before + question, answer, fits, moves=bool(before))

    def _bits(self, channel: str, before: bytes = b"") -> int:
        return self._about(channel, Kind.MOT_REQ_STATUSBITS, apt.Status, before).bits

    def _count(self, channel: str) -> int:
        return self._value(channel, Kind.MOT_REQ_POSCOUNTER)

    def _value(self, channel: str, kind: Kind) -> int:
        answer = self._about(channel, kind, apt.Value)
        if answer.kind != kind + 1:  # the vendor's answers follow their questions
            self._suspect = True
            raise ProtocolViolation(f"{self.name} answers something else than the question", answer.to_bytes())
        return answer.value

    def _speeds(self, channel: str) -> tuple[int, int]:
        answer = self._about(channel, Kind.MOT_REQ_VELPARAMS, apt.Speeds)
        return answer.maximum, answer.acceleration

    def _homing_settings(self, channel: str) -> apt.Homing:
        return self._about(channel, Kind.MOT_REQ_HOMEPARAMS, apt.Homing)

    def _tell(self, channel: str, kind: Kind, second: int = 0) -> None:
        self._send(apt.Order(kind, ident_of(channel), second, place_of(channel)).to_bytes())

    def _set(self, channel: str, kind: Kind, value: int) -> None:
        self._send(apt.Setting(kind, ident_of(channel), value, place_of(channel)).to_bytes())


def _tells_of(answer: apt.Unasked, channel: str) -> bool:
    """Return whether a short message is about a channel; some boxes do not say who they are."""
    return answer.data[0] == ident_of(channel) and answer.sender in (place_of(channel), apt.NO_SENDER)


def ident_of(channel: str) -> int:
    """Number of a channel where it is addressed: a bay has only one."""
    return 1 if channel.startswith("bay") else int(channel)


def place_of(channel: str) -> int:
    """Address of the unit or card that a channel belongs to."""
    return words.FIRST_BAY + int(channel.removeprefix("bay")) - 1 if channel.startswith("bay") else words.UNIT
