"""Data that comes with a frame, as GigE Vision lays it out: every piece is followed by its id and its length.

    image | id, length | first chunk | id, length | ... | last chunk | id, length

Source: AIA, GigE Vision specification 1.2, chapter 24.4 (chunk data payload); numbers are big-endian, here
of 8 bytes.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from sim.camera.features import CHUNK_BYTES, CHUNK_ID_BASE, CHUNKS, FLOAT_CHUNKS, IMAGE_CHUNK_ID

TAG_BYTES = 8


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies in its buffer."""

    id: int
    offset: int
    length: int


def tail_bytes(count: int) -> int:
    """Bytes behind the image if so many chunks are sent."""
    return TAG_BYTES + count * (CHUNK_BYTES + TAG_BYTES) if count else 0


def tail(image_bytes: int, chunks: Mapping[str, float]) -> bytes:
    """Return what follows the image; nothing if there are no chunks."""
    if not chunks:
        return b""
    parts = [struct.pack(">II", IMAGE_CHUNK_ID, image_bytes)]
    for name, value in chunks.items():
        kind = "d" if name in FLOAT_CHUNKS else "Q"
        parts.append(struct.pack(f">{kind}II", value, CHUNK_ID_BASE + CHUNKS.index(name), CHUNK_BYTES))
    return b"".join(parts)


def places(image_bytes: int, chunks: Mapping[str, float]) -> list[ChunkPlace]:
    """Where the image and every chunk lie; empty if there are no chunks."""
    if not chunks:
        return []
    found, offset = [ChunkPlace(IMAGE_CHUNK_ID, 0, image_bytes)], image_bytes + TAG_BYTES
    for name in chunks:
        found.append(ChunkPlace(CHUNK_ID_BASE + CHUNKS.index(name), offset, CHUNK_BYTES))
        offset += CHUNK_BYTES + TAG_BYTES
    return found
