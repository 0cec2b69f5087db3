"""A raw frame on the disk: a TIFF of 16 bit pixels exactly as unpacked, and the checksum that proves it.

The file appears under its final name only when it is whole and on the disk, and is never written again.  The
checksum is the CRC-32 of the pixels (rows from the top, little-endian uint16), so it can be checked from any copy
in any container.
"""

import json
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from daq.errors import DiskError
from daq.runs.whole_text import why
from tracer.whole_file import whole_file


def checksum(pixels: NDArray[np.uint16]) -> str:
    """CRC-32 of the pixels (H, W), eight hex digits."""
    rows = np.ascontiguousarray(pixels)
    if sys.byteorder == "big":
        rows = rows.byteswap()
    return f"{zlib.crc32(rows.data):08x}"


def write_raw(path: Path, pixels: NDArray[np.uint16], about: dict[str, Any]) -> None:
    """Write one frame: temporary name, fsync, rename.

    Parameters
    ----------
    path : Path
        Final name; must not exist.
    pixels : (H, W) uint16
        The frame.
    about : dict
        JSON-able facts, stored as the image description.

    Raises
    ------
    DiskError
        Full, not writable, or the name exists already.
    """
    if path.exists():
        raise DiskError(f"{path} exists already; raw frames are never overwritten, so begin a new run")
    try:
        with whole_file(path, let_go=True) as stream:
            tifffile.imwrite(
                stream,
                pixels,
                photometric="minisblack",
                rowsperstrip=pixels.shape[0],
                description=json.dumps(about),
                metadata=None,
            )
    except OSError as error:
        raise DiskError(f"{path}: {why(error)}; make room or mend the disk, then resume the run") from error


def read_raw(path: Path) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Read a frame and its facts.

    Raises
    ------
    DiskError
        The file is missing or damaged.
    """
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages[0]
            pixels = np.asarray(page.asarray())
            about = json.loads(getattr(page, "description", "") or "{}")
    except (OSError, ValueError, IndexError, tifffile.TiffFileError) as error:
        raise DiskError(f"{path}: cannot be read back ({error})") from error
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise DiskError(f"{path}: is {pixels.shape} {pixels.dtype}, not a raw frame")
    return pixels, about
