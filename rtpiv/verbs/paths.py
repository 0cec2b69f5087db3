"""Files and folders as people name them, and the folder for results.

That is tried before work starts, so that a folder which cannot be written to costs no minute of work.
"""

import errno
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeAlias

from daq.errors import DiskError, RunUsageError
from ground.file_lock import folder_held
from tracer.scene.scene import Scene

Named: TypeAlias = str | Path


def path_of(named: Named | Scene | None) -> Path | None:
    """Return an optional path; RunUsageError for a scene, whose fit would not be found."""
    if isinstance(named, Scene):
        raise RunUsageError("give the scene's file: the fit beside it says how sure the map is")
    return None if named is None else Path(named)


def file_of(named: Named | Scene) -> Path:
    """Return the path of a file; RunUsageError as `path_of`."""
    found = path_of(named)
    assert found is not None
    return found


def paths_of(named: Sequence[Named] | Named) -> list[Path]:
    """Return several paths; one alone is a list of one."""
    return [Path(named)] if isinstance(named, str | Path) else [Path(one) for one in named]


def one_of(named: Sequence[Named] | Named) -> Path:
    """Return the one path that was named; of several runs of one plan the newest finished one, which is said.

    Raises
    ------
    RunUsageError
        Several paths that are not runs, or runs of several plans.
    """
    paths = paths_of(named)
    if len(paths) == 1:
        return paths[0]
    from daq.runs.run_folder import RunFolder  # most commands have no run
    from daq.runs.run_views import is_run
    from ground.terminal import console

    if not all(map(is_run, paths)):
        raise RunUsageError(
            f"one folder is wanted, not {len(paths)}: {', '.join(map(str, paths))}; give one of them"
        )
    runs = [RunFolder.open(path) for path in paths]
    plans = sorted({run.about["name"] for run in runs})
    newest = max(runs, key=lambda run: (run.is_done, run.path.name)).path
    if len(plans) > 1:
        raise RunUsageError(f"the runs are of several plans ({', '.join(plans)}); give one: {newest}?")
    finished = "finished " if RunFolder(newest).is_done else ""
    said = f"{len(runs)} runs of {plans[0]} are given; this is the newest {finished}one: {newest}"
    console().print(said, soft_wrap=True, highlight=False)
    return newest


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def folder_for(out: Path | str | None, usual: str, goes_on: Callable[[Path], bool] = lambda path: False) -> Path:
    """Return the folder for results of a call that may not have named one: never one with other results in it.

    Parameters
    ----------
    out : path or None
        The folder that was named, which is taken as it is.
    usual : str
        Where results go if none was; with a number behind it, "trace-2", if something lies there already.
    goes_on : callable, optional
        Whether the work of this call has been begun in a folder, and goes on there.

    Raises
    ------
    RunUsageError, DiskError
        As `require_folder`.
    """
    if out is not None:
        return require_folder(out)
    number, folder = 1, Path(usual)
    while folder.exists() and not goes_on(folder) and not (folder.is_dir() and not any(folder.iterdir())):
        number += 1
        folder = Path(f"{usual}-{number}")
    return require_folder(folder)


@contextmanager
def results_in(out: Path, copies: Collection[str]) -> Iterator[None]:
    """Let one process at a time put results into a folder, and leave no new one behind that has none.

    Two calls at once would mix their files: vectors by one scene beside the scene of the other.

    Parameters
    ----------
    out : path
        The folder for results.
    copies : collection of str
        Names of the files that are no results but copies of what was given.

    Raises
    ------
    RunUsageError
        Another process works in it.
    """
    was_there = out.exists()
    with suppress(OSError):  # said by who writes there
        out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        try:
            held.enter_context(folder_held(out))
        except BlockingIOError:
            text = f"{out}: another process puts results there; let it finish, or name another folder with -o"
            raise RunUsageError(text) from None
        left: Collection[str] = copies  # by a call that is refused
        try:
            yield
            left = ()
        finally:
            if not was_there:
                _removed_but_for_results(out, left)


def _removed_but_for_results(out: Path, copies: Collection[str]) -> None:
    """Take a folder away that is empty, or holds copies alone."""
    with suppress(OSError):
        left = list(out.iterdir())
        if {file.name for file in left} <= set(copies):
            for file in left:
                file.unlink()
            out.rmdir()


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
