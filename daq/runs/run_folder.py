"""The run folder: everything about one acquisition, safe against a crash at any moment.

    runs/<UTC time>_<plan>/
        run.json        plan, bench, scene, hashes, versions; on the disk before the first frame
        frames/         000123.tif, raw, never written twice
        steps.jsonl     the journal, see runs.journal
        corrected/      000123.tif, mask.tif; can be made again from the frames at any time
        camera_1.json   every setting the camera could tell, per session
        done.json       last: counts, latencies, the hash of the run; a run without it is not finished
        cameras/NAME/   a run folder like this one for each further camera, with the same steps and frame numbers

Nothing that is read back is trusted: records carry seals and are checked against types (runs.records), frames
carry checksums, and what they name must be of the plan and lie inside the folder.
Layout and reasons: docs/adr/0007-run-folder.md.
"""

import errno
import platform
import re
import shutil
import time
from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from daq.atomic_write import sync_folder
from daq.errors import DiskError, RunDamaged, RunUnsuitable
from daq.runs.journal import read_journal
from daq.runs.journal_lines import Entry, frame_name
from daq.runs.names import CAMERAS, FILE
from daq.runs.records import CURE
from daq.runs.run_file import LAYOUT, SEALED_FROM, PlannedStep, RunFile, read_run_file
from daq.runs.seal import write_record

if TYPE_CHECKING:
    from daq.plans.steps import Step

IDLE = frozenset({"session", "camera", "counts", "end"})  # lines of a session that came to nothing
DAY_S = 86_400.0
LEFT = re.compile(r"\.[0-9]{8}T[0-9]{6}Z_[A-Za-z0-9_-]+\.[0-9a-f]{32}\.part")
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
    def create(
        cls,
        parent: Path,
        plan: str,
        about: Mapping[str, Any],
        cameras: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> "RunFolder":
        """Make a new folder with its run.json, and in it those of further cameras; a taken name gets a number.

        It is made under a hidden name and gets its own when all of it is on the disk: a reader that finds a run
        folder whatever became of the program that made it, can open it. What such a program left there under a
        hidden name is removed after a day.

        Parameters
        ----------
        parent : Path
            Where it is made.
        plan : str
            Name of the plan.
        about : mapping
            What run.json says.
        cameras : mapping of str to mapping, optional
            The same for each further camera, by name.

        Raises
        ------
        DiskError
            The folder cannot be made.
        """
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in plan)[:60] or "plan"
        name = f"{stamp}_{safe}"
        hidden = parent / f".{name}.{uuid4().hex}.part"
        beside = dict(cameras or {})
        try:
            _make(hidden, {**about, **({"cameras": list(beside)} if beside else {})})
            for camera, its_own in beside.items():
                _make(hidden / CAMERAS / camera, its_own)
            path = _rename_free(hidden, parent, name)
            sync_folder(parent)
        except OSError as error:
            raise DiskError(f"{parent}: {error.strerror}; choose another folder with -o") from error
        finally:
            shutil.rmtree(hidden, ignore_errors=True)
        _sweep(parent)
        return cls(path)

    def remove_if_empty(self) -> bool:
        """Remove a run of which nothing was taken: no frame asked for, no light; return whether it was."""
        lines = self.entries()
        happened = any(line["kind"] not in IDLE or line.get("books", {}).get("triggered") for line in lines)
        if happened or any((self.path / "frames").iterdir()):
            return False
        hidden = self.path.with_name(f".{self.path.name}.{uuid4().hex}.part")
        self.path.rename(hidden)  # killed meanwhile, it leaves no half of a run
        shutil.rmtree(hidden)
        return True

    def cameras(self) -> "dict[str, RunFolder]":
        """Folders of the further cameras of this run, by name; RunUnsuitable or RunDamaged as for `open`."""
        names = self.about.get("cameras", ())
        return {name: RunFolder.open(self.inside(f"{CAMERAS}/{name}")) for name in names}

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Open an existing run.

        Raises
        ------
        RunUnsuitable
            It is not a run folder, of an unknown layout, or has links that lead out of it.
        RunDamaged
            run.json is not what was written.
        """
        folder = cls(path)
        read_run_file(path)
        for name in ("frames", "corrected"):
            folder.own(name).mkdir(exist_ok=True)
        return folder

    @property
    def about(self) -> RunFile:
        """Contents of run.json, checked; RunUnsuitable or RunDamaged as for `open`."""
        return read_run_file(self.path)

    @property
    def journal_path(self) -> Path:
        """The journal's file."""
        return self.path / "steps.jsonl"

    @property
    def is_done(self) -> bool:
        """True if the run was finished."""
        return (self.path / "done.json").exists()

    def entries(self) -> list[Entry]:
        """Whole lines of the journal, checked one by one and against the plan.

        Raises
        ------
        RunDamaged
            A line is not what was written, or says what this plan cannot have led to.
        """
        if not self.journal_path.exists():
            return []
        about = self.about
        entries = read_journal(self.journal_path, about["layout"] >= SEALED_FROM)
        for line, entry in enumerate(entries, start=1):
            if problem := _against_plan(entry, about["steps"]):
                raise RunDamaged(f"{self.journal_path}:{line}: {problem}; {CURE}")
        return entries

    def frame_path(self, number: int) -> Path:
        """File of a raw frame."""
        return self.path / frame_name(number)

    def correction_path(self, number: int) -> Path:
        """File of a corrected frame."""
        return self.path / "corrected" / f"{number:06d}.tif"

    def absent(self, entries: Iterable[Entry]) -> list[int]:
        """Frames of the journal that have no file."""
        return [n for n, entry in frame_entries(entries).items() if not self.inside(str(entry["file"])).is_file()]

    def own(self, name: str) -> Path:
        """Path of a folder or file of ours in the run that something will be written to.

        Raises
        ------
        RunUnsuitable
            It is a link that leads out of the run folder: write there by -o instead.
        """
        self.inside(name)
        return self.path / name

    def inside(self, name: str) -> Path:
        """Path of a name that was read from a file of the run.

        Raises
        ------
        RunUnsuitable
            It leads out of the run folder.
        """
        try:
            path = (self.path / name).resolve()
        except (OSError, RuntimeError) as error:  # a link to itself
            raise RunUnsuitable(f"{self.path}: {name!r} leads nowhere ({error})") from None
        if not path.is_relative_to(self.path.resolve()):
            raise RunUnsuitable(f"{self.path}: {name!r} is outside the run and is not changed; use -o")
        return path


