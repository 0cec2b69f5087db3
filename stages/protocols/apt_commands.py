"""Commands to Thorlabs controllers; each with examples that others have published."""

from dataclasses import dataclass

from stages.protocols.apt_bytes import (
    long_message,
    number_bytes,
    read_signed,
    read_unsigned,
    short_message,
    to_signed_bytes,
)
from stages.protocols.apt_words import FIRST_BAY, HEADER, HOST, ON, RACK, UNIT, WITH_DATA, Kind
from stages.protocols.framing import Example

PROTOCOL = "thorlabs-apt-protocol 29"  # MIT; the functions and parsers of this name
PUBLISHED = "InstrumentKit tests/test_thorlabs"  # dialogues of its tests
MANUAL = "Thorlabs, APT Communications Protocol, the sample of this message, as the tests of pnpq quote it"
CLIENTS = "a test of an open KDC101 client"


@dataclass(frozen=True, slots=True)
class Order:
    """A short message of the host; mostly a question about a channel."""

    kind: int
    first: int = 0
    second: int = 0
    to: int = UNIT

    def to_bytes(self) -> bytes:
        """Bytes as they go over the wire."""
        return short_message(self.kind, self.first, self.second, self.to, HOST)

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
            Example(
                b"\x18\x00\x00\x00\x50\x01",
                cls(Kind.HW_NO_FLASH_PROGRAMMING),
                f"{PROTOCOL}, hw_no_flash_programming",
            ),
            Example(
                b"\x92\x04\x00\x00\x50\x01",
                cls(Kind.MOT_ACK_DCSTATUSUPDATE),
                f"{PROTOCOL}, mot_ack_dcstatusupdate",
            ),
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
        return long_message(self.kind, number_bytes(self.channel, 2) + to_signed_bytes(self.value), self.to, HOST)

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
        return long_message(
            Kind.MOT_SET_VELPARAMS,
            speed_bytes(self.channel, self.minimum, self.acceleration, self.maximum),
            self.to,
            HOST,
        )

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


COMMANDS = (Order, Setting, SetSpeeds)
Command = Order | Setting | SetSpeeds


def parse_command(raw: bytes) -> Command:
    """Read one whole message of the host."""
    kind, to, data = read_unsigned(raw[:2]), raw[4] & ~WITH_DATA, raw[HEADER:]
    if not raw[4] & WITH_DATA:
        return Order(kind, raw[2], raw[3], to)
    channel = read_unsigned(data[:2])
    if kind == Kind.MOT_SET_VELPARAMS:
        return SetSpeeds(channel, read_signed(data[2:6]), read_signed(data[6:10]), read_signed(data[10:14]), to)
    return Setting(kind, channel, read_signed(data[2:6]), to)


def speed_bytes(channel: int, minimum: int, acceleration: int, maximum: int) -> bytes:
    """Data of speeds, as they are set and as they are reported."""
    return number_bytes(channel, 2) + b"".join(map(to_signed_bytes, (minimum, acceleration, maximum)))
