"""A video of frames: .avi, .mp4, .mov, .mkv, and .cine of Phantom cameras.  Reading needs PyAV (extra `video`).

Frames are counted from 1 by when they were taken: where a camera lost one, so does its number, and nothing that
follows is in another pair for it.  A frame is read by its number in any process: from the last frame before it
that stands alone (in most recordings of cameras each does) the decoder works its way to it.  What the decoder
finds to be damaged is refused, with the frames that are made from it, up to the next that stands alone; left to
itself it would show what came before.  How much it finds is up to the packing (docs/files.md).

The light of a frame is its luma as stored, 8 bits or, of more, 16.  A video that is packed with a loss (H.264,
MPEG-4, MJPEG) has lost of each particle what an eye does not miss.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from io import BufferedReader
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from daq.errors import RunUsageError
from daq.frames.frame_in_file import OpenFile, as_it_is, frame_in
from daq.frames.pairing import NEIGHBOURS, PairedFrames, Pairing
from ground.memory import MOST_PX, require_memory
from ground.plain_file import open_plain
from ground.terminal import say_once
from piv.errors import FrameError
from piv.files.colours import SAID, grey_of

FORMATS = {".avi": "avi", ".mp4": "mov", ".mov": "mov", ".mkv": "matroska", ".cine": "cine"}
MOST_FRAMES = 10_000_000
KEPT = 4  # frames behind the newest that are not decoded again: those of pairs that overlap
MAX_TIME_JITTER = 0.25  # of the time between two frames; by more no camera's clock is off
COLOURED = 3  # how far chroma may be off its middle in a grey frame that was packed with a loss
logging.getLogger("libav").addHandler(logging.NullHandler())  # what it finds is in our one sentence
_DAMAGED = "is damaged, or made from a frame that is; leave it out, or copy the video from the camera again"


class _Packed(NamedTuple):
    """A frame as the file has it: when it was taken, in the file's own units, and whether it stands alone."""

    time: int
    alone: bool


class Video(PairedFrames):
    """Frames of a video.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    FrameError
        It cannot be read, or its frames are not at equal distances in time.
    RunUsageError
        PyAV is not installed.
    """

    def __init__(self, path: Path, pairing: Pairing = NEIGHBOURS) -> None:
        self._path = path
        self._keep_numbered(_open(as_it_is(path)).numbers, pairing)

    @classmethod
    def takes(cls, path: Path) -> bool:
        """Return whether the name is that of a video as a whole."""
        return path.suffix.lower() in FORMATS


def is_image(place: Path) -> bool:
    """Return whether a name is that of one frame of a video."""
    found = frame_in(place)
    return found is not None and found[0].suffix.lower() in FORMATS


def read_image(place: Path) -> NDArray[Any]:
    """Read one frame; raises FrameError as `daq.frames.named_frame.read_named`."""
    found = frame_in(place)
    assert found is not None
    opened = _open(as_it_is(found[0]))
    try:
        return opened.frame(found[1])
    except FrameError as error:
        raise FrameError(f"{place}: {error}") from None


@lru_cache(maxsize=2)
def _open(file: OpenFile) -> "_Decoder":
    return _Decoder(file[0])


