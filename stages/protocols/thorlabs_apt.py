"""Thorlabs APT: the binary language of T-Cubes, K-Cubes, LTS stages and BSC or BBD racks.

115200 8N1. Every message begins with six bytes,

    id (2)   first (1)   second (1)    to (1)          from (1)           a short message, complete
    id (2)   length (2)                to | 0x80 (1)   from (1)   data    a message with data

numbers little-endian. The host is 0x01, a unit of its own (cube, LTS) 0x50, the motherboard of a rack 0x11 and
its bays 0x21 to 0x2A. A unit has channels 1, 2, ..; a bay has channel 1 only.

There is no checksum, no number that ties an answer to its question, and no byte that begins a message. What guards
the border is exactness: the id is known, its form and length are the only ones it has, it goes to the host and
comes from a place where a unit can be. Anything else is a violation, and everything read so far is thrown away
with it, because nobody knows where the next message begins.

Boxes speak unasked: of the end of a motion (0x0464, 0x0466, 0x0444), of their state ten times a second if
somebody has asked for that (0x0481, 0x0491), and of errors (0x0080, 0x0081). All of these are `Unasked`.

Sources: Thorlabs, "APT Controllers Host-Controller Communications Protocol", issue 23 (2018), as its open readers
tell it; each example names its own. None of it was confirmed on hardware by this project.
"""

from dataclasses import dataclass

from stages.errors import ProtocolViolation
from stages.protocols.apt_words import (
    ENABLED,
    FIRST_BAY,
    HEADER,
    HOMED,
    HOST,
    LENGTHS_OF_ANSWERS,
    LENGTHS_OF_COMMANDS,
    LOWER_SWITCH,
    OFF,
    ON,
    RACK,
    SHORT,
    SPEAKERS,
    UNASKED,
    UNIT,
    VALUES,
    WITH_DATA,
    Kind,
)
from stages.protocols.framing import Example

PROTOCOL = "thorlabs-apt-protocol 29"  # MIT; the functions and parsers of this name
PUBLISHED = "InstrumentKit tests/test_thorlabs"  # dialogues of its tests
MANUAL = "Thorlabs, APT Communications Protocol, the sample of this message, as the tests of pnpq quote it"
RECORDED = "a K10CR1, as the tests of pnpq quote it"
CLIENTS = "a test of an open KDC101 client"
NOBODY = 0x00  # sender of some boxes' unasked messages, as thorlabs-apt-device has met them
LONGEST_COMMAND = 255


@dataclass(frozen=True, slots=True)
class Order:
    """A short message of the host; mostly a question about a channel."""

    kind: int
    first: int = 0
    second: int = 0
    to: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _short(self.kind, self.first, self.second, self.to, HOST)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        return (
            Example(b"\x43\x04\x01\x00\x50\x01", cls(Kind.MOT_MOVE_HOME, 1), CLIENTS),
            Example(
                b"\x65\x04\x01\x02\x22\x01", cls(Kind.MOT_MOVE_STOP, 1, 2, 0x22), f"{PROTOCOL}, mot_move_stop"
            ),
            Example(b"\x10\x02\x01\x01\x50\x01", cls(Kind.MOD_SET_CHANENABLESTATE, 1, ON), CLIENTS),
            Example(b"\x05\x00\x00\x00\x11\x01", cls(Kind.HW_REQ_INFO, to=RACK), f"{PROTOCOL}, hw_req_info"),
        )


@dataclass(frozen=True, slots=True)
class Setting:
    """A number that the host sets for a channel: a position, a distance."""

    kind: int
    channel: int
    value: int
    to: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _long(self.kind, _number(self.channel, 2) + _signed(self.value), self.to, HOST)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        return (
            Example(
                b"\x53\x04\x06\x00\xa2\x01\x01\x00\x40\x0d\x03\x00",
                cls(Kind.MOT_MOVE_ABSOLUTE, 1, 200_000, 0x22),
                MANUAL,
            ),
            Example(
                b"\x53\x04\x06\x00\xd0\x01\x01\x00\xfb\x86\x00\x00",
                cls(Kind.MOT_MOVE_ABSOLUTE, 1, 34555),
                "two open clients: 1 mm of a Z8 stage",
            ),
            Example(
                b"\x48\x04\x06\x00\xd0\x01\x01\x00\x18\xfc\xff\xff",
                cls(Kind.MOT_MOVE_RELATIVE, 1, -1000),
                f"{PUBLISHED}, test_apt_mc_move",
            ),
            Example(
                b"\x3a\x04\x06\x00\xa3\x01\x01\x00\x00\x00\x00\x00",
                cls(Kind.MOT_SET_GENMOVEPARAMS, 1, 0, 0x23),
                f"{PROTOCOL}, mot_set_genmoveparams",
            ),
        )


