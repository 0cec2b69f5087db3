"""GigE Vision control protocol: datagrams to requests, answers to datagrams.  No sockets, no state.

Header, big-endian: key 0x42, flags, command, length of what follows, request id.  An acknowledge starts with a
status instead of key and flags.  A datagram is refused, never trusted: its length field must equal what arrived.

Source: AIA, GigE Vision specification 1.2, chapters 16 to 18.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

PORT = 3956
KEY = 0x42
HEADER = struct.Struct(">BBHHH")
MAX_MEMORY_BYTES = 536


class Command(IntEnum):
    """Requests that this device understands; each acknowledge has the next number."""

    DISCOVERY = 0x0002
    RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086


class Status(IntEnum):
    """Status codes of an acknowledge."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    PACKET_UNAVAILABLE = 0x800C


@dataclass(frozen=True, slots=True)
class Request:
    """A well-formed request; the command may still be unknown."""

    command: int
    wants_answer: bool
    number: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Resend:
    """Ask for packets of one block again."""

    block_id: int
    first: int
    last: int


def parse(datagram: bytes) -> Request | None:
    """Return the request in a datagram, or None if it is none."""
    if len(datagram) < HEADER.size:
        return None
    key, flags, command, length, number = HEADER.unpack_from(datagram)
    if key != KEY or length != len(datagram) - HEADER.size:
        return None
    return Request(command, bool(flags & 1), number, datagram[HEADER.size :])


def acknowledge(request: Request, status: Status, payload: bytes = b"") -> bytes:
    """Build the answer to a request."""
    body = payload if status is Status.SUCCESS else b""
    return struct.pack(">HHHH", status, request.command + 1, len(body), request.number) + body


def read_addresses(payload: bytes) -> tuple[int, ...] | None:
    """Addresses of a READREG request; None if malformed."""
    if not payload or len(payload) % 4 or len(payload) > MAX_MEMORY_BYTES:
        return None
    return struct.unpack(f">{len(payload) // 4}I", payload)


def write_pairs(payload: bytes) -> tuple[tuple[int, bytes], ...] | None:
    """(address, four bytes) of a WRITEREG request; None if malformed."""
    if not payload or len(payload) % 8 or len(payload) > MAX_MEMORY_BYTES:
        return None
    return tuple(
        (int.from_bytes(payload[at : at + 4], "big"), payload[at + 4 : at + 8]) for at in range(0, len(payload), 8)
    )


def read_block(payload: bytes) -> tuple[int, int] | None:
    """Address and count of a READMEM request; None if malformed."""
    if len(payload) != 8:
        return None
    address, _, count = struct.unpack(">IHH", payload)
    return (address, count) if 0 < count <= MAX_MEMORY_BYTES else None


def write_block(payload: bytes) -> tuple[int, bytes] | None:
    """Address and data of a WRITEMEM request; None if malformed."""
    if not 4 < len(payload) <= MAX_MEMORY_BYTES + 4:
        return None
    return int.from_bytes(payload[:4], "big"), payload[4:]


def resend_request(payload: bytes) -> Resend | None:
    """Block and packets of a PACKETRESEND request; None if malformed."""
    if len(payload) != 12:
        return None
    _, block_id, first, last = struct.unpack(">HHII", payload)
    first &= 0xFFFFFF
    last &= 0xFFFFFF
    return Resend(block_id, first, last) if first <= last else None
