"""Lasers that are open in any process of this user, and how another process asks for off.

A file for each laser, in a folder of this user alone, held by a lock for as long as the laser is open.  A file
that is not held is left from a process that was killed, whose watchdog has switched off; it is removed.  Nothing
here may keep a laser from being opened or switched off, so what cannot be written is not written.

`request_off` puts a second file beside it (`OffRequest`).  The process that has the laser open reads it like a
switch, every 10 ms and before it arms or fires: the laser goes off and stays off until a person releases it, which
removes the file.  Once everything reads back as off the process writes that into the file.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from pydantic import ValidationError

from daq.timing.timing_table import TimingTable
from ground.file_lock import hold
from ground.plain_file import read_plain
from stages.watchdog import needs_watchdog

MAX_NOTE_BYTES = 100_000
CONFIRMED = "off"  # content of a request once everything reads back as off


class OffRequest:
    """A request for off by another process, as a switch that is open while it stands.

    Parameters
    ----------
    path : Path or None
        Its file, which need not exist; None of a laser that no other process can find.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path

    @property
    def process(self) -> int:
        """Process that has the laser open."""
        return 0 if self._path is None else int(self._path.name.partition("-")[0])

    def make(self) -> None:
        """Ask for off; without effect where the file cannot be written."""
        if self._path is not None:
            with suppress(OSError):
                self._path.write_text("", encoding="ascii")

    def is_closed(self) -> bool:
        """Return whether off is not asked for."""
        return self._path is None or not self._path.exists()

    def confirm(self) -> None:
        """Write that everything reads back as off, into a request that still stands."""
        if self._path is not None:
            # "r+" makes no file: a person may have released the laser meanwhile, which would be undone
            with suppress(OSError), self._path.open("r+", encoding="ascii") as file:
                file.write(CONFIRMED)

    def is_confirmed(self) -> bool:
        """Return whether the process has written that everything reads back as off."""
        with suppress(OSError):
            return self._path is not None and self._path.read_text(encoding="ascii") == CONFIRMED
        return False

    def close(self) -> None:
        """Withdraw the request: a person has released the laser, or it is open no more."""
        if self._path is not None:
            with suppress(OSError):
                self._path.unlink()


@contextmanager
def register_laser(table: TimingTable) -> Iterator[OffRequest]:
    """Have a laser found by other processes while the block lasts, unless it is simulated in memory.

    Yields
    ------
    OffRequest
        By which another process asks for off.
    """
    held = _write_note(table) if needs_watchdog([table.port]) else None
    request = OffRequest(None if held is None else Path(held.name).with_suffix(".off"))
    try:
        yield request
    finally:
        if held is not None:
            held.close()  # first: Windows takes no open file away
            with suppress(OSError):
                Path(held.name).unlink()
        request.close()


def lasers_in_use() -> list[tuple[int, TimingTable]]:
    """Return process and timing unit of every laser that is open on this computer for this user."""
    return [(OffRequest(path).process, table) for path, table in _in_use()]


def request_off(port: str) -> list[OffRequest]:
    """Ask every process of this user that has the laser on a port open to switch it off."""
    requests = [
        OffRequest(path.with_suffix(".off"))
        for path, table in _in_use()
        if Path(table.port).resolve() == Path(port).resolve()
    ]
    for request in requests:
        request.make()
    return requests


def _in_use() -> list[tuple[Path, TimingTable]]:
    found = []
    with suppress(OSError):
        for path in sorted(_folder().glob("*.json")):
            with suppress(OSError, ValueError, ValidationError):
                if _is_held(path):
                    found.append((path, TimingTable.model_validate_json(read_plain(path, MAX_NOTE_BYTES))))
    return found


def _folder() -> Path:
    """Folder of this user alone; OSError if it is another user's, who could name any port in it."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(runtime) / "rtpiv-lasers" if runtime else Path(tempfile.gettempdir()) / f"rtpiv-lasers-{user}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if hasattr(os, "getuid") and (found.st_uid != user or found.st_mode & 0o022 or folder.is_symlink()):
        raise PermissionError(f"{folder} is not this user's alone")
    return folder


def _write_note(table: TimingTable) -> IO[str] | None:
    with suppress(OSError):
        file = tempfile.NamedTemporaryFile(  # noqa: SIM115 - open for as long as the laser is
            "w", prefix=f"{os.getpid()}-", suffix=".json", dir=_folder(), delete=False, encoding="utf-8"
        )
        hold(file, wait=True)
        file.write(table.model_dump_json(exclude_unset=True))
        file.flush()
        return file
    return None


def _is_held(path: Path) -> bool:
    """Return whether the process that wrote it still lives; a file that is not held is removed."""
    with path.open("rb") as file:
        try:
            hold(file)
        except OSError:
            return True
        is_left = file.seek(0, os.SEEK_END) > 0  # an empty one is being written
    if is_left:
        path.unlink()
        OffRequest(path.with_suffix(".off")).close()
    return False
