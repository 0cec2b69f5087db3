"""External image pairs: the number of pairs, and the name of each frame.

A name is a path that can be read by itself, in any process (`named_frame`):

    B00012_a.tif             a file
    stack.tif@25             a page of a TIFF, 1 first
    data.nxs@/entry/data@24  an image of a data set, 0 first
    run.mp4@25               a frame of a video, 1 first
    run.set@25               a frame of a set of DaVis, 1 first, through all of its images

Frames that follow each other are in pairs as is said behind the name, or 1 and 2, 3 and 4 (`daq.frames.pairing`).
A kind of source is one class that has what `FrameSource` asks for, and one line in `KINDS`.
"""

from collections import Counter
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Protocol

from daq.frames.pairing import FramePlaces, Pairing, pairing_of
from piv.errors import PairError
from piv.files.frame_file import FRAME_ENDINGS

KINDS = (  # the first that takes a name
    "daq.frames.double_frames:DoubleFrames",
    "daq.frames.numbered_files:PatternPair",
    "daq.frames.numbered_files:NumberedFiles",
    "daq.frames.numbered_files:FrameFolder",
    "daq.frames.tiff_pages:TiffPages",
    "daq.frames.hdf5_stack:Hdf5Stack",
    "daq.frames.video:Video",
    "daq.frames.davis:DavisImages",
)


class FrameSource(Protocol):
    """Pairs of frames somewhere."""

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether a name is one of this kind; what is wrong with it is said when it is opened."""

    def __init__(self, path: Path, pairing: Pairing) -> None:
        """Look what there is; PairError or FrameError if there is nothing that could be used."""

    def pairs(self) -> Sequence[FramePlaces]:
        """Pairs in their order."""

    def count_unpaired(self) -> int:
        """Frames without a partner."""

    def file_of(self, place: Path) -> Path:
        """File that a frame lies in: while its size and time stay, so do its pixels."""


def is_source(path: Path) -> bool:
    """Return whether a name is that of frames that form pairs among themselves."""
    name, _ = pairing_of(path)
    return any(_kind(place).takes(name) for place in KINDS)


def source_of(path: Path) -> FrameSource:
    """Open a source.

    Raises
    ------
    PairError
        It is none, or holds no pair.
    FrameError
        It cannot be read.
    """
    name, pairing = pairing_of(path)
    for place in KINDS:
        kind = _kind(place)
        if kind.takes(name):
            found = kind(name, pairing)
            if not found.pairs():
                raise PairError(f"{path}: holds no pair of frames")
            return found
    raise PairError(f"{path}: is neither a run nor frames in pairs: {no_source_reason(name)}")


def no_source_reason(path: Path) -> str:
    """Return why a name is none of frames in pairs, and what to give instead."""
    kinds = ", ".join(FRAME_ENDINGS)
    if not path.exists():
        return 'it does not exist; a pattern needs quotes and an ending of frames, such as "im*.tif"'
    if path.is_file():
        if path.suffix.lower() in FRAME_ENDINGS:
            return "it is one frame; give two frames, or one folder or a pattern of frames"
        return f"files {path.suffix or 'without an ending'} are not read; convert its frames to TIFF, one each"
    try:
        files = sorted(file for file in path.iterdir() if not file.name.startswith("."))
    except OSError as error:
        return f"it cannot be looked into ({error.strerror})"
    if frames := [file for file in files if file.suffix.lower() in FRAME_ENDINGS]:
        two = " ".join(f'"{file}"' for file in frames[:2])
        return f"no names or numbers show which frames are pairs; give two frames by their names, such as {two}"
    if inside := [file for file in files if is_source(file)]:
        return f'give what lies in it: "{inside[0]}"'
    endings = Counter(file.suffix or file.name for file in files if file.is_file())
    there = ", ".join(f"{count} of {ending}" for ending, count in endings.most_common(3)) or "none at all"
    return f"it holds no frames ({kinds}); its files: {there}; see docs/campaigns.md for what can be read"


def _kind(place: str) -> type[FrameSource]:
    module, _, name = place.partition(":")
    found: type[FrameSource] = getattr(import_module(module), name)
    return found
