"""`rtpiv examples`: the example scenes, benches and plans, to read and to change."""

import shutil
from pathlib import Path

import daq.example_files as example_files
from daq.errors import DiskError, RunUsageError
from daq.terminal import console
from daq.verbs.output import require_folder
from daq.whole_text import why


def examples(out: Path | str = Path("examples")) -> Path:
    """Copy the examples that came with the program.

    Parameters
    ----------
    out : path
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
    out = require_folder(out)
    if out.exists() and any(out.iterdir()):
        raise RunUsageError(f"{out}: has files already; give another folder")
    try:
        shutil.copytree(
            example_files.examples(), out, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True
        )
    except OSError as error:
        raise DiskError(f"{out}: {why(error)}; give another folder") from None
    console().print(f"{len(list(out.rglob('*.yaml')))} files and tour.py are in {out}", soft_wrap=True)
    return out
