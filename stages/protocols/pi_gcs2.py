"""PI General Command Set 2.0: one syntax for very many Physik Instrumente controllers.

The host sends ``CMD[?][ argument]... LF``. Only queries are answered: lines ``[name=]value LF``; every line of
an answer but the last carries a SPACE before its LF. Four commands are one byte without LF, and get through
while the controller is busy: 5 asks which axes move (a hexadecimal mask), 7 asks whether the controller is
ready (0xB1 or 0xB0), 24 stops everything, 4 asks for the status register. Failures show only when ``ERR?`` is
asked; asking clears the error. Lengths are mm (or what the controller was set to), never steps.

Source: PI, "MS249E C-863.12 Mercury Controller User Manual", version 1.2.1 (2021).
"""

import re
from dataclasses import dataclass

from stages.errors import ProtocolViolation
from stages.protocols.framing import Example, LineStream, text_of

MANUAL = "PI, MS249E C-863.12 User Manual 1.2.1"

MOVING, READY, STOP_ALL = 5, 7, 24
SINGLE_BYTES = (4, MOVING, READY, 8, STOP_ALL)
READY_BYTE, BUSY_BYTE = b"\xb1", b"\xb0"

NO_ERROR = 0
UNKNOWN_COMMAND = 2
NOT_ALLOWED = 5  # unreferenced axis, or servo off
OUT_OF_LIMITS = 7
STOPPED = 10
BAD_AXIS = 15
MOTION_ERROR = -1024  # position error too large, servo switched off

_COMMAND = re.compile(r"(\*IDN\?|[A-Za-z]{3}\??)((?: +\S+)*) *")
LONGEST_ANSWER = 4096


@dataclass(frozen=True, slots=True)
class Command:
    """A command line, such as MOV 1 10.0."""

    name: str
    arguments: tuple[str, ...] = ()

    @property
    def is_query(self) -> bool:
        """True if the controller will answer."""
        return self.name.endswith("?")

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return (" ".join([self.name, *self.arguments]) + "\n").encode("ascii")

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented lines."""
        return (
            Example(b"MOV 1 10.0\n", cls("MOV", ("1", "10.0")), f"{MANUAL}, p. 116, example 1"),
            Example(
                b"MOV 1 17.3 2 2.05\n", cls("MOV", ("1", "17.3", "2", "2.05")), f"{MANUAL}, p. 116, example 2"
            ),
            Example(b"POS?\n", cls("POS?"), f"{MANUAL}, p. 116, example 4"),
            Example(b"TSP? 2 1\n", cls("TSP?", ("2", "1")), f"{MANUAL}, p. 117, example 5"),
        )


@dataclass(frozen=True, slots=True)
class SingleByte:
    """One of the commands that are a byte."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return bytes([self.code])

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented bytes."""
        return (
            Example(b"\x05", cls(MOVING), f"{MANUAL}, p. 127, #5"),
            Example(b"\x07", cls(READY), f"{MANUAL}, p. 127, #7"),
            Example(b"\x18", cls(STOP_ALL), f"{MANUAL}, #24"),
        )


@dataclass(frozen=True, slots=True)
class Answer:
    """All lines of one answer."""

    lines: tuple[str, ...]

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return (" \n".join(self.lines) + "\n").encode("latin-1")

    def values(self) -> dict[str, str]:
        """Return what stands behind each name.

        Raises
        ------
        ProtocolViolation
            A line is not name=value, or a name comes twice.
        """
        found: dict[str, str] = {}
        for line in self.lines:
            name, equals, value = line.partition("=")
            if not equals or not value.strip() or name.strip() in found:
                raise ProtocolViolation("not name=value", line.encode("latin-1"))
            found[name.strip()] = value.strip()
        return found

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented answers."""
        return (
            Example(
                b"2=-1158.4405 \n1=+0000.0000\n",
                cls(("2=-1158.4405", "1=+0000.0000")),
                f"{MANUAL}, p. 117, example 5",
            ),
            Example(b"0\n", cls(("0",)), f"{MANUAL}, p. 127, #5: motion of all axes complete"),
            Example(b"3\n", cls(("3",)), f"{MANUAL}, p. 127, #5: first and second axis in motion"),
            Example(b"\xb1\n", cls(("\xb1",)), f"{MANUAL}, p. 127, #7: ready, with termination character p. 116"),
            Example(b"0x9005\n", cls(("0x9005",)), f"{MANUAL}, p. 126, #4"),
        )


COMMANDS = (Command, SingleByte)
ANSWERS = (Answer,)


def parse_command(line: bytes) -> Command:
    """Read a command line without its LF.

    Raises
    ------
    ProtocolViolation
        It is no GCS command.
    """
    match = _COMMAND.fullmatch(text_of(line.rstrip(b"\r")))
    if match is None:
        raise ProtocolViolation("not a GCS command", line)
    return Command(match[1].upper(), tuple(match[2].split()))


def parse_answer(raw: bytes) -> Answer:
    """Read a whole answer, line ends included.

    Raises
    ------
    ProtocolViolation
        Not text (the bytes of #7 apart), or not ended.
    """
    if not raw.endswith(b"\n") or raw.endswith(b" \n"):
        raise ProtocolViolation("an answer has no end", raw)
    if raw in (READY_BYTE + b"\n", BUSY_BYTE + b"\n"):
        return Answer((raw[:1].decode("latin-1"),))
    return Answer(tuple(text_of(line.rstrip(b"\r")) for line in raw[:-1].split(b" \n")))


def number(text: str) -> float:
    """A plain decimal number; nothing else that Python might take for one.

    Raises
    ------
    ProtocolViolation
        It is none.
    """
    if not re.fullmatch(r"[-+]?\d{1,12}(\.\d{1,12})?([eE][-+]?\d{1,2})?", text):
        raise ProtocolViolation("not a number", text.encode("latin-1"))
    return float(text)


class CommandStream(LineStream[Command | SingleByte]):
    """Bytes of a host to commands and single bytes, which may stand in the middle of a line."""

    def __init__(self) -> None:
        singles = {code: SingleByte(code) for code in SINGLE_BYTES}
        super().__init__(parse_command, b"\n", LONGEST_ANSWER, singles)


class AnswerStream:
    """Bytes of a controller to whole answers."""

    def __init__(self) -> None:
        self._rest = bytearray()

    @property
    def rest(self) -> bytes:
        """Bytes of an answer that is not complete."""
        return bytes(self._rest)

    def feed(self, chunk: bytes) -> list[Answer | ProtocolViolation]:
        """Add bytes; return the answers that are complete now, a violation in place of each unreadable one."""
        found: list[Answer | ProtocolViolation] = []
        for byte in chunk:
            self._rest.append(byte)
            if byte == 0x0A and not self._rest.endswith(b" \n"):
                raw = bytes(self._rest)
                self._rest.clear()
                try:
                    found.append(parse_answer(raw))
                except ProtocolViolation as violation:
                    found.append(violation)
        if len(self._rest) > LONGEST_ANSWER:
            found.append(ProtocolViolation("an answer has no end", bytes(self._rest[:60])))
            self._rest.clear()
        return found
