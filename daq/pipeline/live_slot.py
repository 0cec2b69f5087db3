"""The last snapshot of a run, where another process can look at it: one place in memory that both have mapped.

    writer (preview thread)  --snapshot-->  file of fixed size, two halves  --snapshot-->  readers, as many as like
                        <--asked---  when a viewer has last looked

The measurement never waits.  The writer fills the half that was not shown last and then says which one is
newer; each half has a count that is odd while it is written.  A reader makes of a half what it needs, where it
lies, and keeps that only if the count was even and the same before and after: else the writer has overtaken it,
and it looks again.  A snapshot not looked at is gone; the number of the snapshot says how many that were.

Readers leave the time at which they look, so that a writer without viewers need not copy. It is all that the
writer ever reads here: whatever a reader does to the file, the writer copies too often or too rarely.
"""

import json
import mmap
import os
import struct
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.errors import DaqError

MAGIC = b"rtpivlv1"
HEAD = struct.Struct("<8sQQQ")  # magic, bytes of a half, snapshots so far, which half is newest
ASKED = struct.Struct("<q")  # monotonic clock of the last look [ns]
HALVES = 64  # bytes before the first half: HEAD, ASKED, nothing
HALF = struct.Struct("<QIIq")  # count, bytes of words, number of pictures, monotonic clock [ns]
PICTURE = struct.Struct("<16sIIcxxx")  # name, height, width, type
WORDS_BYTES = 65_536
MOST_PICTURES = 4
MAX_SLOT_BYTES = 1 << 31
READ_ATTEMPTS = 50
WATCHED_S = 2.0  # after a look a viewer is assumed to be there still
T = TypeVar("T")
TYPES: dict[bytes, np.dtype[Any]] = {b"H": np.dtype("<u2"), b"f": np.dtype("<f4")}
CODES = {dtype: code for code, dtype in TYPES.items()}


class NoSlotError(DaqError):
    """There is no slot to look into, or it is not one."""


@dataclass(frozen=True)
class Snapshot:
    """Frame and views of one moment.

    Parameters
    ----------
    number : int
        Counted from 1; gaps are snapshots not looked at.
    words : dict
        What is known beside the pictures.
    pictures : dict
        Name to pixels (H, W), uint16 or float32.
    taken_ns : int
        When it was shown, on `time.monotonic_ns`.
    """

    number: int
    words: dict[str, Any]
    pictures: dict[str, NDArray[Any]]
    taken_ns: int = 0


class SlotWriter:
    """The side of the measurement.

    Parameters
    ----------
    most_bytes : int
        Bytes of all pictures of a snapshot together.
    """

    def __init__(self, most_bytes: int) -> None:
        half = HALF.size + WORDS_BYTES + MOST_PICTURES * PICTURE.size + most_bytes
        if HALVES + 2 * half > MAX_SLOT_BYTES:
            raise NoSlotError(f"frames of {most_bytes / 1e6:.0f} MB are too large to be shown live; omit --live")
        folder = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
        handle, name = tempfile.mkstemp(prefix="rtpiv-live-", dir=folder)  # mode 0600
        try:
            os.ftruncate(handle, HALVES + 2 * half)
            self._memory = mmap.mmap(handle, HALVES + 2 * half)
        finally:
            os.close(handle)
        self.path = Path(name)
        self._half, self._count = half, 0
        self._memory[: HEAD.size] = HEAD.pack(MAGIC, half, 0, 0)

    @property
    def is_watched(self) -> bool:
        """True if a viewer has looked lately."""
        return _is_watched(self._memory)

    def put(self, words: Mapping[str, Any], pictures: Mapping[str, NDArray[Any]]) -> None:
        """Show a snapshot; takes the time of a copy, and never waits.

        Pictures that do not fit are left out, and words that are too many: the run goes on.
        """
        self._count += 1
        now_ns = time.monotonic_ns()
        which = self._count % 2
        start = HALVES + which * self._half
        text = json.dumps(dict(words)).encode()
        text = text if len(text) <= WORDS_BYTES else b"{}"
        shown = [(name, pixels) for name, pixels in pictures.items() if pixels.dtype in CODES][:MOST_PICTURES]
        self._memory[start : start + HALF.size] = HALF.pack(2 * self._count - 1, len(text), len(shown), now_ns)
        at = start + HALF.size
        self._memory[at : at + len(text)] = text
        at += WORDS_BYTES
        data = at + MOST_PICTURES * PICTURE.size
        for name, pixels in shown:
            if data + pixels.nbytes > start + self._half:
                height = width = 0
            else:
                height, width = pixels.shape
                room = np.frombuffer(self._memory, pixels.dtype, height * width, data)
                np.copyto(room.reshape(height, width), pixels)
                del room
                data += pixels.nbytes
            self._memory[at : at + PICTURE.size] = PICTURE.pack(
                name.encode()[:16], height, width, CODES[pixels.dtype]
            )
            at += PICTURE.size
        self._memory[start : start + HALF.size] = HALF.pack(2 * self._count, len(text), len(shown), now_ns)
        self._memory[: HEAD.size] = HEAD.pack(MAGIC, self._half, self._count, which)

    def close(self) -> None:
        """Take the place down; readers keep what they have."""
        self.path.unlink(missing_ok=True)
        self._memory.close()


