"""The page of a mean that would show what it shows already is not drawn again.

`mean.json` beside it says from what it was drawn, as one hash, and the hashes of the files written with it:
vectors by the keys of their chunks, scene and fit, what is known of the velocity out of plane, records of the run,
and the sources of the program. A file that was changed or removed since is made again with all others.
"""

import hashlib
import json
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from daq.atomic_write import write_json
from ground.program_code import code_digest
from rtpiv.analysis.fit_beside import FIT_FILE, SCENE_FILE
from rtpiv.analysis.series.series_folder import FILE, MEAN
from rtpiv.analysis.series.series_view import SeriesView

STYLE = Path(__file__).with_name("page.css")
NOTE, PAGE = "mean.json", "mean.html"
WRITTEN = (".html", ".nc", ".png", ".svg", ".css")  # by a page, and the statistics themselves
RECORDS = (".json", ".jsonl", ".yaml")  # of a run: notes, readings, journal
PACKAGES = ("correction", "daq", "ground", "piv", "rtpiv", "tracer")


def page_key(view: SeriesView, shown: Iterable[object], run: Path | None = None) -> str:
    """Hash of all that the page of a mean shows.

    Parameters
    ----------
    view : SeriesView
        Of the series.
    shown : iterable
        What else decides what is on the page; each by its `repr`.
    run : Path, optional
        Folder of the run whose records it shows.
    """
    versions = [version(name) for name in ("rtpiv", "matplotlib", "numpy", "scipy")]
    digest = hashlib.sha256(repr((code_digest(*PACKAGES), versions, view.out_of_plane, *shown)).encode())
    files = [STYLE, *(view.folder / name for name in (FILE, SCENE_FILE, FIT_FILE))]
    files += [] if run is None else sorted(each for each in run.iterdir() if each.suffix in RECORDS)
    for file in files:
        digest.update(f"\0{file.name}\0".encode() + (file.read_bytes() if file.is_file() else b""))
    return digest.hexdigest()


def is_current(folder: Path, key: str) -> bool:
    """Return whether the page in a folder was drawn from this, and all files written with it are as they were."""
    try:
        note = json.loads((folder / NOTE).read_bytes())
        return bool(note["key"] == key and {PAGE, MEAN} <= set(note["files"]) and note["files"] == _hashes(folder))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def note_page(folder: Path, key: str) -> None:
    """Note from what the page in a folder was drawn; DiskError if that cannot be written."""
    write_json(folder / NOTE, {"key": key, "files": _hashes(folder)})


def _hashes(folder: Path) -> dict[str, str]:
    files = sorted(each for each in folder.iterdir() if each.suffix in WRITTEN and each.is_file())
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
