"""Micro-Manager's pulse generator: a Teensy, or another Arduino-like board, with one input and one output.

115200 8N1, binary. The host says five bytes, a command and a number of 32 bits, or two bytes that ask for a state:

    <command> <number, least byte first>        255 <command>

and the board answers five bytes, the command and a number. Commands:

    0  version                  1  start                     2  stop; answers the pulses that were sent since start
    3  interval in us           4  length of a pulse in us   5  wait for the input before each pulse, 0 or 1
    6  number of pulses, 0: until it is stopped

The text of the firmware calls the numbers big endian; its code reads and writes them least byte first, and so do
its clients. Source: the firmware TeensyPulseGenerator of Micro-Manager, version 1.
"""

import struct
from dataclasses import dataclass

from stages.errors import ProtocolViolation

VERSION, START, STOP, INTERVAL_US, LENGTH_US, WAITS, PULSES = range(7)
ASK = 255
_NUMBERED = struct.Struct("<BI")


@dataclass(frozen=True, slots=True)
class Command:
    """A command with its number."""

    code: int
    number: int = 0

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _NUMBERED.pack(self.code, self.number)


@dataclass(frozen=True, slots=True)
class Question:
    """The state behind a command."""

    code: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return bytes((ASK, self.code))


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer of the board to either."""

    code: int
    number: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _NUMBERED.pack(self.code, self.number)


COMMANDS = (Command, Question)
ANSWERS = (Reply,)


class CommandStream:
    """Bytes of a host to commands; the board knows no end of a command but its length."""

    def __init__(self) -> None:
        self._rest = b""

    @property
    def rest(self) -> bytes:
        """Bytes of a command that is not complete."""
        return self._rest

    def feed(self, chunk: bytes) -> list[Command | Question]:
        """Add bytes; return what is complete now."""
        self._rest += chunk
        found: list[Command | Question] = []
        while self._rest:
            length = 2 if self._rest[0] == ASK else _NUMBERED.size
            if len(self._rest) < length:
                break
            raw, self._rest = self._rest[:length], self._rest[length:]
            found.append(Question(raw[1]) if length == 2 else Command(*_NUMBERED.unpack(raw)))
        return found


class AnswerStream:
    """Bytes of a board to replies."""

    def __init__(self) -> None:
        self._rest = b""

    @property
    def rest(self) -> bytes:
        """Bytes of a reply that is not complete."""
        return self._rest

    def feed(self, chunk: bytes) -> list[Reply | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        self._rest += chunk
        found: list[Reply | ProtocolViolation] = []
        while len(self._rest) >= _NUMBERED.size:
            raw, self._rest = self._rest[: _NUMBERED.size], self._rest[_NUMBERED.size :]
            if raw[0] > PULSES:
                self._rest = b""
                return [*found, ProtocolViolation("not a reply of a pulse box", raw)]
            found.append(Reply(*_NUMBERED.unpack(raw)))
        return found