def _make(folder: Path, about: Mapping[str, Any]) -> None:
    """Make the folder of one camera and write its run.json; OSError or DiskError if that cannot be."""
    for inner in ("frames", "corrected"):
        (folder / inner).mkdir(parents=True)
    write_record(folder / FILE, {"layout": LAYOUT, **about})


def _sweep(parent: Path) -> None:
    """Remove what programs killed while they made or removed a run left there a day ago: no frame is in it."""
    with suppress(OSError):  # a folder that another program sweeps, or that cannot be looked at, is no error
        for left in parent.iterdir():
            old = LEFT.fullmatch(left.name) and left.lstat().st_mtime < time.time() - DAY_S
            if old and not left.is_symlink() and not any(left.rglob("*.tif*")):
                shutil.rmtree(left, ignore_errors=True)


def _rename_free(hidden: Path, parent: Path, name: str) -> Path:
    """Give a folder its own name, or that with the first number that is free; OSError if there is none."""
    for number in range(1000):
        path = parent / (f"{name}_{number}" if number else name)
        if path.exists():
            continue
        try:
            return hidden.rename(path)
        except OSError:
            if not path.exists():  # else another program was faster: its folder is not empty, so it stays
                raise
    raise FileExistsError(errno.EEXIST, f"a thousand runs have the name {name}", str(parent))


def _against_plan(entry: Entry, steps: Sequence[PlannedStep]) -> str:
    """Return what contradicts the plan in a line of a journal; "" if nothing."""
    kind = entry["kind"]
    if kind == "discard":
        last = steps[-1] if steps else None
        frames = 0 if last is None else last["first_frame"] + last["frames"]
        outside = [number for number in entry["frames"] if number >= frames]
        return f"discards frame {outside[0]}, and the plan has {frames}" if outside else ""
    if kind not in ("frame", "step", "miss", "arm", "chunk", "look"):
        return ""
    number = entry["step"]
    if number >= len(steps):
        return f"is about step {number}, and the plan has {len(steps)}"
    if kind != "frame":
        return ""
    step, frame = steps[number], entry["frame"]
    if not 0 <= frame - step["first_frame"] < step["frames"]:
        return f"is about frame {frame}, which is none of step {number}"
    if entry["file"] != frame_name(frame):
        return f"names {entry['file']!r} for frame {frame}, which a run writes to {frame_name(frame)}"
    return ""


def frame_entries(entries: Iterable[Entry]) -> dict[int, Entry]:
    """Frame lines that still hold, by frame number: discarded ones are left out."""
    frames: dict[int, Entry] = {}
    for entry in entries:
        if entry["kind"] == "frame":
            frames[entry["frame"]] = entry
        elif entry["kind"] == "discard":
            for number in entry["frames"]:
                frames.pop(number, None)
    return frames


def steps_on_disk(entries: Iterable[Entry]) -> set[int]:
    """Steps whose every frame is on the disk: their line is there and no frame of theirs was discarded later."""
    finished: set[int] = set()
    step_of: dict[int, int] = {}
    for entry in entries:
        if entry["kind"] == "frame":
            step_of[entry["frame"]] = entry["step"]
        elif entry["kind"] == "step":
            finished.add(entry["step"])
        elif entry["kind"] == "discard":
            finished -= {step_of[number] for number in entry["frames"] if number in step_of}
    return finished


def remaining(steps: Iterable["Step"], entries: Iterable[Entry], again: Container[int] = ()) -> list["Step"]:
    """Plan minus journal, and the finished steps that are to be taken `again`."""
    done = steps_on_disk(entries)
    return [step for step in steps if step.index not in done or step.index in again]
