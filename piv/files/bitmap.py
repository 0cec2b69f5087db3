"""PNG and BMP as one grey image: header and checksums first, then OpenCV's decoder.

PNG carries a CRC-32 of every part, so damage is found here before a decoder sees it; BMP carries nothing.
"""

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameError
from piv.files.tiff_page import MOST_PACKED, check_size, one_channel

_PNG = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # of the colour types of PNG
_GREY = 0


def grey_bitmap(content: bytes, shape: tuple[int, int] | None) -> NDArray[Any]:
    """Decode a PNG or BMP.

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
        Why it is no grey image, as the rest of a sentence.
    """
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it finds is in our one sentence
    width, height = _png_size(content) if content.startswith(_PNG) else _bmp_size(content)
    if shape is not None and (height, width) != shape:
        raise FrameError(other_size((height, width), shape))
    try:
        pixels: Any = cv2.imdecode(
            np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error:
        pixels = None
    if pixels is None or pixels.shape[:2] != (height, width) or pixels.dtype not in (np.uint8, np.uint16):
        raise FrameError("is damaged or no image; copy it from the camera again")
    return pixels if pixels.ndim == 2 else one_channel(pixels)


def other_size(found: tuple[int, int], wanted: tuple[int, int]) -> str:
    """What is said of a frame (rows, columns) that does not fit the camera."""
    return f"is {found[1]} x {found[0]} px, the scene's camera {wanted[1]} x {wanted[0]} px"


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
        raise FrameError("is damaged or no image; copy it from the camera again")
    width, height, _, bits, packing = struct.unpack("<iiHHI", content[18:34])
    if packing not in (0, 3):
        raise FrameError("is a packed BMP; save it unpacked, or as PNG")
    check_size(width, abs(height), bits / 8, len(content))
    return width, abs(height)
