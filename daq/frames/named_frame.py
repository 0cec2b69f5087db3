"""Frames by the names that sources give them (`daq.frames.source`), read in any process.

Here all verbs read pictures: a file is read by `piv.files`, a frame that lies among others in one file by the kind
of that file, one module each in `AMONG_OTHERS`.  Which names are its own, a module says without opening a file.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.errors import FrameDamaged, FrameError
from piv.files.frame_file import COPY, checksum, read_frame

AMONG_OTHERS = ("daq.frames.hdf5_stack", "daq.frames.video", "daq.frames.double_frames", "daq.frames.davis")


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
    for module in map(import_module, AMONG_OTHERS):
        if module.is_image(place):
            frame = module.read_image(place)
            if shape is not None and frame.shape != shape:
                (rows, columns), (height, width) = frame.shape, shape
                raise FrameError(f"{place}: is {columns} x {rows} px, and should be {width} x {height} px")
            if crc32 is not None and checksum(frame) != crc32:
                raise FrameDamaged(f"{place}: does not agree with its checksum; {COPY}")
            break
    else:
        frame = read_frame(place, shape, crc32)
    if frame.dtype.kind == "f" and not (good := np.isfinite(frame)).all():
        row, column = np.argwhere(~good)[0]
        raise FrameError(
            f"{place}: holds {frame[row, column]} in row {row}, column {column}, and {np.count_nonzero(~good)}"
            " such values in all; give frames as acquired, not corrected ones"
        )
    return np.asarray(frame)


def checksum_of(place: Path, shape: tuple[int, int]) -> str:
    """Checksum of a frame's pixels, "" if it cannot be read: its pair is then left out by name."""
    try:
        return checksum(read_named(place, shape))
    except FrameError:
        return ""
