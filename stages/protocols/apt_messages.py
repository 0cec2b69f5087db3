"""Messages of Thorlabs controllers: each is its fields, in the order and with the widths that `layout` says.

The last field of a message is the other end of the line: who is spoken to, or who speaks.  Numbers are
little-endian.  Which examples others have published of each stands in `tests/documented/apt_messages.py`.
"""

from dataclasses import dataclass, fields
from struct import Struct
from typing import ClassVar, Self

from stages.errors import ProtocolViolation
from stages.protocols.apt_words import HEADER, HOST, SHORT, UNASKED, UNIT, VALUES, WITH_DATA, Kind

HEAD = Struct("<H2sBB")  # kind; first and second byte, or the length of the data; to; from
SHORT_LAYOUT = Struct("<BB")  # of what is complete with its header


def header_of(raw: bytes) -> tuple[int, int | None, int, int]:
    """Kind, length of the data if there are any, receiver, sender."""
    kind, length, to, sender = HEAD.unpack(raw[:HEADER])
    return kind, int.from_bytes(length, "little") if to & WITH_DATA else SHORT, to & ~WITH_DATA, sender


def message_bytes(kind: int, data: bytes, to: int, sender: int, is_short: bool) -> bytes:
    """A message that is its header, or one with data behind it."""
    if is_short:
        return HEAD.pack(kind, data, to, sender)
    return HEAD.pack(kind, len(data).to_bytes(2, "little"), to | WITH_DATA, sender) + data


class Message:
    """Base of all messages; `kind` is a field where a class is of several kinds."""

    __slots__ = ()
    layout: ClassVar[Struct]
    by_host: ClassVar[bool] = False
    kind: int

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        *values, place = (getattr(self, each.name) for each in fields(self) if each.name != "kind")  # type: ignore[arg-type]
        to, sender = (place, HOST) if self.by_host else (HOST, place)
        return message_bytes(self.kind, self._pack(*values), to, sender, self.layout is SHORT_LAYOUT)

    @classmethod
    def read(cls, kind: int, data: bytes, place: int) -> Self:
        """Return the message that is made of this data."""
        several = "kind" in (each.name for each in fields(cls))  # type: ignore[arg-type]
        return cls(*([kind] if several else []), *cls._unpack(data), place)  # type: ignore[call-arg]

    @classmethod
    def _pack(cls, *values: int) -> bytes:
        return cls.layout.pack(*values)

    @classmethod
    def _unpack(cls, data: bytes) -> tuple[object, ...]:
        return cls.layout.unpack(data)


@dataclass(frozen=True, slots=True)
class Order(Message):
    """A short message of the host; mostly a question about a channel."""

    layout = SHORT_LAYOUT
    by_host = True
    kind: int
    first: int = 0
    second: int = 0
    to: int = UNIT


@dataclass(frozen=True, slots=True)
class Setting(Message):
    """A number that the host sets for a channel: a position, a distance."""

    layout = Struct("<Hi")
    by_host = True
    kind: int
    channel: int
    value: int
    to: int = UNIT


@dataclass(frozen=True, slots=True)
class SetSpeeds(Message):
    """Speeds and acceleration of the moves to come, in the family's units."""

    layout = Struct("<Hiii")
    by_host = True
    kind = Kind.MOT_SET_VELPARAMS
    channel: int
    minimum: int
    acceleration: int
    maximum: int
    to: int = UNIT


@dataclass(frozen=True, slots=True)
class Reply(Message):
    """A short answer of a box."""

    layout = SHORT_LAYOUT
    kind: int
    first: int
    second: int
    sender: int = UNIT


@dataclass(frozen=True, slots=True)
class Value(Message):
    """A number that a box tells of a channel."""

    layout = Setting.layout
    kind: int
    channel: int
    value: int
    sender: int = UNIT


@dataclass(frozen=True, slots=True)
class Speeds(Message):
    """Speeds and acceleration that are in force."""

    layout = SetSpeeds.layout
    kind = Kind.MOT_GET_VELPARAMS
    channel: int
    minimum: int
    acceleration: int
    maximum: int
    sender: int = UNIT


