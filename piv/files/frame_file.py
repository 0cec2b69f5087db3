"""Frames on disk: read what cameras write, write what evaluations read.

Reading accepts one grey image (TIFF, PNG, BMP) of 8 or 16 bits or float32, however it is stored (see
piv.files.tiff_page); what cannot be read right is refused by its name, before its pixels are decoded. Writing is
a 16-bit or float32 TIFF with the scale as resolution tags and everything a later reader needs as JSON in the
image description: px_per_mm, origin_mm, offset, the hash of the scene.  A file appears under its final name only
when it is complete and on the disk.

A TIFF whose description has a `crc32` (raw frames of a run have) is compared with it whenever it is read: that
is the CRC-32 of the pixels, rows from the top, little-endian, so it can be checked from any copy in any
container. PNG carries a CRC-32 of every part, so damage is found before OpenCV's decoder sees it; BMP carries
nothing.
"""

import json
import logging
import re
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from ground.errors import MemoryShort
from ground.plain_file import open_plain, read_plain
from ground.whole_file import whole_file
from piv.errors import FrameDamaged, FrameError
from piv.files.tiff_page import MOST_PACKED, check_size, grey_page, one_channel, stored_size

_PNG = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # of the colour types of PNG
_GREY = 0
TIFF_ENDINGS = (".tif", ".tiff")
FRAME_ENDINGS = (*TIFF_ENDINGS, ".png", ".bmp")
MOST_BYTES = 2_000_000_000  # of a PNG or BMP
MOST_PAGES = 100_000
MOST_SAID = 120  # characters of a decoder's words
COPY = "restore it from a copy"
_PAGE = re.compile(r"(.+\.tiff?)@([0-9]{1,6})", re.IGNORECASE)
_CRC = re.compile(r"[0-9a-f]{8}")


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


logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what it finds is in our one sentence


def checksum(pixels: NDArray[Any]) -> str:
    """CRC-32 of the pixels (H, W), eight hex digits."""
    rows = np.ascontiguousarray(pixels)
    if sys.byteorder == "big":
        rows = rows.byteswap()
    return f"{zlib.crc32(rows.data):08x}"


def read_frame(path: Path | str, shape: tuple[int, int] | None = None, crc32: str | None = None) -> NDArray[Any]:
    """Read one frame.

    Parameters
    ----------
    path : path
        .tif, .tiff, .png or .bmp; of a TIFF of several pages with the page behind it, ``stack.tif@2``, 1 first.
    shape : (int, int), optional
        Rows and columns that the frame must have; compared before any pixel is decoded.
    crc32 : str, optional
        Checksum of its pixels that is known from elsewhere; a TIFF's own is always compared as well.

    Returns
    -------
    ndarray (H, W) of uint8, uint16 or float32

    Raises
    ------
    FrameError
        Missing, damaged, no file, colour, several pages, another size, another kind of number, a packing that
        nothing here reads.
    FrameDamaged
        It is not what its checksum was made from.
    MemoryShort
        It does not fit into memory.
    """
    file, page = page_of(Path(path))
    if file.suffix.lower() not in FRAME_ENDINGS:
        raise FrameError(f"{path}: is no frame; frames end in {', '.join(FRAME_ENDINGS)}")
    if file.suffix.lower() in TIFF_ENDINGS:
        return read_tiff(Path(path), crc32, shape)[0]
    if page is not None:
        raise FrameError(f"{path}: only a TIFF has pages; leave out @{page}")
    try:
        return grey_bitmap(read_plain(file, MOST_BYTES), shape)
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    except FrameError as error:
        raise FrameError(f"{path}: {error}") from None


def page_of(path: Path) -> tuple[Path, int | None]:
    """Split ``stack.tif@2`` into the file and its page, 1 first; a file that really has this name is one."""
    found = _PAGE.fullmatch(path.name)
    return (path, None) if found is None or path.exists() else (path.with_name(found[1]), int(found[2]))


def stem_of(path: Path) -> str:
    """Name of a frame without its ending, for what is made from it: ``stack_2`` of ``stack.tif@2``."""
    file, page = page_of(path)
    return file.stem if page is None else f"{file.stem}_{page}"