@dataclass(frozen=True, slots=True)
class SetSpeeds:
    """Speeds and acceleration of the moves to come, in the family's units."""

    channel: int
    minimum: int
    acceleration: int
    maximum: int
    to: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _long(Kind.MOT_SET_VELPARAMS, _speeds(self), self.to, HOST)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        raw = b"\x13\x04\x0e\x00\xa1\x01\x01\x00\x07\x00\x00\x00\x9a\x11\x00\x00\x00\x80\x4f\x01"
        sample = bytes.fromhex("1304 0E00 A201 0100 00000000 B0350000 CDCCCC00")
        return (
            Example(sample, cls(1, 0, 0x35B0, 0xCCCCCD, 0x22), MANUAL),
            Example(
                raw, cls(1, 7, 4506, 21987328, FIRST_BAY), f"{PROTOCOL}, mot_set_velparams: 1 mm/s of a DRV250"
            ),
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
        return _short(self.kind, self.first, self.second, HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        return (
            Example(
                b"\x12\x02\x01\x02\x01\x50",
                cls(Kind.MOD_GET_CHANENABLESTATE, 1, OFF),
                f"{PUBLISHED}, test_apt_mc_enabled, with the addresses of a real box",
            ),
            Example(
                b"\x61\x00\x02\x01\x01\x11",
                cls(Kind.RACK_GET_BAYUSED, 2, ON, RACK),
                f"{PROTOCOL}, rack_get_bayused",
            ),
        )


@dataclass(frozen=True, slots=True)
class Value:
    """A number that a box tells of a channel."""

    kind: int
    channel: int
    value: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _long(self.kind, _number(self.channel, 2) + _signed(self.value), HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        return (
            Example(
                b"\x12\x04\x06\x00\x81\x50\x01\x00\xe0\xb1\xff\xff",
                cls(Kind.MOT_GET_POSCOUNTER, 1, -20000),
                f"{PUBLISHED}, test_apt_mc_position, with the addresses of a real box",
            ),
            Example(
                b"\x47\x04\x06\x00\x81\x22\x01\x00\x00\x01\x00\x00",
                cls(Kind.MOT_GET_MOVERELPARAMS, 1, 256, 0x22),
                f"{PROTOCOL}, mot_get_moverelparams",
            ),
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
        return _long(Kind.MOT_GET_VELPARAMS, _speeds(self), HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        raw = b"\x15\x04\x0e\x00\x81\x50\x01\x00\x07\x00\x00\x00\x06\x01\x00\x00\x87\xb5\x0b\x00"
        return (Example(raw, cls(1, 7, 262, 767367), f"{PROTOCOL}, mot_get_velparams: 1 mm/s of an MTS50"),)


@dataclass(frozen=True, slots=True)
class Homing:
    """How a channel looks for its reference: direction (1 up, 2 down), switch (1 lower, 4 upper)."""

    channel: int
    direction: int
    switch: int
    speed: int
    offset: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return _long(Kind.MOT_GET_HOMEPARAMS, _homing(self), HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        raw = b"\x42\x04\x0e\x00\x81\x50\x01\x00\x02\x00\x01\x00\x87\xb5\x0b\x00\x38\xff\xff\xff"
        return (Example(raw, cls(1, 2, 1, 767367, -200), f"{PROTOCOL}, mot_get_homeparams"),)


@dataclass(frozen=True, slots=True)
class Status:
    """What a channel does: see the masks of this module."""

    channel: int
    bits: int
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        data = _number(self.channel, 2) + _number(self.bits, 4)
        return _long(Kind.MOT_GET_STATUSBITS, data, HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        raw = b"\x2a\x04\x06\x00\x81\x50\x01\x00\x02\x05\x00\x80"
        return (Example(raw, cls(1, ENABLED | HOMED | 0x0100 | LOWER_SWITCH), f"{PROTOCOL}, mot_get_statusbits"),)


@dataclass(frozen=True, slots=True)
class Info:
    """What a box says of itself."""

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
            _number(self.serial, 4) + _padded(self.model, 8) + _number(self.hardware_type, 2)
            + bytes((minor, interim, major, 0)) + _padded(self.notes, 60)
            + _number(self.hardware_version, 2) + _number(self.modification, 2) + _number(self.channels, 2)
        )  # fmt: skip
        return _long(Kind.HW_GET_INFO, data, HOST, self.sender)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        raw = (
            b"\x06\x00\x54\x00\x81\x50" + b"\x01\x02\x03\x04" + b"KDC101\x00\x00"
            + b"\x10\x00\xa1\xa2\xa3\x00" + b"abcdefg".ljust(60, b"\x00") + b"\x2a\x00\x2b\x00\x01\x00"
        )  # fmt: skip
        message = cls(0x04030201, "KDC101", 16, (0xA1, 0xA2, 0xA3), "abcdefg", 42, 43, 1)
        sample = bytes.fromhex("0600 5400 8122 89539A05 494F4E3030312000 2C00 02013900") + bytes(60)
        sample += bytes.fromhex("0100 0300 0100")
        return (
            Example(raw, message, f"{PUBLISHED}, init_kdc101"),
            Example(sample, cls(94_000_009, "ION001 ", 44, (2, 1, 57), "", 1, 3, 1, 0x22), MANUAL),
        )


@dataclass(frozen=True, slots=True)
class Unasked:
    """What a box says without having been asked; `data` are the two bytes of a short message, or what follows."""

    kind: int
    data: bytes
    is_short: bool = False
    sender: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        data = bytes(self.data)
        if self.is_short:
            return _short(self.kind, data[0], data[1], HOST, self.sender)
        return _long(self.kind, data, HOST, self.sender)

    @property
    def complaint(self) -> str:
        """The words of an error, or nothing."""
        if self.kind == Kind.HW_RICHRESPONSE:
            code, words = int.from_bytes(self.data[2:4], "little"), self.data[4:].split(b"\0")[0]
            return f"{words.decode('latin-1').strip() or 'an error'} ({code})"
        return "an error" if self.kind == Kind.HW_RESPONSE else ""

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Documented messages."""
        moved = b"\x01\x00\xe8\x03\x00\x00\xcd\x00\x00\x00\x00\x00\x00\x00"
        return (
            Example(
                b"\x44\x04\x01\x00\x01\x50",
                cls(Kind.MOT_MOVE_HOMED, b"\x01\x00", True),
                f"{PUBLISHED}, test_apt_mc_go_home, with the addresses of a real box",
            ),
            Example(
                b"\x64\x04\x0e\x00\x81\x22" + moved,
                cls(Kind.MOT_MOVE_COMPLETED, moved, False, 0x22),
                f"{PUBLISHED}, test_apt_mc_move, from the second bay",
            ),
            Example(
                bytes.fromhex("6404 0e00 8150 0100 68aaa001 0000 0000 30000080"),
                cls(Kind.MOT_MOVE_COMPLETED, bytes.fromhex("0100 68aaa001 0000 0000 30000080")),
                RECORDED,
            ),
            Example(b"\x64\x04\x01\x00\x01\x22", cls(Kind.MOT_MOVE_COMPLETED, b"\1\0", True, 0x22), MANUAL),
        )


COMMANDS = (Order, Setting, SetSpeeds)
ANSWERS = (Reply, Value, Speeds, Homing, Status, Info, Unasked)
Command = Order | Setting | SetSpeeds
Answer = Reply | Value | Speeds | Homing | Status | Info | Unasked


def parse_answer(raw: bytes) -> Answer:
    """Read one whole message of a box.

    Raises
    ------
    ProtocolViolation
        Its data cannot be what it says.
    """
    kind, sender, data = _uint(raw[:2]), raw[5], raw[HEADER:]
    is_short = not raw[4] & WITH_DATA
    if kind in UNASKED:
        return Unasked(kind, raw[2:4] if is_short else data, is_short, sender)
    if is_short:
        return Reply(kind, raw[2], raw[3], sender)
    if kind == Kind.HW_GET_INFO:
        return Info(
            _uint(data[:4]), _text(data[4:12]), _uint(data[12:14]), tuple(data[14:17]), _text(data[18:78]),
            _uint(data[78:80]), _uint(data[80:82]), _uint(data[82:84]), sender,
        )  # fmt: skip
    channel = _uint(data[:2])
    if kind in VALUES:
        return Value(kind, channel, _int(data[2:6]), sender)
    if kind == Kind.MOT_GET_STATUSBITS:
        return Status(channel, _uint(data[2:6]), sender)
    if kind == Kind.MOT_GET_VELPARAMS:
        return Speeds(channel, _int(data[2:6]), _int(data[6:10]), _int(data[10:14]), sender)
    return Homing(channel, _uint(data[2:4]), _uint(data[4:6]), _int(data[6:10]), _int(data[10:14]), sender)


def parse_command(raw: bytes) -> Command:
    """Read one whole message of the host."""
    kind, to, data = _uint(raw[:2]), raw[4] & ~WITH_DATA, raw[HEADER:]
    if not raw[4] & WITH_DATA:
        return Order(kind, raw[2], raw[3], to)
    channel = _uint(data[:2])
    if kind == Kind.MOT_SET_VELPARAMS:
        return SetSpeeds(channel, _int(data[2:6]), _int(data[6:10]), _int(data[10:14]), to)
    return Setting(kind, channel, _int(data[2:6]), to)


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
        kind, length, to, sender = _header(self.rest)
        if length not in LENGTHS_OF_ANSWERS.get(kind, ()):
            raise ProtocolViolation("not a message of an APT box", self.rest[:HEADER])
        if to != HOST or (sender not in SPEAKERS and not (kind in UNASKED and sender == NOBODY)):
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
        self._head = _number(Kind.HW_GET_INFO, 2) + _number(84, 2) + bytes((HOST | WITH_DATA, sender))
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
            kind, length, to, sender = _header(self.rest)
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


def _header(raw: bytes) -> tuple[int, int | None, int, int]:
    """Kind, length of the data if there are any, receiver, sender."""
    has_data = raw[4] & WITH_DATA
    return _uint(raw[:2]), _uint(raw[2:4]) if has_data else SHORT, raw[4] & ~WITH_DATA, raw[5]


def _short(kind: int, first: int, second: int, to: int, sender: int) -> bytes:
    return _number(kind, 2) + bytes((first, second, to, sender))


def _long(kind: int, data: bytes, to: int, sender: int) -> bytes:
    return _number(kind, 2) + _number(len(data), 2) + bytes((to | WITH_DATA, sender)) + data


def _speeds(message: SetSpeeds | Speeds) -> bytes:
    numbers = (message.minimum, message.acceleration, message.maximum)
    return _number(message.channel, 2) + b"".join(map(_signed, numbers))


def _homing(message: Homing) -> bytes:
    head = (message.channel, message.direction, message.switch)
    return b"".join(_number(number, 2) for number in head) + _signed(message.speed) + _signed(message.offset)


def _number(value: int, size: int) -> bytes:
    return int(value).to_bytes(size, "little")


def _signed(value: int) -> bytes:
    return value.to_bytes(4, "little", signed=True)


def _padded(text: str, size: int) -> bytes:
    if len(text) > size:
        raise ValueError(f"{text!r} has more than {size} characters")
    return text.encode("ascii").ljust(size, b"\0")


def _uint(raw: bytes) -> int:
    return int.from_bytes(raw, "little")


def _int(raw: bytes) -> int:
    return int.from_bytes(raw, "little", signed=True)


def _text(raw: bytes) -> str:
    """Text up to the first NUL; printable ASCII only."""
    text = raw.split(b"\0")[0]
    if any(byte < 0x20 or byte > 0x7E for byte in text):
        raise ProtocolViolation("a name holds bytes that are not text", raw)
    return text.decode("ascii")
