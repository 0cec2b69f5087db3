"""Frames are looked at while maps are made, and each is read while the one before it is worked on."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from daq.runs.acquired import read_acquired

Frame = NDArray[Any]


class ReadAhead:
    """Frames of one size, by a thread of its own; it holds the first, and one that is asked for next.

    Parameters
    ----------
    paths : sequence of Path
        Acquired frames; the thread begins to look at them at once, from the first to the last.
    shape : (int, int)
        Rows and columns that each must have.
    """

    def __init__(self, paths: Sequence[Path], shape: tuple[int, int]) -> None:
        self._paths, self._shape = paths, shape
        self._reader = ThreadPoolExecutor(1, "rtpiv-frames")
        self._first: list[Future[Frame]] = [self._read(0)] if paths else []
        self._others = [self._reader.submit(self._look, path) for path in paths[1:]]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.shutdown(wait=True, cancel_futures=True)

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
        return self._reader.submit(read_acquired, self._paths[number], self._shape)

    def _look(self, path: Path) -> None:
        read_acquired(path, self._shape)
