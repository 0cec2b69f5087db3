"""Where other people's frames lie, behind one small door: how many pairs there are, and the name of each frame.

A name is a path that can be read by itself, in any process (`read_named`):

    B00012_a.tif             a file
    stack.tif@25             a page of a TIFF, 1 first
    data.nxs@/entry/data@24  an image of a data set, 0 first

A kind of source is one file with a class that has what `FrameSource` asks for, and one line in `KINDS`.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from correction.errors import FrameError, PairError
from correction.frame_file import checksum, read_frame

KINDS = (  # the first that takes a name
    "daq.acquisition.frames.numbered_files:NumberedFiles",
    "daq.acquisition.frames.tiff_pages:TiffPages",
    "daq.acquisition.frames.hdf5_stack:Hdf5Stack",
)
FramePlaces = tuple[int, Path, Path]  # number of the pair, first and second frame


class FrameSource(Protocol):
    """Pairs of frames somewhere."""

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Whether a name is one of this kind; what is wrong with it is said when it is opened."""
        ...

    def __init__(self, path: Path) -> None:
        """Look what there is; PairError or FrameError if there is nothing that could be used."""
        ...

    def pairs(self) -> Sequence[FramePlaces]:
        """Pairs in their order."""
        ...

    def alone(self) -> int:
        """Frames without a partner."""
        ...

    def file_of(self, place: Path) -> Path:
        """File that a frame lies in: while its size and time stay, so do its pixels."""
        ...


def is_source(path: Path) -> bool:
    """Whether a name is that of frames that form pairs among themselves."""
    return any(_kind(place).takes(path) for place in KINDS)


def source_of(path: Path) -> FrameSource:
    """Open a source.

    Raises
    ------
    PairError
        It is none, or holds no pair.
    FrameError
        It cannot be read.
    """
    for place in KINDS:
        kind = _kind(place)
        if kind.takes(path):
            found = kind(path)
            if not found.pairs():
                raise PairError(f"{path}: holds no pair of frames")
            return found
    raise PairError(f"{path}: is neither a run nor frames in pairs; see docs/campaigns.md for what can be read")


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
    from daq.acquisition.frames.hdf5_stack import is_image, read_image

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


def _kind(place: str) -> type[FrameSource]:
    module, _, name = place.partition(":")
    found: type[FrameSource] = getattr(import_module(module), name)
    return found
