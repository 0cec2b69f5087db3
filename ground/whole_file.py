"""Files that are whole or not there."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4


@contextmanager
def whole_file(path: Path, let_go: bool = False, among_many: bool = False) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name only when it is complete and on the disk.

    Parameters
    ----------
    path : Path
        Final name; a file of that name stays untouched until the new one replaces it.
    let_go : bool
        Do not keep the contents in the system's memory once they are on the disk.  A stream of frames would fill
        all of it within a minute, and finding ever new memory cost more than the writing.
    among_many : bool
        Others may write this file at the same time, on this computer or on another that sees its folder: the
        temporary name belongs to one process, and the last to finish gives the file its contents.

    Yields
    ------
    stream : binary file
        Written under a temporary name beside `path`; on any error the temporary file is removed.

    Raises
    ------
    OSError
        It cannot be written; `filename` is the final name, and `strerror` says why, also where a library that
        wrote to the stream left both out.
    """
    own = f".{uuid4().hex}" if among_many else ""
    temporary = path.with_name(f"{path.name}{own}.part")
    try:
        with temporary.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            if let_go and hasattr(os, "posix_fadvise"):
                os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        temporary.replace(path)
    except OSError as error:
        if error.errno is None:  # numpy: so many items requested, so many written
            raise OSError(errno.ENOSPC, f"the disk is full, it took only a part ({error})", str(path)) from error
        error.filename = str(path)
        raise
    finally:
        with suppress(OSError):  # a disk that has become read-only keeps it; that is no second error
            temporary.unlink(missing_ok=True)
