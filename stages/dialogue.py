"""Dialogue on a serial port as text.

    # anything              for people
    @ 115200                the host has opened the port at this rate
    > 2f 0a                 the host has sent this
    < 40 30 31 +0.013       this came, so many seconds after what the host had sent last

`rtpiv doctor --probe` writes one.  With the environment variable RTPIV_RECORD every opened port writes one too,
a file of its own in the folder that the variable names, line by line.  A thread of its own writes it: a stop never
waits for a disk, and one that fails or hangs meanwhile ends the recording, never the motion.
"""

import os
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from queue import Full, Queue
from typing import TextIO

from stages.clock import Clock
from stages.errors import PortUnavailable

VARIABLE = "RTPIV_RECORD"
MOST_WAITING = 100_000  # lines that a slow disk may be behind
DISK_PATIENCE_S = 2.0  # for a disk, when a port is closed


class Dialogue:
    """Writes what is said on a port, line by line; from any thread.

    Parameters
    ----------
    write : callable
        Takes a line, without its end.
    clock : Clock
        Of the port.
    """

    def __init__(self, write: Callable[[str], object], clock: Clock) -> None:
        self._write, self._clock = write, clock
        self._lock = threading.Lock()
        self._sent_s = clock.now_s()

    def record_opening(self, baud: int) -> None:
        """The port has been opened."""
        with self._lock:
            self._write(f"@ {baud}")

    def record_sent(self, data: bytes) -> None:
        """The host sends bytes."""
        with self._lock:
            self._sent_s = self._clock.now_s()
            self._write(f"> {data.hex(' ')}")

    def came(self, data: bytes) -> None:
        """Bytes have come."""
        with self._lock:
            self._write(f"< {data.hex(' ')} +{max(0.0, self._clock.now_s() - self._sent_s):.6f}")


class RecordedFile:
    """A new file of a recording; a line is with the system as soon as the disk takes it."""

    def __init__(self, path: Path) -> None:
        file = path.open("x", encoding="utf-8", buffering=1, newline="\n")
        self._lines: Queue[str | None] = Queue(MOST_WAITING)
        self._is_whole = True
        self._writer = threading.Thread(target=self._write, args=(file,), name=f"recording {path}", daemon=True)
        self._writer.start()

    def line(self, text: str) -> None:
        """Add a line, without waiting; behind a line that the disk was too slow for there is none."""
        if self._is_whole:
            try:
                self._lines.put_nowait(text)
            except Full:
                self._is_whole = False

    def close(self) -> None:
        """End it, and wait for the disk a while."""
        with suppress(Full):
            self._lines.put_nowait(None)
        self._writer.join(DISK_PATIENCE_S)

    def _write(self, file: TextIO) -> None:
        with suppress(OSError), file:  # a disk that takes no more ends the recording
            while (text := self._lines.get()) is not None:
                file.write(f"{text}\n")
            os.fsync(file.fileno())


def recording_file(url: str) -> RecordedFile | None:
    """The file that keeps what is said on a port from now on; None if that is not wanted.

    Raises
    ------
    PortUnavailable
        It is wanted, and cannot be written.
    """
    folder = os.environ.get(VARIABLE)
    if not folder:
        return None
    name = re.sub(r"[^A-Za-z0-9]+", "-", url).strip("-")
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        file = _new_file(Path(folder), name)
    except OSError as error:
        raise PortUnavailable(
            f"{VARIABLE} names {folder}, where nothing can be written ({error.strerror}); name another folder"
        ) from error
    file.line(f"# {url}")
    return file


def _new_file(folder: Path, name: str) -> RecordedFile:
    """The first number that is free, also where other programs take numbers meanwhile."""
    for number in count(1):
        with suppress(FileExistsError):
            return RecordedFile(folder / f"{name}-{number}.txt")
    raise AssertionError("numbers do not end")
