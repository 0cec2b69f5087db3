"""A file or folder that one process holds, until it closes it or ends, however that is.

Only who asks is kept away: nothing else knows of such locks (flock(2)).  Where a system has none, as Windows,
nobody is.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import O_RDONLY, close, fstat
from os import open as open_descriptor
from os.path import samestat
from pathlib import Path
from typing import Protocol

try:
    from fcntl import LOCK_EX, LOCK_NB, LOCK_UN, flock
except ImportError:
    flock = None  # type: ignore[assignment]

HAS_LOCKS = flock is not None


class Opened(Protocol):
    """An open file."""

    def fileno(self) -> int:
        """Its descriptor."""
        ...


def hold(file: Opened | int, wait: bool = False) -> None:
    """Hold an open file.

    Parameters
    ----------
    file : file or int
        It, or its descriptor.
    wait : bool
        Wait for whoever holds it.

    Raises
    ------
    BlockingIOError
        Another process holds it, and nobody waits for that.
    OSError
        This file cannot be held.
    """
    if flock is not None:
        flock(file, LOCK_EX if wait else LOCK_EX | LOCK_NB)


@contextmanager
def folder_held(folder: Path) -> Iterator[None]:
    """Hold a folder while the block lasts; BlockingIOError if another process does, or has just taken it away.

    A folder that cannot be held keeps nobody away.
    """
    try:
        descriptor = open_descriptor(folder, O_RDONLY)
    except FileNotFoundError:
        raise BlockingIOError from None
    except OSError:  # Windows opens no folders
        yield
        return
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
        if flock is not None:
            with suppress(OSError):
                flock(descriptor, LOCK_UN)  # processes that were forked meanwhile have the descriptor as well
        close(descriptor)


def _is_there(folder: Path, descriptor: int) -> bool:
    """Whether a folder that was opened still has its name."""
    try:
        return samestat(folder.stat(), fstat(descriptor))
    except FileNotFoundError:
        return False
