"""GigE Vision stream protocol: one frame to its packets.

A block is a leader (packet 0: time stamp, format, size), data packets 1 to n, and a trailer (packet n + 1).  Block
ids have 16 bits and run 1 to 65535; 0 is used for nothing but test packets.

Source: AIA, GigE Vision specification 1.2, chapters 22 to 25.
"""

import struct
from dataclasses import dataclass

from sim.camera.device import SimFrame

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
        """Whether this packet is never sent: the second half of a frame that is to arrive incomplete."""
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