class SlotReader:
    """The side of the viewer.

    Parameters
    ----------
    path : Path
        File of the writer.

    Raises
    ------
    NoSlotError
        It is not there, or not a slot.
    """

    def __init__(self, path: Path) -> None:
        try:
            with path.open("r+b") as stream:
                self._memory = mmap.mmap(stream.fileno(), 0)
        except (OSError, ValueError) as error:
            raise NoSlotError(f"{path}: no frames are shown there ({error})") from None
        self.path = path
        magic, self._half, _, _ = self._head() if len(self._memory) >= HEAD.size else (b"", 0, 0, 0)
        if magic != MAGIC or HALVES + 2 * self._half != len(self._memory):
            raise NoSlotError(f"{path}: is not the live slot of a run")

    @property
    def number(self) -> int:
        """Number of the last snapshot; 0 before the first."""
        return int(self._head()[2])

    @property
    def is_over(self) -> bool:
        """True if the writer has taken the place down."""
        return not self.path.exists()

    def ask(self) -> None:
        """Note a look."""
        ASKED.pack_into(self._memory, HEAD.size, time.monotonic_ns())

    @property
    def is_watched(self) -> bool:
        """True if a viewer has looked lately."""
        return _is_watched(self._memory)

    def latest(self) -> Snapshot | None:
        """Return the last snapshot, copied whole; None as in `taken`."""
        return self.read(_copy_snapshot)

    def read(self, take: Callable[[Snapshot], T]) -> T | None:
        """Return what is made of the last snapshot; None before the first, or if the writer overtakes every look.

        Parameters
        ----------
        take : callable
            Gets the snapshot with pictures that may change while it looks, and must keep nothing of them; what it
            makes of a snapshot that changes is thrown away. It may be called again.
        """
        for _ in range(READ_ATTEMPTS):
            _, _, number, which = self._head()
            if number == 0:
                return None
            start = HALVES + which * self._half
            before, words, count, taken_ns = HALF.unpack_from(self._memory, start)
            if before % 2 == 0 and words <= WORDS_BYTES and count <= MOST_PICTURES:
                snapshot = self._view_snapshot(start, before // 2, words, count, taken_ns)
                made = None if snapshot is None else take(snapshot)
                del snapshot
                if made is not None and HALF.unpack_from(self._memory, start)[0] == before:
                    return made
            time.sleep(0.001)
        return None

    def close(self) -> None:
        """Look no more."""
        self._memory.close()

    def _head(self) -> tuple[bytes, int, int, int]:
        magic, half, number, which = HEAD.unpack_from(self._memory, 0)
        return magic, half, number, which & 1

    def _view_snapshot(self, start: int, number: int, words: int, count: int, taken_ns: int) -> Snapshot | None:
        """A snapshot where it lies; None where it cannot be one, because the writer was in it meanwhile."""
        at = start + HALF.size
        text = bytes(self._memory[at : at + words])
        at += WORDS_BYTES
        data, pictures = at + MOST_PICTURES * PICTURE.size, {}
        for _ in range(count):
            name, height, width, code = PICTURE.unpack_from(self._memory, at)
            at += PICTURE.size
            dtype = TYPES.get(code)
            if dtype is None or data + height * width * dtype.itemsize > start + self._half:
                return None
            if height and width:
                pixels = np.frombuffer(self._memory, dtype, height * width, data).reshape(height, width)
                pixels.flags.writeable = False
                pictures[name.rstrip(b"\0").decode(errors="replace")] = pixels
                data += height * width * dtype.itemsize
        try:
            known = json.loads(text)
        except ValueError:
            return None
        return Snapshot(number, known, pictures, taken_ns) if isinstance(known, dict) else None


def _is_watched(memory: mmap.mmap) -> bool:
    (asked_ns,) = ASKED.unpack_from(memory, HEAD.size)
    return 0 <= time.monotonic_ns() - int(asked_ns) < int(WATCHED_S * 1e9)


def _copy_snapshot(snapshot: Snapshot) -> Snapshot:
    pictures = {name: pixels.copy() for name, pixels in snapshot.pictures.items()}
    return replace(snapshot, pictures=pictures)
