"""Frames on disk: read what cameras write, write what evaluations read.

Reading accepts one image of 8 or 16 bits or float32, however it is stored (`piv.files.tiff_page`, and
`piv.files.bitmap` for PNG, BMP, JPEG and PGM), colours as grey (`piv.files.colours`); what cannot be read right is
refused by its name, before its pixels are decoded. Writing is
a 16-bit or float32 TIFF with the scale as resolution tags and everything a later reader needs as JSON in the
image description: px_per_mm, origin_mm, offset, the hash of the scene.  A file appears under its final name only
when it is complete and on the disk.

A TIFF whose description has a `crc32` (raw frames of a run have) is compared with it whenever it is read: that
is the CRC-32 of the pixels, rows from the top, little-endian, so it can be checked from any copy in any
container.
"""

import json
import logging
import re
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
from piv.files.bitmap import BITMAP_ENDINGS, grey_bitmap, other_size
from piv.files.content import other_content
from piv.files.tiff_page import grey_page, size_in_file

TIFF_ENDINGS = (".tif", ".tiff")
FRAME_ENDINGS = (*TIFF_ENDINGS, *BITMAP_ENDINGS)
MOST_BYTES = 2_000_000_000  # of a file without pages
MOST_PAGES = 100_000
MOST_SAID = 120  # characters of a decoder's words
COPY = "restore it from a copy"
_PAGE = re.compile(r"(.+\.tiff?)@([0-9]{1,6})", re.IGNORECASE)
_AMONG_OTHERS = re.compile(r"(.+)\.\w+@([0-9]{1,8})")  # of a stack or a video
_CRC = re.compile(r"[0-9a-f]{8}")


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
        .tif, .tiff, .png, .bmp, .jpg or .pgm; of a TIFF of several pages with the page behind it,
        ``stack.tif@2``, 1 first.
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
        Missing, damaged, no file, several pages, another size, another kind of number, a packing that
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
        raise FrameError(f"{path}: {other_content(file) or error}") from None


def page_of(path: Path) -> tuple[Path, int | None]:
    """Split ``stack.tif@2`` into the file and its page, 1 first; a file that really has this name is one."""
    found = _PAGE.fullmatch(path.name)
    return (path, None) if found is None or path.exists() else (path.with_name(found[1]), int(found[2]))


def stem_of(path: Path) -> str:
    """Name of a frame without its ending, for what is made from it: ``stack_2`` of ``stack.tif@2``."""
    found = _AMONG_OTHERS.fullmatch(path.name)
    return path.stem if found is None or path.exists() else f"{found[1]}_{int(found[2])}"


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
            if shape is not None and crc32 is None and (found := size_in_file(page)) != shape:
                raise FrameError(other_size(found, shape))
            pixels = grey_page(page, stream, place)
    except FrameError as error:
        raise wrong(f"{path}: {error}" + ("" if crc32 is None else f"; {COPY}")) from None
    except MemoryShort:
        raise
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files surface as any error of the decoders below tifffile
        other = other_content(file) if crc32 is None else ""
        raise wrong(f"{path}: {other or f'is damaged or no TIFF ({_short(error)}); {cure}'}") from None
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
