"""A raw frame on the disk: a TIFF of 16 bit pixels exactly as unpacked, and the checksum that proves it.

The file appears under its final name only when it is whole and on the disk, and is never written again.  Its
checksum (see piv.files.frame_file) stands in its description and, for the frames of a run, in the journal: it is
the journal that decides what a frame of a run has to be.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from daq.atomic_write import disk_errors
from daq.errors import DiskError, RunDamaged
from ground.whole_file import whole_file
from piv.errors import FrameError
from piv.files.frame_file import checksum as checksum  # who writes raw frames needs it
from piv.files.frame_file import read_tiff


def write_raw(path: Path, pixels: NDArray[np.uint16], about: dict[str, Any]) -> None:
    """Write one frame: temporary name, fsync, rename.

    Parameters
    ----------
    path : Path
        Final name; must not exist.
    pixels : (H, W) uint16
        The frame.
    about : dict
        JSON-able facts, stored as the image description; checksum and size are added where they are not among
        them.

    Raises
    ------
    DiskError
        Full, not writable, or the name exists already.
    """
    if path.exists():
        raise DiskError(f"{path} exists already; raw frames are never overwritten, so begin a new run")
    facts = {"sensor_px": list(pixels.shape[::-1]), **about}
    if "crc32" not in facts:
        facts["crc32"] = checksum(pixels)
    about_disk = disk_errors(path, "make room or mend the disk, then resume the run")
    with about_disk, whole_file(path, let_go=True) as stream:
        tifffile.imwrite(
            stream, pixels, photometric="minisblack", rowsperstrip=pixels.shape[0], description=json.dumps(facts),
            metadata=None,
        )  # fmt: skip


def read_raw(path: Path, crc32: str | None = None) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Read a frame and its facts.

    Parameters
    ----------
    path : Path
        The file.
    crc32 : str, optional
        Checksum that the journal of its run has for it; the file's own is always compared.

    Raises
    ------
    RunDamaged
        The file is missing, or is not what was written.
    """
    try:
        pixels, about = read_tiff(path, crc32)
    except FrameError as error:
        raise RunDamaged(str(error)) from None
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise RunDamaged(f"{path}: is {pixels.shape} {pixels.dtype}, not a raw frame; restore it from a copy")
    if "crc32" not in about:
        raise RunDamaged(f"{path}: has lost its checksum; restore it from a copy")
    return pixels, about