def read_tiff(
    path: Path, crc32: str | None = None, shape: tuple[int, int] | None = None
) -> tuple[NDArray[Any], dict[str, Any]]:
    """Read one page of a TIFF and the facts in its description ({} if that is no JSON object).

    Parameters
    ----------
    path : Path
        The file, with the page behind it if it has several (see `read_frame`).
    crc32 : str, optional
        Checksum of its pixels that is known from elsewhere.
    shape : (int, int), optional
        Rows and columns that it must have.

    Raises
    ------
    FrameError
        Missing, no TIFF, several pages, no grey image.
    FrameDamaged
        It is not what its checksum was made from.
    MemoryShort
        It does not fit into memory.
    """
    file, number = page_of(path)
    wrong, cure = (FrameError, "copy it from the camera again") if crc32 is None else (FrameDamaged, COPY)
    try:
        with open_plain(file) as stream, tifffile.TiffFile(stream) as tiff:
            place, page = _page(tiff, number, file.name)
            described = str(getattr(page, "description", ""))
            if shape is not None and crc32 is None and (found := stored_size(page)) != shape:
                raise FrameError(other_size(found, shape))
            pixels = grey_page(page, stream, place)
    except FrameError as error:
        raise wrong(f"{path}: {error}" + ("" if crc32 is None else f"; {COPY}")) from None
    except MemoryShort:
        raise
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files surface as any error of the decoders below tifffile
        raise wrong(f"{path}: is damaged or no TIFF ({_short(error)}); {cure}") from None
    facts = _facts(path, described)
    known = {text for text in (crc32, facts.get("crc32")) if text is not None}
    if known and known != {checksum(pixels)}:
        raise FrameDamaged(f"{path}: does not agree with its checksum {min(known)}; {COPY}")
    size_px = facts.get("sensor_px")  # the same bytes in rows of another length have the same checksum
    if known and size_px is not None and size_px != list(pixels.shape[::-1]):
        raise FrameDamaged(f"{path}: has shape {pixels.shape} and was {size_px} px; {COPY}")
    if shape is not None and pixels.shape != shape:
        raise FrameError(f"{path}: {other_size(pixels.shape, shape)}")
    return pixels, facts


def _page(tiff: tifffile.TiffFile, number: int | None, name: str) -> tuple[int, Any]:
    """Place in the file and tags of the page that is asked for; small previews are none."""
    if len(tiff.pages) > MOST_PAGES:
        raise FrameError(f"holds {len(tiff.pages)} pages; {MOST_PAGES} are read")
    pages = [(place, page) for place, page in enumerate(tiff.pages) if not page.aspage().is_reduced]
    hidden = re.search(r"^images=(\d+)$", str(getattr(tiff.pages[0], "description", "")), re.MULTILINE)
    if hidden is not None and int(hidden[1]) > len(tiff.pages):
        raise FrameError(f"holds {hidden[1]} images as ImageJ packs them; export one image a file")
    if number is None and len(pages) != 1:
        raise FrameError(f"holds {len(pages)} pages; say which, as in {name}@1, or export one frame a file")
    if number is not None and not 1 <= number <= len(pages):
        raise FrameError(f"holds {len(pages)} pages, and no page {number}")
    place, page = pages[(number or 1) - 1]
    return place, page.aspage()


def _short(error: Exception) -> str:
    """First line of what a decoder says, printable and not endless."""
    text = str(error).split("\n", 1)[0]
    return "".join(c if c.isprintable() else "?" for c in text)[:MOST_SAID] or type(error).__name__


def _facts(path: Path, described: str) -> dict[str, Any]:
    """Facts in a description; one that names a checksum and cannot be read has been damaged."""
    try:
        facts = json.loads(described)
    except (ValueError, RecursionError):
        facts = None
    if not isinstance(facts, dict):
        facts = {}
    if "crc32" in described and not _CRC.fullmatch(str(facts.get("crc32"))):
        raise FrameDamaged(f"{path}: the checksum in its description is damaged; {COPY}")
    return facts


def write_frame(path: Path | str, frame: NDArray[Any], px_per_mm: float, description: dict[str, Any]) -> None:
    """Write one frame as TIFF, atomically.

    Parameters
    ----------
    path : path
        Final name.
    frame : ndarray (H, W)
        uint8, uint16 or float32.
    px_per_mm : float
        Scale, written as resolution tags (px/cm).
    description : dict
        JSON-able; stored as the image description.
    """
    resolution = (px_per_mm * 10.0, px_per_mm * 10.0)
    with whole_file(Path(path), let_go=True) as stream:
        tifffile.imwrite(
            stream,
            frame,
            photometric="minisblack",
            resolution=resolution,
            resolutionunit="CENTIMETER",
            description=json.dumps({"px_per_mm": px_per_mm, **description}),
            metadata=None,
        )
