"""The run folder: everything about one acquisition, safe against a crash at any moment.

    runs/<UTC time>_<plan>/
        run.json        plan, bench, scene, hashes, versions; on the disk before the first frame
        frames/         000123.tif, raw, never written twice
        steps.jsonl     the journal, see daq.runs.journal
        corrected/      000123.tif, mask.tif; can be made again from the frames at any time
        camera.json     every setting the camera could tell, per session
        done.json       last: counts, latencies, checks; a run without it is not finished

Names in a journal or run.json are never trusted: every path that is read back must lie inside the folder.
Layout and reasons: docs/adr/0007-run-folder.md.
"""

import json
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from daq.errors import DiskError, ResumeRefused
from daq.plans.steps import Step
from daq.runs.journal import Entry, read_journal
from daq.runs.whole_text import sync_folder, write_json

LAYOUT = 1
PACKAGES = ("rtpiv", "numpy", "numba", "scipy", "opencv-contrib-python-headless", "tifffile", "harvesters")


def versions() -> dict[str, str]:
    """Versions of this program and what it computes with."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


@dataclass(frozen=True)
class RunFolder:
    """A run on the disk.

    Parameters
    ----------
    path : Path
        The folder.
    """

    path: Path

    @classmethod
    def create(cls, parent: Path, plan: str, about: Mapping[str, Any]) -> "RunFolder":
        """Make a new folder and write run.json; a name that is taken gets a number.

        Raises
        ------
        DiskError
            The folder cannot be made.
        """
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in plan)[:60] or "plan"
        try:
            parent.mkdir(parents=True, exist_ok=True)
            for number in range(1000):
                path = parent / (f"{stamp}_{safe}" + (f"_{number}" if number else ""))
                try:
                    path.mkdir()
                    break
                except FileExistsError:
                    continue
            (path / "frames").mkdir()
            (path / "corrected").mkdir()
        except OSError as error:
            raise DiskError(f"{parent}: {error.strerror}; choose another folder with -o") from error
        write_json(path / "run.json", {"layout": LAYOUT, **about})
        sync_folder(parent)
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Open an existing run.

        Raises
        ------
        ResumeRefused
            It is no run folder, or of an unknown layout.
        """
        folder = cls(path)
        if folder.about.get("layout") != LAYOUT:
            raise ResumeRefused(f"{path}: run.json has layout {folder.about.get('layout')!r}, known is {LAYOUT}")
        for name in ("frames", "corrected"):
            (path / name).mkdir(exist_ok=True)
        return folder

    @property
    def about(self) -> dict[str, Any]:
        """Contents of run.json."""
        try:
            tree = json.loads((self.path / "run.json").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ResumeRefused(f"{self.path}: is no run folder (run.json: {error})") from error
        if not isinstance(tree, dict):
            raise ResumeRefused(f"{self.path}: run.json is damaged")
        return tree

    @property
    def journal_path(self) -> Path:
        """The journal's file."""
        return self.path / "steps.jsonl"

    @property
    def is_done(self) -> bool:
        """Whether the run was finished."""
        return (self.path / "done.json").exists()

    def entries(self) -> list[Entry]:
        """Whole lines of the journal."""
        return read_journal(self.journal_path)

    def frame_path(self, number: int) -> Path:
        """File of a raw frame."""
        return self.path / "frames" / f"{number:06d}.tif"

    def corrected_path(self, number: int) -> Path:
        """File of a corrected frame."""
        return self.path / "corrected" / f"{number:06d}.tif"

    def absent(self, entries: Iterable[Entry]) -> list[int]:
        """Frames of the journal that have no file."""
        return [n for n, entry in frame_entries(entries).items() if not self.inside(str(entry["file"])).is_file()]

    def inside(self, name: str) -> Path:
        """Path of a name that was read from a file of the run.

        Raises
        ------
        ResumeRefused
            It leads out of the run folder.
        """
        path = (self.path / name).resolve()
        if not path.is_relative_to(self.path.resolve()):
            raise ResumeRefused(f"{self.path}: names {name!r}, which lies outside the run; refuse to touch it")
        return path


def frame_entries(entries: Iterable[Entry]) -> dict[int, Entry]:
    """Frame lines that still hold, by frame number: discarded ones are left out."""
    frames: dict[int, Entry] = {}
    for entry in entries:
        if entry["kind"] == "frame":
            frames[int(entry["frame"])] = entry
        elif entry["kind"] == "discard":
            for number in entry["frames"]:
                frames.pop(int(number), None)
    return frames


def finished_steps(entries: Iterable[Entry]) -> set[int]:
    """Steps whose every frame is on the disk."""
    return {int(entry["step"]) for entry in entries if entry["kind"] == "step"}


def remaining(steps: Iterable[Step], entries: Iterable[Entry]) -> list[Step]:
    """Plan minus journal."""
    done = finished_steps(entries)
    return [step for step in steps if step.index not in done]
