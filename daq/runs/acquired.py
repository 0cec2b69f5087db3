"""Frames as acquired, wherever they lie: one of a run is what the run's journal says it is, or it is refused.

Verbs are given paths.  A path that lies in the `frames` of a run is looked up in its journal, and its pixels must
have the checksum that was written there when the frame was; so a frame passes neither with damaged pixels nor with
a damaged description that has lost its checksum.  A frame elsewhere, such as a copy, is compared with the checksum
that it carries itself, if it carries one.

Frames are looked at while maps are made, and each is read while the one before it is worked on (`ReadAhead`).
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunDamaged
from daq.frames.named_frame import read_named
from daq.runs.names import FILE
from daq.runs.run_folder import RunFolder, frame_entries
from piv.errors import FrameError
from piv.files.frame_file import read_frame

DEPTHS = (255.0, 4095.0, 65535.0)  # full scales of cameras; 12 bit come in uint16, right- or left-aligned


def read_acquired(path: Path, shape: tuple[int, int] | None = None) -> NDArray[Any]:
    """Read one acquired frame.

    Parameters
    ----------
    path : Path
        A frame of a run, any file that `read_frame` takes, or a frame of a stack or a video by its name.
    shape : (int, int), optional
        Rows and columns that the frame must have.

    Returns
    -------
    ndarray (H, W) of uint8, uint16 or finite float32

    Raises
    ------
    FrameError
        Missing, several pages, another size, another kind of number, NaN.
    FrameDamaged, RunDamaged
        It is not what was written, or its run does not know it.
    """
    run = run_of(path)
    if run is None:
        return read_named(path, shape)
    _require(path)
    known = _frame_facts(run, _stamp(run.journal_path))
    if path.name not in known:
        raise RunDamaged(f"{path}: is not in the journal of its run, so it cannot be verified; omit it")
    return read_frame(path, shape, known[path.name].crc32)


def full_scale(path: Path, frame: NDArray[Any]) -> float:
    """Grey level at which a pixel of a frame is saturated.

    Parameters
    ----------
    path : Path
        The frame: of a run the journal says its bits, of others the kind of number and the brightest pixel do.
    frame : ndarray (H, W) of uint8, uint16 or float32
        Its pixels, background taken off or not.
    """
    run = run_of(path)
    known = None if run is None else _frame_facts(run, _stamp(run.journal_path)).get(path.name)
    if known is not None:
        return float((1 << known.bits) - 1)
    least = max(DEPTHS[0] if frame.dtype == np.uint8 else DEPTHS[1], float(np.nanmax(frame)))
    return next((depth for depth in DEPTHS if depth >= least), DEPTHS[-1])


def read_promised(path: Path, crc32: str, shape: tuple[int, int]) -> NDArray[Any]:
    """Read a frame whose checksum was looked up before; the journal of its run is not asked again.

    Parameters
    ----------
    path : Path
        The frame.
    crc32 : str
        Checksum that its pixels must have; "" if it could not be read.
    shape : (int, int)
        Rows and columns that it must have.

    Raises
    ------
    FrameError
        Another size, another kind of number.
    FrameDamaged, RunDamaged
        It is not what was promised, or missing.
    """
    if run_of(path) is None:
        if not crc32:  # it could not be read when its series was planned: report why
            read_named(path, shape)
            raise FrameError(f"{path}: could not be read when its series was planned; give the same command again")
        return read_named(path, shape, crc32)
    _require(path)
    return read_frame(path, shape, crc32)


def _require(path: Path) -> None:
    if not path.is_file():
        raise RunDamaged(f"{path}: is missing; restore it, or take it again with rtpiv acquire --resume --retake")


def run_of(path: Path) -> RunFolder | None:
    """Run to whose raw frames a path belongs; None for a file elsewhere."""
    folder = path.absolute().parent
    return RunFolder(folder.parent) if folder.name == "frames" and (folder.parent / FILE).is_file() else None


def _stamp(journal: Path) -> tuple[int, int]:
    facts = journal.stat() if journal.exists() else None
    return (0, 0) if facts is None else (facts.st_mtime_ns, facts.st_size)


class _Known(NamedTuple):
    """Facts that the journal has of a frame."""

    crc32: str
    bits: int


@lru_cache(maxsize=2)
def _frame_facts(run: RunFolder, stamp: tuple[int, int]) -> dict[str, _Known]:
    """Every frame that the journal of a run has, by the name of its file; read again if it changed."""
    entries = frame_entries(run.entries()).values()
    return {Path(entry["file"]).name: _Known(entry["crc32"], entry["bits"]) for entry in entries}


Frame = NDArray[Any]


class ReadAhead(ThreadPoolExecutor):
    """Frames of one size, by a thread of its own; it holds the first, and one that is asked for next.

    Parameters
    ----------
    paths : sequence of Path
        Acquired frames; the thread begins to look at them at once, from the first to the last.
    shape : (int, int)
        Rows and columns that each must have.
    """

    def __init__(self, paths: Sequence[Path], shape: tuple[int, int]) -> None:
        super().__init__(1, "rtpiv-frames")
        self._paths, self._shape = paths, shape
        self._first: list[Future[Frame]] = [self._read(0)] if paths else []
        self._others = [self.submit(self._look, path) for path in paths[1:]]

    def __exit__(self, *_: object) -> None:
        self.shutdown(cancel_futures=True)

    def require_sound(self) -> None:
        """Wait until all have been looked at; raise what is wrong with the first that is not sound.

        Raises
        ------
        FrameError, RunDamaged
            As `read_acquired`.
        """
        for first in self._first:
            first.result()
        for other in self._others:
            other.result()

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in their order."""
        ahead = self._first
        for number in range(len(self._paths)):
            frame = ahead[0].result()
            ahead = [self._read(number + 1)] if number + 1 < len(self._paths) else []
            yield frame

    def _read(self, number: int) -> Future[Frame]:
        return self.submit(read_acquired, self._paths[number], self._shape)

    def _look(self, path: Path) -> None:
        read_acquired(path, self._shape)
