"""Pulse generators of Quantum Composers (9510, 9520, 9530) and Berkeley Nucleonics (575, 577): one family.

8N1, ASCII, one command a line, CR LF both ways. The host says

    :PULSE<n>:<keyword>[:<keyword>] <value>        n = 0 is the system timer T0, 1 ... 8 are the outputs A ... H
    :PULSE<n>:<keyword>[:<keyword>]?
    *<word>[?]

and every line is answered: ``ok``, ``?<n>`` with the reason of a refusal, or the value that was asked for.
Keywords have a long and a short form (its capitals, as a manual prints them: ``PULSe`` is PULS) and may be written
in any case, with nothing between the two forms. A missing number means the last one that was used, so it is
always sent. Numbers are seconds; booleans come back as 1 and 0, words in their short form. A box on its round
connector may echo every line before it answers.

**Two words for the clock.** On a 9530 it is a mode, ``:PULSE0:ICL:MOD INT|EXT|XPL``, and ``XPL?`` as its value
means that its loop is not locked. On a 575, 9510 or 9520 it is one word, ``:PULSE0:ICL SYS|EXT10|...``.

Sources: "9500 Plus Series" and "9530 Series" operating manuals of Quantum Composers, "575 Series" and "577"
operating manuals of Berkeley Nucleonics (remote programming); the command tree that a 9530 lists when it is asked
``:INST:COMM?``; the test of the Quantum Composers 9530 in QMI, whose bytes are those of a real box.
docs/devices.md says for each word where it stands.
"""

import re
from dataclasses import dataclass
from functools import lru_cache, partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, TextLine, text_of

REASONS = {
    1: "no colon or asterisk", 2: "a keyword is missing", 3: "a keyword is unknown", 4: "a value is missing",
    5: "the value is not allowed", 6: "it can only be asked for", 7: "it cannot be asked for",
    8: "not in this state", 9: "the value is out of bounds",
}  # fmt: skip

WORDS = {  # short form: long form
    "PULS": "PULSE", "SPUL": "SPULSE", "STAT": "STATE", "PER": "PERIOD", "MOD": "MODE", "BCO": "BCOUNTER",
    "PCO": "PCOUNTER", "OCO": "OCOUNTER", "WCO": "WCOUNTER", "CYCL": "CYCLE", "WIDT": "WIDTH", "DEL": "DELAY",
    "SYNC": "SYNC", "MUX": "MUX", "POL": "POLARITY", "CMOD": "CMODE", "CGAT": "CGATE", "CLOG": "CLOGIC",
    "OUTP": "OUTPUT", "AMPL": "AMPLITUDE", "TRIG": "TRIGGER", "EDG": "EDGE", "LEV": "LEVEL", "GAT": "GATE",
    "LOG": "LOGIC", "ICL": "ICLOCK", "RAT": "RATE", "SYST": "SYSTEM", "AUT": "AUTORUN", "KLOC": "KLOCK",
    "SERN": "SERNUMBER", "COMM": "COMMUNICATE", "SER": "SERIAL", "USB": "USB", "BAUD": "BAUD", "ECH": "ECHO",
    "INST": "INSTRUMENT", "CAT": "CATALOG", "COUN": "COUNTER", "CLE": "CLEAR", "VERS": "VERSION",
    "DISP": "DISPLAY", "ENAB": "ENABLE",
}  # fmt: skip
_SHORT = {form: short for short, long in WORDS.items() for form in (short, long)}
_COMMAND = re.compile(r"([:*][A-Za-z0-9:]*)(\?)?(?: +(.*))?")


@dataclass(frozen=True, slots=True)
class Command:
    """One line of the host: a keyword to be set to a value, asked for, or carried out."""

    keyword: str  # with its colon or asterisk
    value: str | None = None
    asks: bool = False

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        value = "" if self.value is None else f" {self.value}"
        return f"{self.keyword}{'?' if self.asks else ''}{value}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Done:
    """The box has taken a command."""

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"ok\r\n"


@dataclass(frozen=True, slots=True)
class Refused:
    """The box has not taken it; `code` is one of REASONS."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"?{self.code}\r\n".encode("ascii")


@dataclass(frozen=True, slots=True)
class Value(TextLine):
    """The value that was asked for."""


@dataclass(frozen=True, slots=True)
class Echo(TextLine):
    """The host's own line, given back before the answer."""


COMMANDS = (Command,)
ANSWERS = (Done, Refused, Value, Echo)
Answer = Done | Refused | Value | Echo


@lru_cache(maxsize=512)
def short_forms(keyword: str) -> tuple[str, ...]:
    """Return the short forms of a keyword, the number of its pulse apart: ``:Pulse2:State`` is PULS, 2, STAT.

    Raises
    ------
    KeyError
        It is neither the long nor the short form of any.
    """
    parts: list[str] = []
    for word in keyword.upper().strip(":").split(":"):
        name = word.rstrip("0123456789") if word.startswith("PULS") else word
        parts.append(_SHORT[name])
        if name != word:
            parts.append(word.removeprefix(name))
    return tuple(parts)


def parse_command(line: bytes) -> Command:
    """Read a line of the host.

    Raises
    ------
    ProtocolViolation
        It is no command.
    """
    match = _COMMAND.fullmatch(text_of(line).strip())
    if match is None:
        raise ProtocolViolation("not a command of a pulse generator", line)
    return Command(match[1], match[3], match[2] is not None)


def parse_answer(line: bytes) -> Answer:
    """Read a line of a box.

    Raises
    ------
    ProtocolViolation
        It is none: a reason that there is not, an empty or unreadable line.
    """
    text = text_of(line).strip()
    if text.lower() == "ok":
        return Done()
    if text.startswith("?"):
        if len(text) == 2 and text[1] in "123456789":
            return Refused(int(text[1]))
        raise ProtocolViolation("not a reason of a pulse generator", line)
    if text.startswith((":", "*", "!")):
        return Echo(text)
    if not text:
        raise ProtocolViolation("an empty line", line)
    return Value(text)


CommandStream = partial(LineStream, parse_command)  # of a host
AnswerStream = partial(LineStream, parse_answer)  # of a box
