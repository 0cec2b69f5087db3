"""Frames on disk: read what cameras write, write what evaluations read.

Reading accepts one grey image a file (TIFF, PNG, BMP) of 8 or 16 bits or float32.  Writing is a 16-bit or
float32 TIFF with the scale as resolution tags and everything a later reader needs as JSON in the image
description: px_per_mm, origin_mm, offset, the hash of the scene.  A file appears under its final name only
when it is complete and on the disk.

A TIFF whose description has a `crc32` (raw frames of a run have) is compared with it whenever it is read: that is
the CRC-32 of the pixels, rows from the top, little-endian, so it can be checked from any copy in any container.
"""

import json
import logging
import re
import sys
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from correction.errors import FrameDamaged, FrameError
from ground.whole_file import whole_file

TIFF_ENDINGS = (".tif", ".tiff")
FRAME_ENDINGS = (*TIFF_ENDINGS, ".png", ".bmp")
logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what it finds is in our one sentence
_CRC = re.compile(r"[0-9a-f]{8}")


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
        .tif, .tiff, .png or .bmp.
    shape : (int, int), optional
        Rows and columns that the frame must have.
    crc32 : str, optional
        Checksum of its pixels that is known from elsewhere; a TIFF's own is always compared as well.

    Returns
    -------
    ndarray (H, W) of uint8, uint16 or float32

    Raises
    ------
    FrameError
        Missing, damaged, colour, several pages, another size, another kind of number.
    FrameDamaged
        It is not what its checksum was made from.
    """
    path = Path(path)
    if path.suffix.lower() not in FRAME_ENDINGS:
        raise FrameError(f"{path}: is no frame; frames end in {', '.join(FRAME_ENDINGS)}")
    frame = read_tiff(path, crc32)[0] if path.suffix.lower() in TIFF_ENDINGS else _read_other(path)
    if frame.ndim != 2:
        raise FrameError(f"{path}: has shape {frame.shape}; one grey image is needed, no colour, no stack")
    if frame.dtype not in (np.uint8, np.uint16, np.float32):
        raise FrameError(f"{path}: holds {frame.dtype}; uint8, uint16 or float32 is needed")
    if shape is not None and frame.shape != shape:
        raise FrameError(
            f"{path}: is {frame.shape[1]} x {frame.shape[0]} px, the scene's camera {shape[1]} x {shape[0]} px"
        )
    return frame


def read_tiff(path: Path, crc32: str | None = None) -> tuple[NDArray[Any], dict[str, Any]]:
    """Read one TIFF and the facts in its description ({} if that is no JSON object).

    Parameters
    ----------
    path : Path
        The file.
    crc32 : str, optional
        Checksum of its pixels that is known from elsewhere.

    Raises
    ------
    FrameError
        Missing, no TIFF, several pages.
    FrameDamaged
        It is not what its checksum was made from.
    """
    try:
        with tifffile.TiffFile(path) as file:
            if len(file.pages) != 1:
                wrong = FrameError if crc32 is None else FrameDamaged
                raise wrong(f"{path}: holds {len(file.pages)} pages; one frame a file is needed")
            page = file.pages[0]
            described = str(getattr(page, "description", ""))
            pixels = np.asarray(page.asarray())
    except FrameError:
        raise
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files surface as any error of the decoders below tifffile
        if crc32 is not None:
            raise FrameDamaged(f"{path}: is damaged ({error}); restore it from a copy") from None
        raise FrameError(f"{path}: is damaged or no TIFF ({error}); copy it from the camera again") from None
    facts = _facts(path, described)
    known = {text for text in (crc32, facts.get("crc32")) if text is not None}
    if known and known != {checksum(pixels)}:
        raise FrameDamaged(f"{path}: does not agree with its checksum {min(known)}; restore it from a copy")
    size_px = facts.get("sensor_px")  # the same bytes in rows of another length have the same checksum
    if known and size_px is not None and size_px != list(pixels.shape[::-1]):
        raise FrameDamaged(f"{path}: has shape {pixels.shape} and was {size_px} px; restore it from a copy")
    return pixels, facts


def _facts(path: Path, described: str) -> dict[str, Any]:
    """Facts in a description; one that names a checksum and cannot be read has been damaged."""
    try:
        facts = json.loads(described)
    except (ValueError, RecursionError):
        facts = None
    if not isinstance(facts, dict):
        facts = {}
    if "crc32" in described and not _CRC.fullmatch(str(facts.get("crc32"))):
        raise FrameDamaged(f"{path}: the checksum in its description is damaged; restore it from a copy")
    return facts


def _read_other(path: Path) -> NDArray[Any]:
    if not path.is_file():
        raise FrameError(f"{path}: cannot be read: no such file")
    frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if frame is None:
        raise FrameError(f"{path}: is damaged or no image; copy it from the camera again")
    return np.asarray(frame)


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
