"""Frames by the names that sources give them (`daq.frames.source`), read in any process."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.frames.hdf5_stack import is_image, read_image
from piv.errors import FrameError
from piv.files.frame_file import checksum, read_frame


def read_named(place: Path, shape: tuple[int, int] | None = None, crc32: str | None = None) -> NDArray[Any]:
    """Read a frame by its name.

    Parameters
    ----------
    place : Path
        As a source names it, or a frame of a run.
    shape : (int, int), optional
        Rows and columns that it must have.
    crc32 : str, optional
        Checksum of its pixels that is known from elsewhere.

    Returns
    -------
    ndarray (H, W) of uint8, uint16 or finite float32

    Raises
    ------
    FrameError
        Missing, another size, another kind of number, NaN.
    FrameDamaged
        It is not what its checksum was made from.
    """
    frame = read_image(place, shape, crc32) if is_image(place) else read_frame(place, shape, crc32)
    if frame.dtype.kind == "f" and not np.isfinite(frame).all():
        raise FrameError(f"{place}: holds values that are not finite; give frames as acquired")
    return frame


def checksum_of(place: Path, shape: tuple[int, int]) -> str:
    """Checksum of a frame's pixels, "" if it cannot be read: its pair is then left out by name."""
    try:
        return checksum(read_named(place, shape))
    except FrameError:
        return ""
