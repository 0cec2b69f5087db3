"""PNG, BMP, JPEG and PGM: header first, then pixels, as one grey image.

A size that the file cannot hold is refused before anything is decoded, and damage as far as a format lets it be
seen: PNG has a checksum of every part; JPEG and PGM that are cut short lack their end; what was changed within a
BMP, a JPEG or a PGM that is not known.  How a camera was held (EXIF) turns no frame: the sensor is what is traced.
"""

import re
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError
from piv.files.colours import grey_of
from piv.files.tiff_page import MOST_PACKED, check_size

BITMAP_ENDINGS = (".png", ".bmp", ".jpg", ".jpeg", ".pgm")
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # of the colour types of PNG
_GREY = 0
_NO_IMAGE = "is damaged or no image; copy it from the camera again"
_CUT = "is damaged: its end is missing; copy it from the camera again"
_MOST_PX_A_BYTE = 2000.0  # of a JPEG; 64 of one grey take two bits at least
_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # segments of a JPEG that say its size
_ALONE = {0x01, *range(0xD0, 0xD9)}  # markers without a segment
_START_OF_SCAN, _END = 0xDA, b"\xff\xd9"
_PGM = re.compile(rb"P5(?:\s+(?:#[^\n]*\n\s*)*)(\d{1,9})(?:\s+(?:#[^\n]*\n\s*)*)(\d{1,9})"
                  rb"(?:\s+(?:#[^\n]*\n\s*)*)(\d{1,5})\s")  # fmt: skip


def grey_bitmap(content: bytes, shape: tuple[int, int] | None) -> NDArray[Any]:
    """Decode a PNG, BMP, JPEG or PGM.

    Parameters
    ----------
    content : bytes
        The whole file.
    shape : (int, int), optional
        Rows and columns that are wanted; another size is returned undecoded by `FrameError`.

    Returns
    -------
    ndarray (H, W) of uint8 or uint16

    Raises
    ------
    FrameError
        Why it is no image that can be read, as the rest of a sentence.
    """
    if content[:1] == b"P" and content[1:2].isdigit():
        return _pgm(content, shape)
    if content.startswith(_PNG):
        width, height = _png_size(content)
    elif content.startswith(_JPEG):
        width, height = _jpeg_size(content)
    else:
        width, height = _bmp_size(content)
    _require(shape, (height, width))
    return _decode(content, (height, width))


def other_size(found: tuple[int, int], wanted: tuple[int, int]) -> str:
    """Message about a frame (rows, columns) that does not fit the camera, or the frames beside it."""
    return f"is {found[1]} x {found[0]} px, and {wanted[1]} x {wanted[0]} px are expected"


def _require(shape: tuple[int, int] | None, found: tuple[int, int]) -> None:
    if shape is not None and found != shape:
        raise FrameError(other_size(found, shape))


def _decode(content: bytes, size: tuple[int, int]) -> NDArray[Any]:
    """Grey of what OpenCV finds in a file of a known size."""
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it finds is in our one sentence
    how = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels: Any = cv2.imdecode(np.frombuffer(content, np.uint8), how)
    except cv2.error:
        pixels = None
    if pixels is None or pixels.shape[:2] != size or pixels.dtype not in (np.uint8, np.uint16):
        raise FrameError(_NO_IMAGE)
    if pixels.ndim == 2:
        return np.asarray(pixels)
    return grey_of(pixels[..., [2, 1, 0, 3][: pixels.shape[2]]])  # OpenCV has blue first


def _png_size(content: bytes) -> tuple[int, int]:
    """Width and height; FrameError if a part is not what its checksum was made from, or the end is missing."""
    place, kind, first = len(_PNG), b"", content[16:29]
    while kind != b"IEND":
        length, kind = (
            struct.unpack(">I4s", content[place : place + 8]) if place + 12 <= len(content) else (0, b"")
        )
        end = place + 12 + length
        if end > len(content) or struct.unpack(">I", content[end - 4 : end])[0] != zlib.crc32(
            content[place + 4 : end - 4]
        ):
            raise FrameError("is damaged: a part is not what its checksum says; copy it from the camera again")
        if place == len(_PNG) and (kind != b"IHDR" or length != 13):
            raise FrameError("is damaged: it does not begin with a header")
        place = end
    width, height, bits, colour = struct.unpack(">IIBB", first[:10])
    if colour not in _CHANNELS:
        raise FrameError("is damaged: it has a colour type that does not exist")
    if colour == _GREY and bits not in (8, 16):
        raise FrameError(f"holds uint{bits}; uint8, uint16 or float32 is needed")
    check_size(width, height, _CHANNELS[colour] * max(bits, 8) / 8, 8 * MOST_PACKED * len(content))
    return width, height


def _bmp_size(content: bytes) -> tuple[int, int]:
    if not content.startswith(b"BM") or len(content) < 54:
        raise FrameError(_NO_IMAGE)
    width, height, _, bits, packing = struct.unpack("<iiHHI", content[18:34])
    if packing not in (0, 3):
        raise FrameError("is a packed BMP; save it unpacked, or as PNG")
    check_size(width, abs(height), bits / 8, len(content))
    return width, abs(height)


def _jpeg_size(content: bytes) -> tuple[int, int]:
    """Width and height of a JPEG; FrameError if no scan follows, or what ends a scan is missing."""
    place, size = 2, None
    while True:
        while content[place : place + 2] == b"\xff\xff":  # may stand before any marker
            place += 1
        if place + 4 > len(content) or content[place] != 0xFF:
            raise FrameError(_NO_IMAGE)
        marker, length = content[place + 1], int.from_bytes(content[place + 2 : place + 4], "big")
        if marker in _ALONE:
            place += 2
            continue
        if marker in _SIZES and length >= 8 and place + 10 <= len(content):
            bits, height, width, channels = struct.unpack(">BHHB", content[place + 4 : place + 10])
            if channels not in (1, 3):
                raise FrameError(f"has {channels} channels; one grey image is needed, so export it as such")
            if bits != 8:
                raise FrameError(f"holds uint{bits}; a JPEG is read with 8 bits")
            size = width, height, channels
        if marker == _START_OF_SCAN:
            break
        place += 2 + length
    if size is None:
        raise FrameError(_NO_IMAGE)
    if content.find(_END, place) < 0:  # within a scan no such two bytes stand
        raise FrameError(_CUT)
    width, height, channels = size
    check_size(width, height, channels, channels * _MOST_PX_A_BYTE * len(content))
    return width, height


def _pgm(content: bytes, shape: tuple[int, int] | None) -> NDArray[Any]:
    """Grey of a binary PGM: numbers as they stand in it, up to the largest that its header says."""
    head = _PGM.match(content)
    if head is None:
        raise FrameError("is no binary PGM; save it as P5, 8 or 16 bits")
    width, height, most = (int(text) for text in head.groups())
    if not 0 < most < 65536:
        raise FrameError(f"is damaged: its largest grey is {most}")
    kind = np.dtype(np.uint8 if most < 256 else ">u2")
    check_size(width, height, kind.itemsize, len(content))
    _require(shape, (height, width))
    if len(content) - head.end() < width * height * kind.itemsize:
        raise FrameError(_CUT)
    pixels = np.frombuffer(content, kind, width * height, head.end()).reshape(height, width)
    if int(pixels.max()) > most:
        raise FrameError(f"is damaged: it holds {int(pixels.max())}, and its largest grey is {most}")
    return pixels.astype(kind.newbyteorder("="))
