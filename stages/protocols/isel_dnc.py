"""isel iMC-S8 and interface card C142, DNC mode: the controller inside many traverses and rails.

19200 8N1 (C142: 9600). The host sends ``@<device><command> CR``; the controller answers with ONE character and
no end of line, and a motion is answered only when it has ENDED; until then the controller is mute. ``0`` is
success, everything else an error (`MEANING`). The position answer is ``0`` and six hexadecimal digits per axis,
24 bit two's complement. Because nothing ends an answer, a stream must know what it waits for: `AckStream`,
`PositionStream`, `IdentityStream`.

Axis masks: 1 = X, 2 = Y, 4 = Z. A motion names a distance and a speed for every initialised axis; with three
axes Z is named TWICE (two legs, the second normally 0 at the lowest speed).

The single byte 253 stops at once, without end of line; the interrupted motion is then answered with ``F``.

Speeds: the guide of the iMC-S8 ends at 10 000 steps/s, other drivers run 20 000, the hardware makes 30 000; a box
says D to what it does not take. Sources: isel, "4-Axis Controller iMC-M/-MP/-S8 Programming Guide", 06/2010; the
tables of its open clients. Byte 253 is documented by one client only; the "isel-@ protocol" guide of the IT116 was
never read.
"""

import re
from dataclasses import dataclass
from functools import partial

from stages.errors import ProtocolViolation
from stages.protocols.framing import LineStream, text_of

SLOWEST, FASTEST = 1, 30_000  # steps/s a motion may name; a box refuses what it does not go (D)
STEPS_LIMIT = 1 << 23  # positions are 24 bit, signed

MEANING = {
    "0": "done",
    "1": "a number was not understood",
    "2": "limit switch",
    "3": "axis not allowed",
    "4": "no axis initialised",
    "5": "syntax",
    "6": "memory full",
    "7": "wrong number of parameters",
    "8": "command cannot be stored",
    "9": "fault of the machine",
    "D": "speed not allowed",
    "F": "stopped by the user",
    "G": "data field not valid",
    "H": "hood is open",
    "R": "axis is not referenced",
}

_MOTION = re.compile(r"@(\d)([MA]) ?(-?\d+(?:\.\d+)?(?:,-?\d+(?:\.\d+)?)*)")
_NUMBERED = re.compile(r"@(\d)([RnNJ])(\d+)")
_SPEEDS = re.compile(r"@(\d)(?:Id|d) ?(\d+(?:,\d+)*)")


