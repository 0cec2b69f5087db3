"""Images of LaVision's DaVis: .im7 of one or more frames, .set of many.  Reading needs lvpyio (extra `davis`).

Frames are counted from 1 through all images of a set, in their order: of double frames, 1 and 2 are the A and
B of the first, 3 and 4 those of the second.  Values are counts as stored; where the file has a scale of
intensity other than counts, they are what it makes of them, as float32.

lvpyio fills up what a damaged file lacks, and says nothing.  What DaVis writes behind the pixels (date, version,
camera) tells: packed pixels that are cut short or damaged leave none of it, and such a file is refused.
"""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunUsageError
from daq.frames.frame_in_file import OpenFile, as_it_is, frame_in
from daq.frames.pairing import NEIGHBOURS, PairedFrames, Pairing
from ground.memory import MOST_PX, require_memory
from ground.plain_file import open_plain
from piv.errors import FrameError

IMAGE, SET = ".im7", ".set"
MOST_FRAMES = 10_000_000
ITS_OWN = {"LoadFile", "LoadSet", "LoadSetIndex", "LoadSetType", "_Header_MinimalVersion", "_Header_PackType"}
_CAMERA = re.compile(r"\s*([0-9]+)")  # of "1A: Imager Intense", its number


class DavisImages(PairedFrames):
    """Frames of a set, or of an image that holds several.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    FrameError
        It cannot be read, or shows what several cameras saw.
    RunUsageError
        lvpyio is not installed.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        self._path = path
        opened = _open(as_it_is(path))
        if len(cameras := opened.cameras()) > 1:
            first = opened.each // len(cameras) + 1
            raise FrameError(
                f"{path}: holds frames of cameras {', '.join(cameras)}; name two of one camera, such as"
                f" {path.name}@{first} {path.name}@{first + 1}, or export one camera from DaVis"
            )
        self._keep_numbered(range(1, opened.count + 1), pairing)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether the name is that of a set, or of an image that is not one frame."""
        if path.suffix.lower() == SET:
            return True
        if path.suffix.lower() != IMAGE or not path.is_file():
            return False
        try:
            return _open(as_it_is(path)).count != 1
        except (FrameError, RunUsageError):
            return True

    def file_of(self, place: Path) -> Path:
        """The image that a frame lies in, which of a set is in the folder beside it."""
        found, opened = frame_in(place), _open(as_it_is(self._path))
        assert found is not None
        return opened.files[(found[1] - 1) // opened.each] if opened.files else self._path


def is_image(place: Path) -> bool:
    """Return whether a name is that of one frame of DaVis, or of an image that may be one."""
    path, _ = frame_in(place) or (place, 1)
    return path.suffix.lower() in (IMAGE, SET)


def read_image(place: Path) -> NDArray[Any]:
    """Read one frame; raises FrameError as `daq.frames.named_frame.read_named`."""
    named = frame_in(place)
    path, number = named or (place, 1)
    opened = _open(as_it_is(path))
    if named is None and opened.count != 1:
        raise FrameError(
            f"{place}: holds {opened.count} frames; name one, such as {place.name}@1, or give the set it is in"
        )
    try:
        return opened.frame(number)
    except FrameError as error:
        raise FrameError(f"{place}: {error}") from None


@lru_cache(maxsize=2)
def _open(file: OpenFile) -> "_Davis":
    return _Davis(file[0])


class _Davis:
    """An image or a set that is open; what was read last is kept."""

    def __init__(self, path: Path) -> None:
        try:
            import lvpyio
        except ImportError:
            raise RunUsageError(
                f"{path}: reading DaVis images needs lvpyio; install rtpiv[davis], or export as TIFF from DaVis"
            ) from None
        self._library, self._path, self._lock = lvpyio, path, threading.Lock()
        self._set: Any = None
        self._last: tuple[int, Any] | None = None
        self.files: list[Path] = []
        try:
            with open_plain(path):  # no pipe; the rest its own library reads
                pass
            buffers = self._open_set() if path.suffix.lower() == SET else 1
            self.each = len(self._buffer(0)) if buffers else 0
        except FrameError as error:
            raise FrameError(f"{path}: {error}") from None
        except OSError as error:
            raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
        self.count = buffers * self.each
        if not 0 < self.count <= MOST_FRAMES:
            raise FrameError(f"{path}: holds {self.count} frames, and 1 to {MOST_FRAMES} are read")

    def _open_set(self) -> int:
        """Open the file as a set; return how many images it has."""
        with self._translate_errors():
            if self._library.is_multiset(str(self._path)):
                raise FrameError("holds sets, not images; name one of them")
            self._set = self._library.read_set(str(self._path))
            buffers = len(self._set)
        files = sorted(self._path.with_suffix("").glob(f"*{IMAGE}"))
        self.files = files if len(files) == buffers else []
        return buffers

    def cameras(self) -> list[str]:
        """Numbers of the cameras that its first frames are of, as far as it says."""
        names = (str(frame.attributes.get("CameraName", "")) for frame in self._buffer(0).frames)
        return sorted({found[1] for name in names if (found := _CAMERA.match(name))})

    def frame(self, number: int) -> NDArray[Any]:
        """One frame, 1 first; FrameError with the rest of a sentence."""
        if not 1 <= number <= self.count:
            raise FrameError(f"there are frames 1 to {self.count}, and no {number}")
        place, inside = divmod(number - 1, self.each)
        with self._lock:
            buffer = self._buffer(place)
            if len(buffer) != self.each:
                raise FrameError(f"is in an image of {len(buffer)} frames; the first image has {self.each}")
            return _counts(buffer[inside])

    def _buffer(self, place: int) -> Any:  # noqa: ANN401 - lvpyio's
        if self._last is None or self._last[0] != place:
            with self._translate_errors():
                buffer = self._library.read_buffer(str(self._path)) if self._set is None else self._set[place]
            if not set(buffer.attributes) - ITS_OWN:
                raise FrameError("is damaged or cut short: the trailer of DaVis is missing; copy it again")
            self._last = place, buffer
        return self._last[1]

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        """Turn what lvpyio finds into our sentence."""
        try:
            yield
        except FrameError:
            raise
        except (RuntimeError, ValueError, TypeError, OSError, IndexError, KeyError) as error:
            raise FrameError(f"cannot be read by lvpyio ({str(error)[:100]})") from None


def _counts(frame: Any) -> NDArray[Any]:  # noqa: ANN401 - lvpyio's
    """Counts of a frame (H, W), rows from the top."""
    if frame.type_id != "ImageFrame":
        raise FrameError("holds vectors, not pixels; give the images that they were made from")
    if len(frame.images) != 1:
        raise FrameError(
            f"holds {len(frame.images)} planes of a volume; export the one in the light sheet as TIFF"
        )
    if frame.attributes.get("RGBFrame", "0") != "0":
        raise FrameError("is raw of a colour sensor (Bayer); export it as grey or as colours")
    pixels = np.asarray(frame.images[0])
    if not 0 < pixels.size <= MOST_PX:
        raise FrameError(f"is {pixels.shape[1]} x {pixels.shape[0]} px, which is no frame size")
    if not np.asarray(frame.masks[0]).all():
        raise FrameError("is masked in DaVis; give the images as acquired, and the mask in the scene file")
    scale = frame.scales.i
    if (scale.slope, scale.offset) == (1.0, 0.0) and pixels.dtype in (np.uint8, np.uint16, np.float32):
        return np.array(pixels)  # lvpyio's own memory goes with its buffer
    require_memory(12.0 * pixels.size, "a frame of DaVis")
    scaled: NDArray[Any] = (scale.offset + pixels.astype(np.float64) * scale.slope).astype(np.float32)
    return scaled
