"""Messages of Thorlabs controllers; each with examples that others have published."""

from dataclasses import dataclass

from stages.protocols.apt_bytes import (
    long_message,
    number_bytes,
    pad_text,
    read_signed,
    read_unsigned,
    short_message,
    text_of,
    to_signed_bytes,
)
from stages.protocols.apt_commands import speed_bytes
from stages.protocols.apt_words import (
    HEADER,
    HOST,
    UNASKED,
    UNIT,
    VALUES,
    WITH_DATA,
    Kind,
)


@dataclass(frozen=True, slots=True)
class Reply:
    """A short answer of a box."""

    kind: int
    first: int
    second: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return short_message(self.kind, self.first, self.second, HOST, self.sender)


@dataclass(frozen=True, slots=True)
class Value:
    """A number that a box tells of a channel."""

    kind: int
    channel: int
    value: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return long_message(
            self.kind, number_bytes(self.channel, 2) + to_signed_bytes(self.value), HOST, self.sender
        )


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds and acceleration that are in force."""

    channel: int
    minimum: int
    acceleration: int
    maximum: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return long_message(
            Kind.MOT_GET_VELPARAMS,
            speed_bytes(self.channel, self.minimum, self.acceleration, self.maximum),
            HOST,
            self.sender,
        )


@dataclass(frozen=True, slots=True)
class Homing:
    """Homing settings of a channel: direction (1 up, 2 down), switch (1 lower, 4 upper)."""

    channel: int
    direction: int
    switch: int
    speed: int
    offset: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        head = (self.channel, self.direction, self.switch)
        data = b"".join(number_bytes(number, 2) for number in head)
        data += to_signed_bytes(self.speed) + to_signed_bytes(self.offset)
        return long_message(Kind.MOT_GET_HOMEPARAMS, data, HOST, self.sender)


@dataclass(frozen=True, slots=True)
class Status:
    """State of a channel: see the masks of this module."""

    channel: int
    bits: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        data = number_bytes(self.channel, 2) + number_bytes(self.bits, 4)
        return long_message(Kind.MOT_GET_STATUSBITS, data, HOST, self.sender)


@dataclass(frozen=True, slots=True)
class Info:
    """Identity of a controller."""

    serial: int
    model: str
    hardware_type: int
    firmware: tuple[int, ...]
    notes: str
    hardware_version: int
    modification: int
    channels: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        minor, interim, major = self.firmware
        data = (
            number_bytes(self.serial, 4) + pad_text(self.model, 8) + number_bytes(self.hardware_type, 2)
            + bytes((minor, interim, major, 0)) + pad_text(self.notes, 60)
            + number_bytes(self.hardware_version, 2) + number_bytes(self.modification, 2)
            + number_bytes(self.channels, 2)
        )  # fmt: skip
        return long_message(Kind.HW_GET_INFO, data, HOST, self.sender)


@dataclass(frozen=True, slots=True)
class Unasked:
    """Unsolicited message; `data` are the two bytes of a short message, or what follows."""

    kind: int
    data: bytes
    is_short: bool = False
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        data = bytes(self.data)
        if self.is_short:
            return short_message(self.kind, data[0], data[1], HOST, self.sender)
        return long_message(self.kind, data, HOST, self.sender)

    @property
    def complaint(self) -> str:
        """The words of an error, or nothing."""
        if self.kind == Kind.HW_RICHRESPONSE:
            code, words = int.from_bytes(self.data[2:4], "little"), self.data[4:].split(b"\0")[0]
            return f"{words.decode('latin-1').strip() or 'an error'} ({code})"
        return "an error" if self.kind == Kind.HW_RESPONSE else ""


ANSWERS = (Reply, Value, Speeds, Homing, Status, Info, Unasked)
Answer = Reply | Value | Speeds | Homing | Status | Info | Unasked


def parse_answer(raw: bytes) -> Answer:
    """Read one whole message of a box.

    Raises
    ------
    ProtocolViolation
        Its data cannot be what it says.
    """
    kind, sender, data = read_unsigned(raw[:2]), raw[5], raw[HEADER:]
    is_short = not raw[4] & WITH_DATA
    if kind in UNASKED:
        return Unasked(kind, raw[2:4] if is_short else data, is_short, sender)
    if is_short:
        return Reply(kind, raw[2], raw[3], sender)
    if kind == Kind.HW_GET_INFO:
        return Info(
            read_unsigned(data[:4]), text_of(data[4:12]), read_unsigned(data[12:14]), tuple(data[14:17]),
            text_of(data[18:78]), read_unsigned(data[78:80]), read_unsigned(data[80:82]),
            read_unsigned(data[82:84]), sender,
        )  # fmt: skip
    channel = read_unsigned(data[:2])
    if kind in VALUES:
        return Value(kind, channel, read_signed(data[2:6]), sender)
    if kind == Kind.MOT_GET_STATUSBITS:
        return Status(channel, read_unsigned(data[2:6]), sender)
    if kind == Kind.MOT_GET_VELPARAMS:
        return Speeds(channel, read_signed(data[2:6]), read_signed(data[6:10]), read_signed(data[10:14]), sender)
    return Homing(
        channel,
        read_unsigned(data[2:4]),
        read_unsigned(data[4:6]),
        read_signed(data[6:10]),
        read_signed(data[10:14]),
        sender,
    )