@dataclass(frozen=True, slots=True)
class Homing(Message):
    """Homing settings of a channel: direction (1 up, 2 down), switch (1 lower, 4 upper)."""

    layout = Struct("<HHHii")
    kind = Kind.MOT_GET_HOMEPARAMS
    channel: int
    direction: int
    switch: int
    speed: int
    offset: int
    sender: int = UNIT


@dataclass(frozen=True, slots=True)
class Status(Message):
    """State of a channel: see the masks of `apt_words`."""

    layout = Struct("<HI")
    kind = Kind.MOT_GET_STATUSBITS
    channel: int
    bits: int
    sender: int = UNIT


@dataclass(frozen=True, slots=True)
class Info(Message):
    """Identity of a controller."""

    layout = Struct("<I8sH3sx60sHHH")
    kind = Kind.HW_GET_INFO
    serial: int
    model: str
    hardware_type: int
    firmware: tuple[int, ...]
    notes: str
    hardware_version: int
    modification: int
    channels: int
    sender: int = UNIT

    @classmethod
    def _pack(cls, serial: int, model: str, hardware: int, firmware: bytes, notes: str, *rest: int) -> bytes:  # type: ignore[override]
        if len(model) > 8 or len(notes) > 60 or len(firmware) != 3:
            raise ValueError(f"{model!r}, {firmware!r} or {notes!r} does not fit into an identity")
        return cls.layout.pack(
            serial, model.encode("ascii"), hardware, bytes(firmware), notes.encode("ascii"), *rest
        )

    @classmethod
    def _unpack(cls, data: bytes) -> tuple[object, ...]:
        serial, model, hardware, firmware, notes, *rest = cls.layout.unpack(data)
        return (serial, text_of(model), hardware, tuple(firmware), text_of(notes), *rest)


@dataclass(frozen=True, slots=True)
class Unasked:
    """Unsolicited message; `data` are the two bytes of a short message, or what follows."""

    kind: int
    data: bytes
    is_short: bool = False
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return message_bytes(self.kind, bytes(self.data), HOST, self.sender, self.is_short)

    @property
    def complaint(self) -> str:
        """The words of an error, or nothing."""
        if self.kind == Kind.HW_RICHRESPONSE:
            code, words = int.from_bytes(self.data[2:4], "little"), self.data[4:].split(b"\0")[0]
            return f"{words.decode('latin-1').strip() or 'an error'} ({code})"
        return "an error" if self.kind == Kind.HW_RESPONSE else ""


COMMANDS = (Order, Setting, SetSpeeds)
Command = Order | Setting | SetSpeeds
ANSWERS = (Reply, Value, Speeds, Homing, Status, Info, Unasked)
Answer = Reply | Value | Speeds | Homing | Status | Info | Unasked


def parse_command(raw: bytes) -> Command:
    """Read one whole message of the host."""
    kind, length, to, _ = header_of(raw)
    if length is SHORT:
        return Order.read(kind, raw[2:4], to)
    return (SetSpeeds if kind == SetSpeeds.kind else Setting).read(kind, raw[HEADER:], to)


def parse_answer(raw: bytes) -> Answer:
    """Read one whole message of a box.

    Raises
    ------
    ProtocolViolation
        Its data cannot be what it says.
    """
    kind, length, _, sender = header_of(raw)
    is_short = length is SHORT
    data = raw[2:4] if is_short else raw[HEADER:]
    if kind in UNASKED:
        return Unasked(kind, data, is_short, sender)
    if is_short:
        return Reply.read(kind, data, sender)
    if kind in VALUES:
        return Value.read(kind, data, sender)
    known: dict[int, type[Speeds | Homing | Status | Info]] = {
        each.kind: each for each in (Speeds, Homing, Status, Info)
    }
    return known[kind].read(kind, data, sender)


def text_of(raw: bytes) -> str:
    """Text up to the first NUL; printable ASCII only."""
    text = raw.split(b"\0")[0]
    if any(byte < 0x20 or byte > 0x7E for byte in text):
        raise ProtocolViolation("a name holds bytes that are not text", raw)
    return text.decode("ascii")
