"""The two protocols of GigE Vision as datagrams: control (GVCP) and stream (GVSP).  No sockets, no state.

Control: a header, big-endian, is key 0x42, flags, command, length of what follows, request id.  An acknowledge
starts with a status instead of key and flags.  A datagram is refused, never trusted: its length field must equal
what arrived.

Stream: a block is a leader (packet 0: time stamp, format, size), data packets 1 to n, and a trailer (packet n +
1). Block ids have 16 bits and run 1 to 65535; 0 is used for nothing but test packets.

Source: AIA, GigE Vision specification 1.2, chapters 16 to 18 and 22 to 25.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

from sim.camera.device import SimFrame

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


OVERHEAD_BYTES = 20 + 8 + 8  # IP, UDP and stream header count into the packet size
LEADER, TRAILER, DATA = 1, 2, 3
IMAGE = 1
WITH_CHUNKS = 0x4000  # of the payload type: chunks follow the image (GigE Vision 2.0, extended chunk mode)
UNAVAILABLE = 0x800C


def block_id(frame_id: int) -> int:
    """Id on the wire: 1 to 65535, then 1 again."""
    return (frame_id - 1) % 0xFFFF + 1


@dataclass(frozen=True, slots=True)
class Block:
    """One frame, ready to be cut into packets.

    Parameters
    ----------
    frame : SimFrame
        The frame.
    data_bytes : int
        Pixel bytes in a data packet.
    """

    frame: SimFrame
    data_bytes: int

    @property
    def id(self) -> int:
        """Block id on the wire."""
        return block_id(self.frame.frame_id)

    @property
    def last_packet(self) -> int:
        """Number of the trailer."""
        return -(-(self.frame.picture.payload.size + len(self.frame.tail)) // self.data_bytes) + 1

    def is_unsent(self, packet: int) -> bool:
        """Return whether this packet is never sent: the second half of a frame that is to arrive incomplete."""
        return self.frame.is_incomplete and self.last_packet // 2 < packet < self.last_packet

    def packet(self, number: int) -> tuple[bytes, memoryview | bytes]:
        """Header and content of one packet."""
        frame = self.frame
        if number == 0:
            stamp = frame.timestamp_ns
            content = struct.pack(
                ">HHIIIIIIIHH",
                0,
                self._payload_type,
                stamp >> 32 & 0xFFFFFFFF,
                stamp & 0xFFFFFFFF,
                frame.picture.format_code,
                frame.picture.width,
                frame.picture.height,
                frame.picture.offset_x,
                frame.picture.offset_y,
                0,
                0,
            )
            return _header(self.id, LEADER, 0), content
        if number == self.last_packet:
            return _header(self.id, TRAILER, number), struct.pack(
                ">HHI", 0, self._payload_type, frame.picture.height
            )
        start = (number - 1) * self.data_bytes
        pixels = frame.picture.payload.data[start : start + self.data_bytes]
        if len(pixels) == self.data_bytes or not frame.chunks:
            return _header(self.id, DATA, number), pixels
        behind = max(0, start - frame.picture.payload.size)
        rest = frame.tail[behind : behind + self.data_bytes - len(pixels)]
        return _header(self.id, DATA, number), bytes(pixels) + rest

    @property
    def _payload_type(self) -> int:
        return IMAGE | (WITH_CHUNKS if self.frame.chunks else 0)


def unavailable(block: int, packet: int) -> bytes:
    """Say that a packet cannot be sent again."""
    return struct.pack(">HHI", UNAVAILABLE, block, DATA << 24 | packet)


def test_packet(size_bytes: int) -> bytes:
    """A packet that only tries out the packet size."""
    return struct.pack(">HHI", 0, 0, DATA << 24).ljust(max(8, size_bytes - 28), b"\0")


def _header(block: int, kind: int, packet: int) -> bytes:
    return struct.pack(">HHI", 0, block, kind << 24 | packet)
