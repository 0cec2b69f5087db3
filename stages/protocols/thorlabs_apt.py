"""Thorlabs APT: the binary language of T-Cubes, K-Cubes, LTS stages and BSC or BBD racks.

115200 8N1. Every message begins with six bytes,

    id (2)   first (1)   second (1)    to (1)          from (1)           a short message, complete
    id (2)   length (2)                to | 0x80 (1)   from (1)   data    a message with data

numbers little-endian. The host is 0x01, a unit of its own (cube, LTS) 0x50, the motherboard of a rack 0x11 and
its bays 0x21 to 0x2A. A unit has channels 1, 2, ..; a bay has channel 1 only.

There is no checksum, no number that ties an answer to its question, and no byte that begins a message. What guards
the border is exactness: the id is known, its form and length are the only ones it has, it goes to the host and
comes from a place where a unit can be. Anything else is a violation, and everything read so far is thrown away
with it, because it is not known where the next message begins.

Boxes speak unasked: of the end of a motion (0x0464, 0x0466, 0x0444), of their state ten times a second if
that was asked for (0x0481, 0x0491), and of errors (0x0080, 0x0081). All of these are `Unasked`.

Sources: Thorlabs, "APT Controllers Host-Controller Communications Protocol", issue 23 (2018), as its open readers
tell it; each example names its own. None of it was confirmed on hardware by this project.
"""

from stages.errors import ProtocolViolation
from stages.protocols.apt_messages import (
    ANSWERS,
    COMMANDS,
    HEAD,
    Answer,
    Command,
    Homing,
    Info,
    Order,
    Reply,
    SetSpeeds,
    Setting,
    Speeds,
    Status,
    Unasked,
    Value,
    header_of,
    parse_answer,
    parse_command,
)
from stages.protocols.apt_words import (
    HEADER,
    HOST,
    LENGTHS_OF_ANSWERS,
    LENGTHS_OF_COMMANDS,
    SPEAKERS,
    UNASKED,
    WITH_DATA,
    Kind,
)

__all__ = [
    "ANSWERS", "COMMANDS", "NO_SENDER", "Answer", "AnswerStream", "Command", "CommandStream", "Homing",
    "IdentityStream", "Info", "Order", "Reply", "SetSpeeds", "Setting", "Speeds", "Status", "Unasked", "Value",
]  # fmt: skip

NO_SENDER = 0x00  # sender of some boxes' unasked messages, as thorlabs-apt-device has met them
LONGEST_COMMAND = 255


class AnswerStream:
    """Bytes of a box to answers; what cannot be one ends everything read so far."""

    def __init__(self) -> None:
        self.rest = b""

    def feed(self, chunk: bytes) -> list[Answer | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        self.rest += chunk
        found: list[Answer | ProtocolViolation] = []
        try:
            while len(self.rest) >= HEADER and len(self.rest) >= (size := self._size()):
                raw, self.rest = self.rest[:size], self.rest[size:]
                found.append(parse_answer(raw))
        except ProtocolViolation as violation:
            self.rest = b""
            found.append(violation)
        return found

    def _size(self) -> int:
        """Length of the message that begins here; only one that its kind may have is believed."""
        kind, length, to, sender = header_of(self.rest)
        if length not in LENGTHS_OF_ANSWERS.get(kind, ()):
            raise ProtocolViolation("not a message of an APT box", self.rest[:HEADER])
        if to != HOST or (sender not in SPEAKERS and not (kind in UNASKED and sender == NO_SENDER)):
            raise ProtocolViolation("an APT message between others", self.rest[:HEADER])
        return HEADER + (length or 0)


class IdentityStream:
    """Looks for what a box says of itself, wherever it stands: before it, the rest of a message may have come.

    Parameters
    ----------
    sender : int
        Whose words they must be.
    """

    def __init__(self, sender: int) -> None:
        self._head = HEAD.pack(Kind.HW_GET_INFO, Info.layout.size.to_bytes(2, "little"), HOST | WITH_DATA, sender)
        self._behind: AnswerStream | None = None
        self._before = b""

    @property
    def rest(self) -> bytes:
        """Bytes that are no whole message yet."""
        return self._before if self._behind is None else self._behind.rest

    def feed(self, chunk: bytes) -> list[Answer | ProtocolViolation]:
        """Add bytes; return what is complete now, from the identity on."""
        if self._behind is None:
            self._before += chunk
            place = self._before.find(self._head)
            if place < 0:
                self._before = self._before[1 - len(self._head) :]
                return []
            chunk, self._before, self._behind = self._before[place:], b"", AnswerStream()
        return self._behind.feed(chunk)


class CommandStream:
    """Bytes of a host to commands; as in firmware, what is unknown is skipped by the length that it tells."""

    def __init__(self) -> None:
        self.rest = b""

    def feed(self, chunk: bytes) -> list[Command | ProtocolViolation]:
        """Add bytes; return what is complete now."""
        self.rest += chunk
        found: list[Command | ProtocolViolation] = []
        while len(self.rest) >= HEADER:
            kind, length, to, sender = header_of(self.rest)
            if to not in SPEAKERS or sender != HOST or (length or 0) > LONGEST_COMMAND:
                found.append(ProtocolViolation("not for an APT box", self.rest[:HEADER]))
                self.rest = self.rest[1:]
                continue
            size = HEADER + (length or 0)
            if len(self.rest) < size:
                break
            raw, self.rest = self.rest[:size], self.rest[size:]
            known = length in LENGTHS_OF_COMMANDS.get(kind, ())
            found.append(parse_command(raw) if known else ProtocolViolation("an unknown APT message", raw))
        return found
