"""The journal of a run: one JSON line for everything that has happened, appended, never changed.

Kinds of lines:

    session   a process began to work on the run (the first, or one that resumes)
    frame     a frame is on the disk under its final name: positions, checksum, both clocks
    step      all frames of a step are on the disk, and the gaps of one that may have some
    camera    clock and temperature of the camera between steps
    arm       a step that keeps what it has goes on behind its last frame, and why
    look      what the frames of a step of an alignment show
    discard   frames of a step that was cut off; the step is taken again and their files are gone
    miss      axes stood elsewhere than a step had sent them: planned and measured positions; the step has failed
    counts    what became of every triggered frame of this session
    end       a session ended by itself, and why
    doubt     a frame of this session may not show what its line says

What the lines hold is said in runs.journal_lines; each carries its seal, see runs.seal.

A killed process may leave a part of a last line; it is ignored on reading and cut off before anything is appended.
Lines reach the operating system at once (kill -9 loses none) and the disk at the end of a step or after
`SYNC_S`, whichever comes first (power loss).
"""

import json
import os
import re
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from pydantic_core import from_json

from daq.atomic_write import disk_errors
from daq.errors import DiskError, RunDamaged, RunUnsuitable
from daq.runs.journal_lines import LINE, FrameEntry
from daq.runs.journal_lines import Entry as Entry  # what readers of a journal hold in their hands
from daq.runs.records import CURE, parse_record
from daq.runs.seal import add_seal
from ground.file_lock import hold
from ground.plain_file import open_plain

SYNC_S = 0.25
LONGEST_LINE = 100_000_000  # bytes; a line that discards a million frames has 8 MB
_MORE_THAN_WHOLE = re.compile(rb'"seal":"[0-9a-f]{8}"\}.', re.DOTALL)


def read_journal(path: Path, has_seals: bool = True) -> list[Entry]:
    """Return the whole lines of a journal, in order; [] if there is none yet.

    Parameters
    ----------
    path : Path
        The file.
    has_seals : bool
        Whether every line must carry its seal: since layout 2 of the run folder.

    Raises
    ------
    RunDamaged
        A line is not what was written, or holds what no run writes; the message names it.
    """
    try:
        return list(_entries(path, has_seals)) if path.exists() else []
    except OSError as error:
        raise RunDamaged(f"{path}: cannot be read ({error.strerror}); {CURE}") from None


def _entries(path: Path, has_seals: bool) -> Iterator[Entry]:
    shared: dict[object, object] = {}
    with open_plain(path) as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), b""), start=1):
            if not line.endswith(b"\n"):
                if not _is_torn(line):
                    raise RunDamaged(f"{path}:{number}: the end of the file is damaged; {CURE}")
                return
            entry: Entry = parse_record(LINE, line, path, number, has_seals)
            yield FrameEntry(entry, shared) if entry["kind"] == "frame" else entry


def _is_torn(line: bytes) -> bool:
    """Return whether a last line without its end is what a kill leaves: the beginning of a line, and no more.

    A power cut may leave zeros where the rest was to be.
    """
    line = line.rstrip(b"\0")
    try:
        from_json(line or b"{", allow_partial="trailing-strings")
    except ValueError:
        return False
    return b'{"kind":'.startswith(line[:8]) and not _MORE_THAN_WHOLE.search(line)


def utc_now() -> str:
    """Now, as records have it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class Journal:
    """Appends to a journal; safe for several threads.

    Parameters
    ----------
    path : Path
        The file; made if missing.

    Raises
    ------
    RunUnsuitable
        Another process works on this run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._synced_s = time.monotonic()
        try:
            self._file = path.open("ab", buffering=0)
            hold(self._file)
            _cut_torn_line(path)
            self._whole_bytes = path.stat().st_size
        except BlockingIOError as error:
            self._file.close()
            raise RunUnsuitable(f"{path.parent}: another process works on this run; let it finish") from error
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
        record = json.dumps({"kind": kind, **fields}, separators=(",", ":"), allow_nan=False)
        line = add_seal(record.encode()) + b"\n"
        with self._lock, disk_errors(self.path, "make room, then resume the run"):
            self._write(line)
            now_s = time.monotonic()
            if sync or now_s - self._synced_s > SYNC_S:
                os.fsync(self._file.fileno())
                self._synced_s = now_s

    def close(self) -> None:
        """Bring everything to the disk and close."""
        with self._lock:
            if not self._file.closed:
                os.fsync(self._file.fileno())
                self._file.close()

    def _write(self, line: bytes) -> None:
        try:
            rest = memoryview(line)
            while rest:  # a disk that is nearly full takes a part
                rest = rest[os.write(self._file.fileno(), rest) :]
        except OSError:
            with suppress(OSError):  # the next line must not continue a torn one: room may come back before it
                os.ftruncate(self._file.fileno(), self._whole_bytes)
            raise
        self._whole_bytes += len(line)


def _cut_torn_line(path: Path) -> None:
    if not path.exists():
        return
    with path.open("r+b") as file:
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if whole != len(data):
            file.truncate(whole)
            os.fsync(file.fileno())
