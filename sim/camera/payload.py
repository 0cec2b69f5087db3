"""Payload of a frame: the sensor's grey values read out, and the data that comes with them.

Readout goes by what the registers say: crop, gain, bits, packing.  Data that comes with a frame is laid out as in
GigE Vision: every piece is followed by its id and its length.

    image | id, length | first chunk | id, length | ... | last chunk | id, length

Source: AIA, GigE Vision specification 1.2, chapter 24.4 (chunk data payload); numbers are big-endian, here
of 8 bytes.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.camera.features import CHUNK_BYTES, CHUNK_ID_BASE, CHUNKS, FLOAT_CHUNKS, IMAGE_CHUNK_ID
from sim.camera.packing import FORMATS, pack, to_format_bits
from sim.camera.registers import RegisterMap

CACHED_PICTURES = 64


@dataclass(frozen=True, slots=True)
class Picture:
    """Packed pixels, and where on the sensor they were."""

    width: int
    height: int
    offset_x: int
    offset_y: int
    format_code: int
    payload: NDArray[np.uint8]


class SensorReadout:
    """Develops sensor images; those that come again, from a ring of frames, only once.

    Parameters
    ----------
    registers : RegisterMap
        The camera's settings.
    bits : int
        Significant bits of the sensor.
    delivers : str
        Pixel format of every picture; "" for that of the settings.
    """

    def __init__(self, registers: RegisterMap, bits: int, delivers: str = "") -> None:
        self._registers = registers
        self._bits = bits
        self._delivers = delivers
        self._known: dict[tuple[object, ...], tuple[NDArray[np.uint16], Picture]] = {}

    def develop(self, sensor: NDArray[np.uint16]) -> Picture:
        """Picture of what the sensor (H, W) has seen."""
        registers = self._registers
        width, height = registers.integer("Width"), registers.integer("Height")
        left, top = registers.integer("OffsetX"), registers.integer("OffsetY")
        name = self._delivers or registers.entry("PixelFormat")
        gain = 10 ** (registers.number("Gain") / 20)
        across, down = (
            (registers.integer(f"Binning{axis}"), registers.integer(f"Decimation{axis}"))
            for axis in ("Horizontal", "Vertical")
        )
        turned = (registers.integer("ReverseX"), registers.integer("ReverseY"))
        key = (id(sensor), name, left, top, width, height, gain, across, down, turned)
        known = self._known.get(key)
        if known is not None and known[0] is sensor:
            return known[1]
        whole = sensor[:: -1 if turned[1] else 1, :: -1 if turned[0] else 1]
        whole = _bin_pixels(whole, down[0], across[0])[:: down[1], :: across[1]]
        image = whole[top : top + height, left : left + width]
        if gain != 1.0:
            white = (1 << self._bits) - 1
            image = np.minimum(np.rint(image * gain), white).astype(np.uint16)
        payload = pack(to_format_bits(image, self._bits, name), name)
        picture = Picture(width, height, left, top, FORMATS[name][0], payload)
        if not sensor.flags.writeable and len(self._known) < CACHED_PICTURES:
            self._known[key] = (sensor, picture)
        return picture


def _bin_pixels(sensor: NDArray[np.uint16], down: int, across: int) -> NDArray[np.uint16]:
    """Means of blocks of pixels, rounded down; rows and columns that fill no block are not sent."""
    if down == across == 1:
        return sensor
    rows, columns = sensor.shape[0] // down, sensor.shape[1] // across
    total = np.zeros((rows, columns), np.uint32)
    for row in range(down):
        for column in range(across):
            total += sensor[row : rows * down : down, column : columns * across : across]
    return (total // (down * across)).astype(np.uint16)


TAG_BYTES = 8


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Place of a chunk in its buffer."""

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
    """Places of the image and of every chunk; empty if there are no chunks."""
    if not chunks:
        return []
    found, offset = [ChunkPlace(IMAGE_CHUNK_ID, 0, image_bytes)], image_bytes + TAG_BYTES
    for name in chunks:
        found.append(ChunkPlace(CHUNK_ID_BASE + CHUNKS.index(name), offset, CHUNK_BYTES))
        offset += CHUNK_BYTES + TAG_BYTES
    return found
