"""`rtpiv setup examples`: copy the example scenes, benches and plans."""

import shutil
from pathlib import Path

import rtpiv.example_files as example_files
from daq.atomic_write import copy_whole, why
from daq.errors import DiskError, RunUsageError
from ground.terminal import console
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in


def examples(folder: Named = Path("examples"), /) -> Path:
    """Copy the examples that came with the program.

    Parameters
    ----------
    folder : path
        Folder that is not there yet, or empty.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    RunUsageError
        The folder is there already and has something in it.
    DiskError
        It cannot be written.
    """
    with results_in(folder) as out:
        if any(out.iterdir()):
            raise RunUsageError("has files already", place=out, cure="give another folder")
        source = example_files.examples()
        try:
            for path in sorted(source.rglob("*")):
                copy = out / path.relative_to(source)
                if path.is_file() and "__pycache__" not in path.parts:
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    copy_whole(path, copy)
        except BaseException as error:
            _clear(out)
            if isinstance(error, OSError):
                cure = "make room, then give the same command again"
                raise DiskError(why(error), place=out, cure=cure) from None
            raise
    console().print(f"{len(list(out.rglob('*.yaml')))} files and tour.py are in {out}", soft_wrap=True)
    return out


def _clear(out: Path) -> None:
    """Take away what a copy that failed has left, so that it can be asked for again."""
    for path in out.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
