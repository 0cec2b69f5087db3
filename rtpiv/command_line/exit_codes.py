"""Exit codes of verbs, and the sentence that is printed for an error.

    0 done    2 usage or configuration    3 device, disk or memory    4 interrupted and resumable

Errors raised on purpose carry their code (`ground.errors.RtpivError`).  Others are bugs and keep their traceback,
except refusals of the system wherever they happen: a full disk, a missing permission, no memory.
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
    """Return the exit code of an error that the user can cure; None for a bug."""
    if isinstance(error, RtpivError):
        return error.exit_code
    if isinstance(error, MemoryError):
        return DEVICE
    if isinstance(error, OSError):  # an output folder that cannot be one, a full disk
        return USAGE if error.filename is not None and error.errno not in _FULL else DEVICE
    return None


def sentence(error: BaseException, out: Path | None = None) -> str:
    """Return the message for the user; several problems of a file have a line each.

    Parameters
    ----------
    error : exception
        With an exit code.
    out : Path, optional
        Output folder, for errors of libraries that do not name the file.
    """
    said = str(error)
    if isinstance(error, MemoryError):
        more = f" ({said[0].lower()}{said[1:]})" if said else ""
        said = f"there is not enough memory{more}; end other programs, or give smaller or fewer frames"
    elif isinstance(error, OSError) and error.strerror:
        cure = "make room on the disk" if error.errno in _FULL else "give another path, or mend this one"
        name = error.filename if error.filename is not None else (out or "output")
        said = f"{name}: {error.strerror.lower()}; {cure}"
    return "\n".join(printable(_shorten(line)) for line in said.splitlines()) or type(error).__name__


def _shorten(line: str) -> str:
    """Return the beginning, with the name of the file, and the end, with the cure."""
    half = LONGEST_LINE // 2
    return line if len(line) <= LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"