class _Decoder:
    """A video and how far it has been decoded."""

    def __init__(self, path: Path) -> None:
        try:
            import av
            import av.logging
        except ImportError:
            raise RunUsageError(f"{path}: reading a video needs PyAV; install rtpiv[video]") from None
        self._library, self._lock = av, Lock()
        av.logging.set_level(av.logging.ERROR)
        try:
            self._stream = open_plain(path)
            finalize(self, self._stream.close)
            self._video, self._track = self._from_start(self._stream, path)
            packed = self._look_through()
        except FrameError:
            raise
        except OSError as error:  # many of PyAV's own are as well
            raise FrameError(f"{path}: is not readable as a video ({error.strerror or error})") from None
        except self._library.error.FFmpegError as error:
            raise FrameError(f"{path}: is not readable as a video ({str(error)[:100]})") from None
        try:
            self._packed = _number_frames(packed)
        except FrameError as error:
            raise FrameError(f"{path}: {error}") from None
        self.shape = int(self._track.height), int(self._track.width)
        if not 0 < self.shape[0] * self.shape[1] <= MOST_PX:
            raise FrameError(f"{path}: is {self.shape[1]} x {self.shape[0]} px, which is no frame size")
        if self._track.frames > len(packed):
            say_once(f"{path}: holds {len(packed)} of its {self._track.frames} frames; the file is cut short")
        self._alone = np.array([number for number, each in self._packed.items() if each.alone], int)
        self._number_at = {packed.time: number for number, packed in self._packed.items()}
        self._recent: dict[int, NDArray[Any] | None] = {}  # None: damaged
        self._coming: Iterator[tuple[int, Any]] = iter(())
        self._next = 0  # number of the frame that comes at the earliest

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of its frames, 1 first."""
        return list(self._packed)

    def frame(self, number: int) -> NDArray[Any]:
        """Decode one frame; FrameError with the rest of a sentence where it is damaged or there is none."""
        if number not in self._packed:
            raise FrameError(f"the video has frames 1 to {max(self._packed)}, and no {number}")
        with self._lock:
            if number not in self._recent:
                with suppress(self._library.error.FFmpegError):  # it is not there then
                    self._go_to(number)
            found = self._recent.get(number)
        if found is None:
            raise FrameError(_DAMAGED)
        return found

    def _from_start(self, stream: BufferedReader, path: Path) -> tuple[Any, Any]:
        """Open it by the ending of its name alone: a playlist under another name opens nothing."""
        video = self._library.open(stream, format=FORMATS[path.suffix.lower()], metadata_errors="replace")
        if len(video.streams.video) != 1:
            raise FrameError(f"{path}: holds {len(video.streams.video)} videos; one is needed")
        track = video.streams.video[0]
        if track.codec_context is None:
            raise FrameError(f"{path}: its codec is not supported; convert it to FFV1, which is lossless")
        track.codec_context.options = {"err_detect": "explode+crccheck+bitstream+buffer"}
        track.codec_context.thread_count = 1  # a damaged frame is then the one that was put in
        return video, track

    def _look_through(self) -> list[_Packed]:
        """Times of all frames, without decoding one."""
        packed = []
        for packet in self._video.demux(self._track):
            if packet.size == 0:
                continue
            if packet.pts is None:
                raise FrameError(f"{self._stream.name}: contains no time stamps of its frames; save it as .mkv")
            packed.append(_Packed(int(packet.pts), bool(packet.is_keyframe)))
            if len(packed) > MOST_FRAMES:
                raise FrameError(f"{self._stream.name}: has more than {MOST_FRAMES} frames; cut it")
        return packed

    def _go_to(self, number: int) -> None:
        """Decode up to a frame, and keep it and a few before it."""
        before = int(np.searchsorted(self._alone, number, "right"))
        begin = int(self._alone[before - 1]) if before else min(self._packed)
        if not begin <= self._next <= number:
            require_memory(10.0 * self.shape[0] * self.shape[1], "a frame of the video")
            self._coming, self._next = self._decode(begin), begin
        for found, pixels in self._coming:  # ends where the file does, or where no more can be read of it
            self._recent[found] = pixels
            self._next = found + 1
            for old in [n for n in self._recent if n < found - KEPT or n > found]:
                del self._recent[old]
            if found >= number:
                break
        self._recent.setdefault(number, None)

    def _decode(self, begin: int) -> Iterator[tuple[int, NDArray[Any] | None]]:
        """Frames from one that stands alone, in the order of their numbers; None for one that is damaged."""
        self._track.codec_context.flush_buffers()
        sound = True
        for packet in self._packets(self._packed[begin].time):
            try:
                with self._library.logging.Capture() as said:
                    frames = packet.decode()
            except self._library.error.FFmpegError:
                sound = False
                continue
            changed = any(
                "CRC mismatch" in text for *_, text in said
            )  # FFV1 says it, and shows the frame all the same
            for frame in frames:
                number = self._number_at.get(frame.pts)
                if number is None or number < begin:
                    continue
                sound = not (changed or frame.is_corrupt) and (sound or bool(frame.key_frame))
                good = sound and (frame.height, frame.width) == self.shape
                yield number, _grey(frame) if good else None

    def _packets(self, time: int) -> Iterator[Any]:
        """Yield the packets from a time on, up to where the file cannot be read any more."""
        with suppress(self._library.error.FFmpegError):
            self._video.seek(time, stream=self._track)
            yield from self._video.demux(self._track)


def _number_frames(packed: list[_Packed]) -> dict[int, _Packed]:
    """Frames by number: one more from each to the next, and more where the times say that some are missing."""
    if not packed:
        raise FrameError("holds no frame that can be read")
    in_order = sorted(packed)
    times = np.array([each.time for each in in_order], float)
    steps = np.diff(times)
    if not len(steps):
        return {1: in_order[0]}
    apart = steps / np.median(steps) if np.median(steps) > 0 else np.zeros_like(steps)
    whole = np.rint(apart)
    if (np.abs(apart - whole) > MAX_TIME_JITTER).any() or (whole < 1).any():
        raise FrameError(
            "its frames are not at equal distances in time, as those of a phone often are not; record at one rate"
        )
    numbers = 1 + np.concatenate([[0], np.cumsum(whole)]).astype(int)
    return dict(zip(numbers.tolist(), in_order, strict=True))


def _grey(frame: Any) -> NDArray[Any]:  # noqa: ANN401 - PyAV's frame
    """Grey of a frame, rows from the top."""
    if any(plane.line_size < 0 for plane in frame.planes):  # rows from the bottom, which PyAV reads past their end
        return np.ascontiguousarray(_grey(_flip(frame))[::-1])
    kind = frame.format
    if kind.is_bayer:
        raise FrameError("is raw of a colour sensor (Bayer); export it as grey or as colours")
    bits = kind.components[0].bits
    if kind.is_rgb or kind.has_palette:
        return grey_of(frame.to_ndarray(format="rgb48le" if bits > 8 else "rgb24"))
    if len(kind.components) > 2 and kind.is_planar and bits == 8 and _is_coloured(frame):
        say_once(SAID)
    if (len(kind.components) > 1 and not kind.is_planar) or kind.is_big_endian:
        frame = frame.reformat(format="gray16le" if bits > 8 else "gray")
    return _plane(frame.planes[0], np.uint8 if bits <= 8 else np.uint16)


def _flip(frame: Any) -> Any:  # noqa: ANN401
    """The same frame with its rows the other way round, in memory as they are counted."""
    from av.filter import Graph

    graph = Graph()
    graph.link_nodes(
        graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base),
        graph.add("vflip"),
        graph.add("buffersink"),
    ).configure()
    graph.push(frame)
    return graph.pull()


def _is_coloured(frame: Any) -> bool:  # noqa: ANN401
    """Return whether the chroma of a frame is seen: grey that was packed as colours has next to none."""
    return any(
        int(np.abs(np.median(np.abs(_plane(plane, np.uint8).astype(np.int16) - 128)))) > COLOURED
        for plane in frame.planes[1:3]
    )


def _plane(plane: Any, kind: type[np.generic]) -> NDArray[Any]:  # noqa: ANN401
    """Rows of a plane without what fills them up."""
    item = np.dtype(kind).itemsize
    rows = np.frombuffer(plane, np.uint8)[: plane.line_size * plane.height].reshape(plane.height, plane.line_size)
    return np.ascontiguousarray(rows[:, : plane.width * item]).view(kind)
