"""A file or folder that one process holds, until it closes it or ends, however that is.

Only who asks is kept away: nothing else knows of such locks (flock(2)).  Windows locks bytes, and a program that
reads or writes them is kept away; so one is held that lies far behind all that a file holds.  It opens no
folders: for each that is held a file stands in the user's folder for temporary ones.
"""

import errno
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from os import O_CREAT, O_RDONLY, O_RDWR, SEEK_CUR, SEEK_SET, close, fsencode, fstat, lseek
from os import open as open_descriptor
from os.path import samestat
from pathlib import Path
from tempfile import gettempdir
from typing import Protocol

try:
    from fcntl import LOCK_EX, LOCK_NB, LOCK_UN, flock
except ImportError:  # Windows
    flock = None  # type: ignore[assignment]
    from msvcrt import LK_NBLCK, locking  # type: ignore[attr-defined,unused-ignore]

FAR = 1 << 40  # bytes; no file of ours is as long
LOOK_S = 0.02  # between two looks of who waits for a byte
HELD_BY_OTHERS = (errno.EACCES, errno.EDEADLK)  # what `msvcrt.locking` says


class Opened(Protocol):
    """An open file."""

    def fileno(self) -> int:
        """Its descriptor."""


def hold(file: Opened | int, wait: bool = False) -> None:
    """Hold an open file.

    Parameters
    ----------
    file : file or int
        It, or its descriptor.
    wait : bool
        Wait for its holder.

    Raises
    ------
    BlockingIOError
        Another process holds it, and this one does not wait.
    OSError
        This file cannot be held.
    """
    if flock is not None:
        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)
        return
    descriptor = file if isinstance(file, int) else file.fileno()
    while not _byte_held(descriptor):
        if not wait:
            raise BlockingIOError(errno.EAGAIN, "another process holds it")
        time.sleep(LOOK_S)


def _byte_held(descriptor: int) -> bool:
    """Hold the byte that stands for an open file; False if another process does."""
    place = lseek(descriptor, 0, SEEK_CUR)
    lseek(descriptor, FAR, SEEK_SET)
    try:
        locking(descriptor, LK_NBLCK, 1)
    except OSError as error:
        if error.errno not in HELD_BY_OTHERS:
            raise
        return False
    finally:
        lseek(descriptor, place, SEEK_SET)
    return True


@contextmanager
def folder_held(folder: Path) -> Iterator[None]:
    """Hold a folder while the block lasts; BlockingIOError if another process does, or has just taken it away.

    A folder that cannot be held keeps no process away.
    """
    if flock is None:
        with _standing_for(folder):
            yield
        return
    try:
        descriptor = open_descriptor(folder, O_RDONLY)
    except FileNotFoundError:
        raise BlockingIOError from None
    try:
        try:
            hold(descriptor)
        except OSError as error:
            if isinstance(error, BlockingIOError):
                raise  # else it is of a file system without locks
        if not _is_there(folder, descriptor):
            raise BlockingIOError
        yield
    finally:
        with suppress(OSError):
            # Processes that were forked meanwhile have the descriptor as well
            flock(descriptor, LOCK_UN)
        close(descriptor)


@contextmanager
def _standing_for(folder: Path) -> Iterator[None]:
    """Hold the file that stands for a folder."""
    name = sha256(fsencode(folder.resolve())).hexdigest()[:32]
    path = Path(gettempdir()) / f"rtpiv-{name}.held"
    descriptor = open_descriptor(path, O_RDWR | O_CREAT, 0o600)
    try:
        hold(descriptor)
        if not folder.is_dir():
            raise BlockingIOError
        yield
    finally:
        close(descriptor)
        with suppress(OSError):  # another process has it open by now
            path.unlink()


def _is_there(folder: Path, descriptor: int) -> bool:
    """Return whether a folder that was opened still has its name."""
    try:
        return samestat(folder.stat(), fstat(descriptor))
    except FileNotFoundError:
        return False
