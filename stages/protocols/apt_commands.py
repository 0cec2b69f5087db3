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
from stages.protocols.apt_words import HEADER, HOST, UNIT, WITH_DATA, Kind


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
