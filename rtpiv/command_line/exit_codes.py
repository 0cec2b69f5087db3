"""What the end of a verb means to the shell, and the one sentence that a person reads about it.

    0 done    2 usage or configuration    3 device, disk or memory    4 interrupted and resumable

What is raised on purpose says its own code (`ground.errors.RtpivError`).  Other errors keep their traceback: they
are bugs; but what the system itself refuses, a full disk, a missing permission, no memory, is none, wherever it
happens.
"""

import errno
from pathlib import Path

from ground.errors import DEVICE as DEVICE
from ground.errors import INTERRUPTED as INTERRUPTED
from ground.errors import USAGE as USAGE
from ground.errors import RtpivError
from ground.printable import printable

DONE = 0
LONGEST_LINE = 1000  # characters of a problem that are shown
_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


def exit_code(error: BaseException) -> int | None:
    """Exit code of an error that a person can cure; None for a bug."""
    if isinstance(error, RtpivError):
        return error.exit_code
    if isinstance(error, MemoryError):
        return DEVICE
    if isinstance(error, OSError):  # an output folder that cannot be one, a full disk
        return USAGE if error.filename is not None and error.errno not in _FULL else DEVICE
    return None


def sentence(error: BaseException, out: Path | None = None) -> str:
    """What to tell the person; several problems of a file stand in lines of their own.

    Parameters
    ----------
    error : exception
        With an exit code.
    out : Path, optional
        Where the verb writes: a library that fails in the middle of a file does not say which.
    """
    said = str(error)
    if isinstance(error, MemoryError):
        more = f" ({said[0].lower()}{said[1:]})" if said else ""
        said = f"there is not enough memory{more}; end other programs, or give smaller or fewer frames"
    elif isinstance(error, OSError) and error.strerror:
        cure = "make room on the disk" if error.errno in _FULL else "give another path, or mend this one"
        name = error.filename if error.filename is not None else (out or "what it writes or prints")
        said = f"{name}: {error.strerror.lower()}; {cure}"
    return "\n".join(printable(_shortened(line)) for line in said.splitlines()) or type(error).__name__


def _shortened(line: str) -> str:
    """The beginning, with the name of the file, and the end, with the cure."""
    half = LONGEST_LINE // 2
    return line if len(line) <= LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"
