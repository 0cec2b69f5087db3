"""Output folders: checked before work starts, locked against other processes, removed if they stay empty.

Without the lock two calls could mix their files: vectors of one scene beside the scene of the other.
"""

import errno
import json
import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from itertools import count
from pathlib import Path

from daq.atomic_write import write_json
from daq.errors import DiskError, RunUsageError
from ground.file_lock import folder_held

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
OF_VECTORS = ("evaluation.json", "series.json", "vectors.nc")  # files that tell what a folder holds
MADE_FROM = ".made_from.json"  # which file of a folder was made from what
_held: ContextVar[frozenset[Path]] = ContextVar("held", default=frozenset())  # by the call that is carried out


def _never(folder: Path) -> bool:
    """Return False: no earlier call may be resumed."""
    return False


@contextmanager
def results_in(
    out: Path | str | None,
    usual: str = "",
    goes_on: Callable[[Path], bool] = _never,
    copies: Collection[str] = (),
    overwrite: bool = False,
    made_from: Mapping[str, Path] | None = None,
) -> Iterator[Path]:
    """Lock the output folder of a call, which includes the calls that it makes.

    A new folder is removed if nothing is written there, or only copies of input by a call that is refused.

    Parameters
    ----------
    out : path or None
        The given folder, used as it is.
    usual : str
        Default name; with a number, "trace-2", if that folder has files or another process uses it.
    goes_on : callable, optional
        Test for a folder with an earlier, interrupted call of the same work.
    copies : collection of str
        Names of files that are copies of input, not results.
    overwrite : bool
        Overwrite files in the given folder: vectors of other frames, where `goes_on` identifies them, and files
        of `made_from`.
    made_from : mapping of str to path, optional
        Files that this call writes, and their input.  Existing ones that were made from other input, or by hand,
        are overwritten on request only; the folder keeps a list of them.

    Yields
    ------
    path
        The folder, which exists.

    Raises
    ------
    RunUsageError, DiskError
        As `require_folder`; or another process works in the folder, or it holds results of something else.
    """
    with ExitStack() as held:
        for folder in [Path(out)] if out is not None else _default_names(usual):
            is_ours = out is not None or goes_on(folder)
            if not is_ours and not _is_free(folder):
                continue
            try:
                held.enter_context(_hold_folder(require_folder(folder), (*copies, MADE_FROM)))
            except BlockingIOError:
                if is_ours:
                    cure = "let it finish, or name another folder with -o"
                    raise RunUsageError("another process puts results there", place=folder, cure=cure) from None
                continue
            if is_ours or _is_free(folder):
                break
            held.close()  # another process was faster, and has finished
        if goes_on is not _never and not goes_on(folder):
            others = [folder / name for name in OF_VECTORS if (folder / name).exists()]
            if others and not overwrite:
                cure = "give another folder with -o, or --overwrite"
                raise RunUsageError(
                    "holds vectors of other frames, or with another time between them", place=folder, cure=cure
                )
            for file in others:
                file.unlink()
        if made_from:
            _keep_others(folder, {name: os.path.realpath(path) for name, path in made_from.items()}, overwrite)
        yield folder


def _keep_others(folder: Path, made_from: Mapping[str, str], overwrite: bool) -> None:
    """Refuse to overwrite files that were made from other input; record those that will be written."""
    try:
        known = json.loads((folder / MADE_FROM).read_bytes())
    except (OSError, ValueError):
        known = {}
    known = known if isinstance(known, dict) else {}
    others = [name for name in made_from if (folder / name).exists() and known.get(name) != made_from[name]]
    if others and not overwrite:
        more = f" and {len(others) - 1} more that this call writes" if len(others) > 1 else ""
        cure = "give another folder with -o, or --overwrite"
        raise RunUsageError(f"holds {others[0]}{more}, made from something else", place=folder, cure=cure)
    # Before they are written, so that an interrupted call can be given again.
    write_json(folder / MADE_FROM, {**known, **made_from})


def _default_names(name: str) -> Iterator[Path]:
    yield Path(name)
    yield from (Path(f"{name}-{number}") for number in count(2))


def _is_free(folder: Path) -> bool:
    return not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))


@contextmanager
def _hold_folder(folder: Path, copies: Collection[str]) -> Iterator[None]:
    """Hold a folder, made if it is not there; BlockingIOError if another process does."""
    place = Path(os.path.realpath(folder))
    if place in _held.get():
        yield
        return
    made = [each for each in (place, *place.parents) if not each.exists()]
    place.mkdir(parents=True, exist_ok=True)
    with folder_held(place):
        before, left = _held.set(_held.get() | {place}), copies  # by a call that is refused
        try:
            yield
            left = ()
        finally:
            _held.reset(before)
            with suppress(OSError):
                if made and {file.name for file in place.iterdir()} <= set(left):
                    for file in place.iterdir():
                        file.unlink()
                    for each in made:  # those above it as far as nothing else is in them
                        each.rmdir()


def require_folder(out: Path | str) -> Path:
    """Return the output folder if it can be written to; it is not created yet.

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
            raise RunUsageError(
                f"is a file, so {out} cannot hold results", place=there, cure="give another folder with -o"
            )
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(b"\0")
            probe.flush()
    except RunUsageError:  # is a ValueError too
        raise
    except (OSError, ValueError) as error:
        reason = str(getattr(error, "strerror", None) or error).lower()
        if getattr(error, "errno", None) in FULL:
            raise DiskError(reason, place=out, cure="make room, or give another folder with -o") from None
        text = f"{out}: {reason}, so it cannot hold results; give another folder with -o"
        raise RunUsageError(text) from None
    return out
