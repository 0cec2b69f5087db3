"""Names within run folders and beside them: what is found without reading anything."""

import os
from pathlib import Path

FILE = "run.json"  # the record of a run; no other folder has one
CAMERAS = "cameras"  # within a run: one more run for each further camera
MAPS = "maps"  # beside runs: maps by the hash of their scene


def is_run(path: Path) -> bool:
    """Return whether a folder is a run, if only by the name of a record that can no longer be read."""
    return os.path.lexists(path / FILE)


def main_run(path: Path) -> Path:
    """Return the run that the folder of a further camera lies in; of any other folder itself."""
    path = Path(os.path.realpath(path))  # unlike `resolve`, no error at a loop of links
    return path.parents[1] if path.parent.name == CAMERAS else path


def camera_of(path: Path) -> str:
    """Return the name of the further camera whose folder in a run it is; "" of any other folder."""
    path = Path(os.path.realpath(path))
    return path.name if path.parent.name == CAMERAS else ""
