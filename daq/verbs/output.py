"""The folder for results, tried before work starts: nobody waits a minute to hear that it cannot be written to."""

import errno
import tempfile
from contextlib import suppress
from pathlib import Path

from daq.errors import DiskError, RunUsageError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def require_folder(out: Path | str) -> Path:
    """Return the folder for results if it can be written to; it is not made yet if it is not there.

    Parameters
    ----------
    out : path
        The folder.

    Raises
    ------
    RunUsageError
        It is a file, lies in one, or may not be written to; the message says where that begins.
    DiskError
        The disk is full.
    """
    out = Path(out)
    try:
        with suppress(FileNotFoundError):
            out.lstat()  # a name that no folder can have is refused by the system
        there = next(place for place in (out, *out.absolute().parents) if place.exists())
        if not there.is_dir():
            raise RunUsageError(f"{there}: is a file, so {out} cannot hold results; give another folder with -o")
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(b"\0")
            probe.flush()
    except (OSError, ValueError) as error:
        reason = str(getattr(error, "strerror", None) or error).lower()
        if getattr(error, "errno", None) in FULL:
            raise DiskError(f"{out}: {reason}; make room, or give another folder with -o") from None
        text = f"{out}: {reason}, so it cannot hold results; give another folder with -o"
        raise RunUsageError(text) from None
    return out
