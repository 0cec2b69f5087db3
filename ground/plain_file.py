"""Files that are files: what is read is a plain file of bounded length, never a pipe, a device or a folder.

A pipe without a writer holds its reader for ever, and /dev/zero has no end.  Such a name is opened without
waiting, looked at and refused; between looking and reading no process can put another file in its place.
"""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

_OPENED = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_CLOEXEC", 0)
_OPENED |= getattr(os, "O_BINARY", 0)


def open_plain(path: Path | str) -> BufferedReader:
    """Open a plain file for reading.

    Raises
    ------
    OSError
        It cannot be opened, or is a folder, pipe or device; `strerror` is half a sentence, `filename` is set.
    """
    try:
        descriptor = os.open(path, _OPENED)
    except ValueError as error:  # a name with a zero byte
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    try:
        kind = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(kind):
            what = "a folder" if stat.S_ISDIR(kind) else "a pipe, socket or device"
            raise OSError(errno.EINVAL, f"is {what}, no file", str(path))
        return open(path, "rb", opener=lambda *_: descriptor)
    except BaseException:
        os.close(descriptor)
        raise


def read_plain(path: Path | str, most_bytes: int) -> bytes:
    """Read a plain file whole; OSError as `open_plain`, also where it is longer than `most_bytes`."""
    with open_plain(path) as stream:
        length = os.fstat(stream.fileno()).st_size
        content = stream.read(length) if length <= most_bytes else b""
    if length > most_bytes:
        raise OSError(errno.EFBIG, f"is larger than the {most_bytes} bytes allowed", str(path))
    return content
