"""The folder for results: tried before work starts, one process at a time in it, none left behind without any.

One that cannot be written to costs no minute of work.  Two calls at once would mix their files: vectors by one
scene beside the scene of the other.
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
    """No call has begun anything in a folder."""
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
    """Give a call the folder for its results, for itself alone, the calls in it included.

    A new one is taken away again if nothing is written there, or nothing but copies by a call that is refused.

    Parameters
    ----------
    out : path or None
        The folder that was named, which is taken as it is.
    usual : str
        Where results go if none was; with a number behind it, "trace-2", if something lies there already, or
        another process puts it there.
    goes_on : callable, optional
        Whether the work of this call has been begun in a folder, and goes on there.
    copies : collection of str
        Names of the files that are no results but copies of what was given.
    overwrite : bool
        Replace what lies in the folder that was named: vectors of other frames, where `goes_on` tells them apart,
        and files of `made_from`.
    made_from : mapping of str to path, optional
        Files that this call writes there, and from what. Those that are there and were made from something else,
        or by hand, are overwritten on request only; the folder keeps a list of them.

    Yields
    ------
    path
        The folder, which is there.

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
    """Refuse to overwrite files in a folder that were made from something else; list those that will be made."""
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
            raise RunUsageError(
                f"is a file, so {out} cannot hold results", place=there, cure="give another folder with -o"
            )
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(b"\0")
            probe.flush()
    except (OSError, ValueError) as error:
        reason = str(getattr(error, "strerror", None) or error).lower()
        if getattr(error, "errno", None) in FULL:
            raise DiskError(reason, place=out, cure="make room, or give another folder with -o") from None
        text = f"{out}: {reason}, so it cannot hold results; give another folder with -o"
        raise RunUsageError(text) from None
    return out
