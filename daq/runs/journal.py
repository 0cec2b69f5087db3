"""The journal of a run: one JSON line for everything that has happened, appended, never changed.

Kinds of lines:

    session   a process began to work on the run (the first, or one that resumes)
    frame     a frame is on the disk under its final name: positions, checksum, both clocks
    step      all frames of a step are on the disk
    discard   frames of a step that was cut off; the step is taken again and their files are gone
    counts    what became of every triggered frame of this session
    end       a session ended by itself, and why

A killed process may leave half a last line; it is ignored on reading and cut off before anything is appended.
Lines reach the operating system at once (kill -9 loses none) and the disk at the end of a step or after
`SYNC_S`, whichever comes first (power loss).
"""

import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.errors import DiskError, ResumeRefused

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError:  # not a POSIX machine: nobody keeps a second process away there
    flock = None  # type: ignore[assignment]

SYNC_S = 0.25
MAX_LINE_BYTES = 1_000_000

Entry = dict[str, Any]


def read_journal(path: Path) -> list[Entry]:
    """Return the whole lines of a journal, in order; [] if there is none yet.

    Raises
    ------
    ResumeRefused
        A line before the last one is damaged: somebody edited the file.
    """
    if not path.exists():
        return []
    return list(_entries(path))


def _entries(path: Path) -> Iterator[Entry]:
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                entry = json.loads(line)
            except ValueError:
                entry = None
            if not isinstance(entry, dict) or "kind" not in entry:
                raise ResumeRefused(f"{path}:{number}: is damaged; restore the journal or begin a new run")
            yield entry


class Journal:
    """Appends to a journal; safe for several threads.

    Parameters
    ----------
    path : Path
        The file; made if missing.

    Raises
    ------
    ResumeRefused
        Another process works on this run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._synced_s = time.monotonic()
        try:
            self._file = path.open("ab", buffering=0)
            if flock is not None:
                flock(self._file, LOCK_EX | LOCK_NB)
            _cut_torn_line(path)
        except BlockingIOError as error:
            self._file.close()
            raise ResumeRefused(f"{path.parent}: another process works on this run; let it finish") from error
        except OSError as error:
            raise DiskError(f"{path}: {error.strerror}; check the disk") from error

    def append(self, kind: str, sync: bool = False, **fields: object) -> None:
        """Add a line.

        Parameters
        ----------
        kind : str
            See the module's text.
        sync : bool
            Whether it must be on the disk when this returns.
        **fields
            Its contents.

        Raises
        ------
        DiskError
            It cannot be written.
        """
        line = json.dumps({"kind": kind, **fields}, separators=(",", ":")).encode() + b"\n"
        with self._lock:
            try:
                self._write(line)
                now_s = time.monotonic()
                if sync or now_s - self._synced_s > SYNC_S:
                    os.fsync(self._file.fileno())
                    self._synced_s = now_s
            except OSError as error:
                raise DiskError(f"{self.path}: {error.strerror}; make room, then resume the run") from error

    def close(self) -> None:
        """Bring everything to the disk and close."""
        with self._lock:
            if not self._file.closed:
                os.fsync(self._file.fileno())
                self._file.close()

    def _write(self, line: bytes) -> None:
        written = self._file.write(line)
        if written != len(line):  # a full disk takes a part; the torn line is cut off by the next session
            os.write(self._file.fileno(), line[written or 0 :])


def _cut_torn_line(path: Path) -> None:
    if not path.exists():
        return
    with path.open("r+b") as file:
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if whole != len(data):
            file.truncate(whole)
            os.fsync(file.fileno())
