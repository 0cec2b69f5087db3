"""`rtpiv examples`: the example scenes, benches and plans, to read and to change."""

import shutil
from pathlib import Path

import rtpiv.example_files as example_files
from daq.atomic_write import copy_whole, why
from daq.errors import DiskError, RunUsageError
from ground.terminal import console
from rtpiv.verbs.paths import Named, require_folder


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
    out = require_folder(folder)
    if out.exists() and any(out.iterdir()):
        raise RunUsageError("has files already", place=out, cure="give another folder")
    source, made = example_files.examples(), not out.exists()
    try:
        for path in sorted(source.rglob("*")):
            copy = out / path.relative_to(source)
            if path.is_file() and "__pycache__" not in path.parts:
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy_whole(path, copy)
    except BaseException as error:
        _clear(out, made)
        if isinstance(error, OSError):
            raise DiskError(why(error), place=out, cure="make room, then give the same command again") from None
        raise
    console().print(f"{len(list(out.rglob('*.yaml')))} files and tour.py are in {out}", soft_wrap=True)
    return out


def _clear(out: Path, made: bool) -> None:
    """Take away what a copy that failed has left, so that it can be asked for again."""
    for path in [out] if made else out.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
