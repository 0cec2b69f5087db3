"""Where other people's frames lie, behind one small door: how many pairs there are, and the name of each frame.

A name is a path that can be read by itself, in any process (`named_frame`):

    B00012_a.tif             a file
    stack.tif@25             a page of a TIFF, 1 first
    data.nxs@/entry/data@24  an image of a data set, 0 first

A kind of source is one class that has what `FrameSource` asks for, and one line in `KINDS`.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Protocol

from piv.errors import PairError

KINDS = (  # the first that takes a name
    "daq.frames.numbered_files:NumberedFiles",
    "daq.frames.numbered_files:FrameFolder",
    "daq.frames.tiff_pages:TiffPages",
    "daq.frames.hdf5_stack:Hdf5Stack",
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


def _kind(place: str) -> type[FrameSource]:
    module, _, name = place.partition(":")
    found: type[FrameSource] = getattr(import_module(module), name)
    return found
