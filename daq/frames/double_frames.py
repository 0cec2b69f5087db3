"""Both exposures of a double-frame camera in one file: one above the other, side by side, or in alternate rows.

Which way they lie stands behind the name of the files, ``day1@top-bottom``; of a page or a file of two pages the
pages are the frames.  A frame is then ``im0001.tif@top``.  Rows of an interlaced frame between those of its own
exposure are the means of their neighbours, so that it has the size and the scale of the file.
"""

import re
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from daq.frames.name_schemes import natural
from daq.frames.numbered_files import FoundFiles, NumberedFiles, frames_in, matches
from daq.frames.pairing import NEIGHBOURS, Pairing
from piv.errors import FrameError, PairError
from piv.files.frame_file import read_frame

Layout = Literal["top-bottom", "left-right", "interlaced"]
PARTS: dict[str, tuple[str, str]] = {
    "top-bottom": ("top", "bottom"), "left-right": ("left", "right"), "interlaced": ("rows1", "rows2"),
}  # fmt: skip
_SAID = re.compile(rf"(.+)@({'|'.join(get_args(Layout))})", re.DOTALL)
_PART = re.compile(r"(.+)@(top|bottom|left|right|rows1|rows2)", re.DOTALL)


class DoubleFrames(FoundFiles):
    """Files that hold both exposures of a pair each.

    Parameters
    ----------
    path : Path
        A folder, a pattern or a file, with ``@top-bottom``, ``@left-right`` or ``@interlaced`` behind it.

    Raises
    ------
    PairError
        No file has such a name, or a pairing is given as well.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        found = _SAID.fullmatch(str(path))
        assert found is not None
        where, parts = Path(found[1]), PARTS[found[2]]
        if pairing is not NEIGHBOURS:
            raise PairError(f"{path}: each file is a pair; remove the numbers after @")
        if where.is_dir():
            folder, names = where, frames_in(where)
        elif NumberedFiles.takes(where):
            folder, names = where.parent, set(matches(where).values())
        else:
            folder, names = where.parent, {where.name}
        if not names:
            raise PairError(f"{where}: no file has such a name")
        order = sorted(names, key=natural)
        self._keep(folder, [(f"{name}@{parts[0]}", f"{name}@{parts[1]}") for name in order], 2 * len(order))

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether the name says that files hold both exposures."""
        return _SAID.fullmatch(str(path)) is not None

    def file_of(self, place: Path) -> Path:
        """The file that holds both."""
        found = _PART.fullmatch(str(place))
        return place if found is None else Path(found[1])


def is_image(place: Path) -> bool:
    """Return whether a name is that of one exposure of two in a file."""
    return _PART.fullmatch(str(place)) is not None


def read_image(place: Path) -> NDArray[Any]:
    """Read one exposure; raises FrameError as `daq.frames.named_frame.read_named`."""
    found = _PART.fullmatch(str(place))
    assert found is not None
    return part_of(read_frame(Path(found[1])), found[2])


def part_of(pixels: NDArray[Any], part: str) -> NDArray[Any]:
    """Return one exposure of a picture (H, W) that holds two; an odd row or column in the middle is left out."""
    rows, columns = pixels.shape[0] // 2, pixels.shape[1] // 2
    if part == "top":
        return np.ascontiguousarray(pixels[:rows])
    if part == "bottom":
        return np.ascontiguousarray(pixels[-rows:])
    if part == "left":
        return np.ascontiguousarray(pixels[:, :columns])
    if part == "right":
        return np.ascontiguousarray(pixels[:, -columns:])
    own = np.arange(part == "rows2", pixels.shape[0], 2)
    if not len(own):
        raise FrameError("has a single row, and cannot hold two exposures")
    place = np.clip((np.arange(pixels.shape[0]) - own[0]) / 2.0, 0.0, len(own) - 1.0)
    low, high = np.floor(place).astype(int), np.ceil(place).astype(int)
    between = 0.5 * (pixels[own[low]].astype(np.float64) + pixels[own[high]])
    return np.asarray(between if pixels.dtype.kind == "f" else np.floor(between + 0.5)).astype(pixels.dtype)
