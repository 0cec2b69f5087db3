"""Byte layout of messages of Thorlabs controllers: header, numbers, text. Numbers are little-endian."""

from stages.errors import ProtocolViolation
from stages.protocols.apt_words import SHORT, WITH_DATA


def header_of(raw: bytes) -> tuple[int, int | None, int, int]:
    """Kind, length of the data if there are any, receiver, sender."""
    has_data = raw[4] & WITH_DATA
    return read_unsigned(raw[:2]), read_unsigned(raw[2:4]) if has_data else SHORT, raw[4] & ~WITH_DATA, raw[5]


def short_message(kind: int, first: int, second: int, to: int, sender: int) -> bytes:
    """A message that is its header."""
    return number_bytes(kind, 2) + bytes((first, second, to, sender))


def long_message(kind: int, data: bytes, to: int, sender: int) -> bytes:
    """A message with data behind its header."""
    return number_bytes(kind, 2) + number_bytes(len(data), 2) + bytes((to | WITH_DATA, sender)) + data


def number_bytes(value: int, size: int) -> bytes:
    """An unsigned number."""
    return int(value).to_bytes(size, "little")


def to_signed_bytes(value: int) -> bytes:
    """A signed number of four bytes."""
    return value.to_bytes(4, "little", signed=True)


def pad_text(text: str, size: int) -> bytes:
    """Text filled up with NUL; ValueError if it is longer."""
    if len(text) > size:
        raise ValueError(f"{text!r} has more than {size} characters")
    return text.encode("ascii").ljust(size, b"\0")


def read_unsigned(raw: bytes) -> int:
    """An unsigned number."""
    return int.from_bytes(raw, "little")


def read_signed(raw: bytes) -> int:
    """A signed number."""
    return int.from_bytes(raw, "little", signed=True)


def text_of(raw: bytes) -> str:
    """Text up to the first NUL; printable ASCII only."""
    text = raw.split(b"\0")[0]
    if any(byte < 0x20 or byte > 0x7E for byte in text):
        raise ProtocolViolation("a name holds bytes that are not text", raw)
    return text.decode("ascii")
