"""PI General Command Set 2.0: one syntax for very many Physik Instrumente controllers.

The host sends ``CMD[?][ argument]... LF``. Only queries are answered: lines ``[name=]value LF``; every line of
an answer but the last carries a SPACE before its LF. Four commands are one byte without LF, and get through
while the controller is busy: 5 asks which axes move (a hexadecimal mask), 7 asks whether the controller is
ready (0xB1 or 0xB0), 24 stops everything, 4 asks for the status register. Failures show only when ``ERR?`` is
asked; asking clears the error. Lengths are mm (or what the controller was set to), never steps.

**Chains.** Up to sixteen controllers share a port. A command may begin with the address of the one that is meant;
its answer begins with ``0 <address>`` then, on the first line. Without an address number 1 is meant, and answers
without one. How a command of one byte is addressed (here: address, space, byte) stands in no text at hand, and no
open client drives a chain without the vendor's library: unproven.

Source: PI, "MS249E C-863.12 Mercury Controller User Manual", version 1.2.1 (2021); pipython 2.11 for the start and
for what finds a reference (FRF, FNL, FPL; TRS?, LIM?).
"""

import re
from dataclasses import dataclass

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, text_of

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

_COMMAND = re.compile(r"(?:(\d{1,2}) (?:0 )?)?(\*IDN\?|[A-Za-z]{3}\??)((?: +\S+)*) *")
_SENDER = re.compile(rb"0 (\d{1,2}) ")
_ADDRESS = re.compile(rb"(\d{1,2}) ")
LONGEST_ANSWER = 4096
_SINGLES = re.escape(bytes(SINGLE_BYTES))
_PARTS = re.compile(b"[" + _SINGLES + b"]|[^" + _SINGLES + b"]+")


@dataclass(frozen=True, slots=True)
class Command:
    """A command line, such as MOV 1 10.0."""

    name: str
    arguments: tuple[str, ...] = ()
    address: int | None = None  # in a chain

    @property
    def is_query(self) -> bool:
        """True if the controller will answer."""
        return self.name.endswith("?")

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _with_address(self.address) + (" ".join([self.name, *self.arguments]) + "\n").encode("ascii")


@dataclass(frozen=True, slots=True)
class SingleByte:
    """One of the commands that are a byte."""

    code: int
    address: int | None = None  # in a chain

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _with_address(self.address) + bytes([self.code])


@dataclass(frozen=True, slots=True)
class Answer:
    """All lines of one answer."""

    lines: tuple[str, ...]
    sender: int | None = None  # address in a chain, where it was named in the question

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        prefix = b"" if self.sender is None else f"0 {self.sender} ".encode("ascii")
        return prefix + (" \n".join(self.lines) + "\n").encode("latin-1")

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
    return Command(match[2].upper(), tuple(match[3].split()), None if match[1] is None else int(match[1]))


def parse_answer(raw: bytes) -> Answer:
    """Read a whole answer, line ends included.

    Raises
    ------
    ProtocolViolation
        Not text (the bytes of #7 apart), or not ended.
    """
    if not raw.endswith(b"\n") or raw.endswith(b" \n"):
        raise ProtocolViolation("an answer has no end", raw)
    sender = None
    if match := _SENDER.match(raw):
        sender, raw = int(match[1]), raw[match.end() :]
    if raw in (READY_BYTE + b"\n", BUSY_BYTE + b"\n"):
        return Answer((raw[:1].decode("latin-1"),), sender)
    return Answer(tuple(text_of(line.rstrip(b"\r")) for line in raw[:-1].split(b" \n")), sender)


def _with_address(address: int | None) -> bytes:
    return b"" if address is None else f"{address} ".encode("ascii")


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
        super().__init__(parse_command, b"\n", LONGEST_ANSWER)

    def feed(self, chunk: bytes) -> list[Command | SingleByte | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        found: list[Command | SingleByte | ProtocolViolation] = []
        for part in _PARTS.findall(chunk):
            if part[0] not in SINGLE_BYTES:
                found += super().feed(part)
            elif match := _ADDRESS.fullmatch(self.rest):
                self._lines.forget()
                found.append(SingleByte(part[0], int(match[1])))
            else:
                found.append(SingleByte(part[0]))
        return found


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
