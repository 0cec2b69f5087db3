"""Digital delay generator DG645 of Stanford Research Systems.

9600 8N1 by RS-232, ASCII, one command a line; the host ends lines with LF, the box with CR LF. A command that
sets is not answered, a question is. Channels are 0 = T0, 1 = T1, 2 .. 9 = A .. H, outputs 0 = T0, 1 = AB, 2 = CD,
3 = EF, 4 = GH: an output is high from its first channel to its second.

    *IDN?   *TRG   *STB?   INSR?        INSR and *STB are sums of bits, and INSR is cleared by asking
    TSRC i      trigger source: 0 internal, 5 single shot, which *TRG or a key triggers
    BURM i, BURC n, BURP s, BURD s      burst mode, its count, period, and the delay of its first cycle
    DLAY c,d,s                          channel c comes s after channel d; DLAY? c answers d,s
    LPOL b,i    polarity of an output, 1 positive     ADVT i      prescalers, used or not
    INHB i      what the inhibit input does, 0 nothing

Sources: DG645 User Manual, remote programming, as the maker's own driver srsinst.dg645 (2026) and its tests on a
live box give it.
"""

import re
from dataclasses import dataclass
from functools import partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, TextLine, text_of

SINGLE_SHOT = 5
IS_BUSY, IS_IN_BURST = 1 << 1, 1 << 2  # bits of *STB
WAS_TRIGGERED, ENDED_BURST = 1 << 0, 1 << 3  # bits of INSR
UNLOCKED = 1 << 6 | 1 << 7
_COMMAND = re.compile(r"(\*?[A-Z]{3,4})(\?)?(?: ?(.*))?")


@dataclass(frozen=True, slots=True)
class Command:
    """One line of the host."""

    word: str
    values: str = ""
    asks: bool = False

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"{self.word}{'?' if self.asks else ''}{' ' if self.values else ''}{self.values}\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Value(TextLine):
    """The value that was asked for."""


COMMANDS = (Command,)
ANSWERS = (Value,)


def parse_command(line: bytes) -> Command:
    """Read a line of the host; ProtocolViolation if it is no command."""
    match = _COMMAND.fullmatch(text_of(line).strip().upper().replace("E-", "e-"))
    if match is None:
        raise ProtocolViolation("not a command of a DG645", line)
    return Command(match[1], match[3] or "", match[2] is not None)


def parse_answer(line: bytes) -> Value:
    """Read a line of a box; ProtocolViolation if it is not text."""
    return Value(text_of(line).strip())


CommandStream = partial(LineStream, parse_command)  # of a host
AnswerStream = partial(LineStream, parse_answer)  # of a box