@dataclass(frozen=True, slots=True)
class Identify:
    """Ask for the version; a C142 does not know the command and answers 5."""

    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"@{self.device}V\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class Initialise:
    """Say which axes exist; every other command needs it first."""

    mask: int
    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"@{self.device}{self.mask}\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class Numbered:
    """Commands with one whole number: R reference run, n set zero, N simulated reference, J acceleration."""

    verb: str
    number: int
    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"@{self.device}{self.verb}{self.number}\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class ReferenceSpeeds:
    """Speeds of the reference run, steps/s, one per axis."""

    speeds: tuple[int, ...]
    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"@{self.device}d{','.join(map(str, self.speeds))}\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class Move:
    """A motion: (steps, steps/s) pairs in axis order, Z twice if there are three axes."""

    pairs: tuple[tuple[int, int], ...]
    absolute: bool = True
    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        numbers = ",".join(f"{steps},{speed}" for steps, speed in self.pairs)
        return f"@{self.device}{'M' if self.absolute else 'A'} {numbers}\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class AskPosition:
    """Ask for the position of all axes."""

    device: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return f"@{self.device}P\r".encode("ascii")


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop at once: one byte, no end of line."""

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"\xfd"


@dataclass(frozen=True, slots=True)
class Ack:
    """The one character that ends a command."""

    code: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return self.code.encode("ascii")


@dataclass(frozen=True, slots=True)
class Position:
    """Steps of every axis."""

    steps: tuple[int, ...]

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"0" + b"".join(f"{steps & 0xFFFFFF:06X}".encode("ascii") for steps in self.steps)


@dataclass(frozen=True, slots=True)
class Identity:
    """The version text; ended by silence, not by a character."""

    text: str

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return b"0" + self.text.encode("ascii")


COMMANDS = (Identify, Initialise, Numbered, ReferenceSpeeds, Move, AskPosition, Stop)
ANSWERS = (Ack, Position, Identity)
Command = Identify | Initialise | Numbered | ReferenceSpeeds | Move | AskPosition | Stop


def parse_command(line: bytes) -> Command:
    """Read a command of the host, without its CR.

    Raises
    ------
    ProtocolViolation
        It is no command.
    """
    text = text_of(line)
    if match := re.fullmatch(r"@(\d)V", text):
        return Identify(int(match[1]))
    if match := re.fullmatch(r"@(\d)P", text):
        return AskPosition(int(match[1]))
    if match := re.fullmatch(r"@(\d)([1-8])", text):
        return Initialise(int(match[2]), int(match[1]))
    if match := _NUMBERED.fullmatch(text):
        return Numbered(match[2], int(match[3][:9]), int(match[1]))
    if match := _SPEEDS.fullmatch(text):
        return ReferenceSpeeds(tuple(int(word[:9]) for word in match[2].split(",")), int(match[1]))
    if match := _MOTION.fullmatch(text):
        words = [word.partition(".")[0] for word in match[3].split(",")]  # a client sends decimals
        numbers = [int(word[:10]) for word in words]
        if len(numbers) % 2 or any(speed < 0 for speed in numbers[1::2]):
            raise ProtocolViolation("a motion without its speed", line)
        return Move(tuple(zip(numbers[::2], numbers[1::2], strict=True)), match[2] == "M", int(match[1]))
    raise ProtocolViolation("not a DNC command", line)


def parse_ack(raw: bytes) -> Ack:
    """Read the one character.

    Raises
    ------
    ProtocolViolation
        It is not a character of the table.
    """
    code = raw.decode("latin-1")
    if code not in MEANING:
        raise ProtocolViolation("not an answer character", raw)
    return Ack(code)


def parse_position(raw: bytes) -> Position:
    """Read a position answer.

    Raises
    ------
    ProtocolViolation
        It is not ``0`` and six hexadecimal digits per axis.
    """
    if not re.fullmatch(rb"0(?:[0-9A-Fa-f]{6})+", raw):
        raise ProtocolViolation("not a position", raw)
    values = [int(raw[start : start + 6], 16) for start in range(1, len(raw), 6)]
    return Position(tuple(value - 2 * STEPS_LIMIT if value >= STEPS_LIMIT else value for value in values))


def parse_identity(raw: bytes) -> Identity:
    """Read a version answer, whatever line end the firmware adds.

    Raises
    ------
    ProtocolViolation
        It holds no name.
    """
    text = text_of(raw.rstrip(b"\r\n"))
    if not re.fullmatch(r"0.*[A-Za-z]{2}.*", text):
        raise ProtocolViolation("not a version", raw)
    return Identity(text[1:].lstrip("0"))


# of a host; what is no command becomes its violation, for the controller answers 5
CommandStream = partial(LineStream[Command], parse_command, singles={0xFD: Stop()})


class AckStream:
    """Waits for one character."""

    rest = b""

    def feed(self, chunk: bytes) -> list[Ack | ProtocolViolation]:
        """Add bytes; each is an answer."""
        answers: list[Ack | ProtocolViolation] = []
        for start in range(len(chunk)):
            try:
                answers.append(parse_ack(chunk[start : start + 1]))
            except ProtocolViolation as violation:
                answers.append(violation)
        return answers


class PositionStream:
    """Waits for the position of a known number of axes, or for the one character that refuses it."""

    def __init__(self, axes: int) -> None:
        self._length = 1 + 6 * axes
        self.rest = b""

    def feed(self, chunk: bytes) -> list[Position | Ack | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        self.rest += chunk
        answers: list[Position | Ack | ProtocolViolation] = []
        try:
            while self.rest and self.rest[:1] != b"0":
                raw, self.rest = self.rest[:1], self.rest[1:]
                answers.append(parse_ack(raw))
            while len(self.rest) >= self._length:
                raw, self.rest = self.rest[: self._length], self.rest[self._length :]
                answers.append(parse_position(raw))
        except ProtocolViolation as violation:
            self.rest = b""
            answers.append(violation)
        return answers
