"""A frame that lies among others in one file: `run.set@25` is its name, counted from 1."""

import os
import re
from pathlib import Path

from piv.errors import FrameError

_NAME = re.compile(r"(.+)@([0-9]{1,8})", re.DOTALL)
# its name, length, time of change [ns], and the process that has it open
OpenFile = tuple[Path, int, int, int]


def frame_in(place: Path) -> tuple[Path, int] | None:
    """File and number of a frame; None if the name is not that of one."""
    found = _NAME.fullmatch(str(place))
    return None if found is None else (Path(found[1]), int(found[2]))


def as_it_is(path: Path) -> OpenFile:
    """Return the key of a file that is kept open: a changed file, or another process's, is opened anew.

    Raises
    ------
    FrameError
        It cannot be looked at.
    """
    try:
        facts = path.stat()
    except OSError as error:
        raise FrameError(f"{path}: cannot be read: {error.strerror or error}") from None
    return path, facts.st_size, facts.st_mtime_ns, os.getpid()
