"""Which lasers are open in any process of this user: found by who has to switch off and has no bench file.

A file for each, in a folder of this user alone, held by a lock for as long as the laser is open.  What nobody
holds is left from a process that was killed, whose watchdog has switched off; it is taken away.  Nothing here may
keep a laser from being opened or switched off, so what cannot be written is not written.
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

MOST_BYTES = 100_000


@contextmanager
def noted(table: TimingTable) -> Iterator[None]:
    """Have a laser found by other processes while the block lasts; one that is simulated in memory is none."""
    held = _written(table) if needs_watchdog([table.port]) else None
    try:
        yield
    finally:
        if held is not None:
            held.close()  # first: Windows takes no open file away
            with suppress(OSError):
                Path(held.name).unlink()


def lasers_in_use() -> list[tuple[int, TimingTable]]:
    """Return process and timing unit of every laser that is open on this computer for this user."""
    found = []
    with suppress(OSError):
        for path in sorted(_folder().glob("*.json")):
            with suppress(OSError, ValueError, ValidationError):
                if _is_held(path):
                    table = TimingTable.model_validate_json(read_plain(path, MOST_BYTES))
                    found.append((int(path.name.partition("-")[0]), table))
    return found


def _folder() -> Path:
    """Folder of this user alone; OSError if it is somebody else's, who could name any port in it."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(runtime) / "rtpiv-lasers" if runtime else Path(tempfile.gettempdir()) / f"rtpiv-lasers-{user}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if hasattr(os, "getuid") and (found.st_uid != user or found.st_mode & 0o022 or folder.is_symlink()):
        raise PermissionError(f"{folder} is not this user's alone")
    return folder


def _written(table: TimingTable) -> IO[str] | None:
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
    """Whether the process that wrote it still lives; what nobody holds is taken away."""
    with path.open("rb") as file:
        try:
            hold(file)
        except OSError:
            return True
        is_left = file.seek(0, os.SEEK_END) > 0  # an empty one is being written
    if is_left:
        path.unlink()
    return False
