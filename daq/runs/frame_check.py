"""Integrity check: frames of a run against its journal, and files that the journal does not have.

A kill, or a power cut, may come between the moment in which a frame gets its name and that in which its line is on
the disk.  The line of a step is brought to the disk before the next step begins, so what is left behind belongs to
one step that is not finished, and is no more than a moment's frames; `resume` removes it and takes that step
again.  More frames without lines, or those of several steps, mean something else: the journal has lost its end.
Those are never removed.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from daq.errors import RunDamaged
from daq.runs.journal import Entry
from daq.runs.journal_lines import frame_name
from daq.runs.raw_frame import read_raw
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, frame_entries, steps_on_disk

T = TypeVar("T")
NAMED = 5  # frames that a sentence names


class Track(Protocol):
    """Passes items on and shows how many of `total` are done; see ground.terminal.progress."""

    def __call__(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Yield `items`."""


def no_tracking(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield `items` and show nothing."""
    yield from items


@dataclass(frozen=True, slots=True)
class FrameFault:
    """A frame that is not what was written.

    Parameters
    ----------
    number, step : int
        The frame, and the step that it belongs to.
    file : str
        Its name within the run.
    what : str
        What is wrong with it, as the rest of a sentence.
    """

    number: int
    step: int
    file: str
    what: str


def frame_faults(
    folder: RunFolder, acknowledged: Mapping[int, Entry], track: Track = no_tracking
) -> list[FrameFault]:
    """Read frames and compare them with their lines in the journal: pixels, and what the file says about them.

    Parameters
    ----------
    folder : RunFolder
        The run.
    acknowledged : mapping of int to dict
        Lines of the frames in question, by number; see `frame_entries`.
    track : Track, optional
        Shows how far it is.
    """
    found = []
    for number, entry in track(sorted(acknowledged.items()), len(acknowledged), f"checking {folder.path.name}"):
        if what := _fault(folder, entry):
            found.append(FrameFault(number, entry["step"], entry["file"], what))
    return found


def name_faults(faults: list[FrameFault]) -> str:
    """Name the first few of some faults, and say how many more there are."""
    more = f" and {len(faults) - NAMED} more" if len(faults) > NAMED else ""
    return ", ".join(f"{fault.file} {fault.what}" for fault in faults[:NAMED]) + more


def _fault(folder: RunFolder, entry: Entry) -> str:
    path = folder.inside(entry["file"])
    if not path.is_file():
        return "is missing"
    try:
        _, about = read_raw(path, entry["crc32"])
    except RunDamaged as error:
        return str(error).removeprefix(f"{path}: ").partition(";")[0]
    differing = [key for key, value in about.items() if key not in entry or entry[key] != value]
    return f"says something else about its {differing[0]} than the journal" if differing else ""


MOST_CUT_OFF = 64  # what two writers hold, and at 200 frames/s those whose lines a power cut takes (SYNC_S)
_FRAME = re.compile(r"\d{6,}\.tif(\.part)?")  # what else people keep there is theirs


@dataclass(frozen=True, slots=True)
class OrphanFiles:
    """Names of files among the frames: left behind where a step was `cut_off`, or without any explanation."""

    cut_off: tuple[str, ...]
    strange: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """Description of unexplained files, and the cure; "" if there are none."""
        if not self.strange:
            return ""
        more = f" and {len(self.strange) - NAMED} more" if len(self.strange) > NAMED else ""
        named = ", ".join(self.strange[:NAMED])
        return (
            f"frames/ holds {named}{more}, which the journal does not have and no kill explains; "
            "restore the journal from a copy, or move them away"
        )


def orphan_files(folder: RunFolder, steps: Sequence[PlannedStep], entries: Sequence[Entry]) -> OrphanFiles:
    """Look for files that the journal does not have.

    Parameters
    ----------
    folder : RunFolder
        The run.
    steps : sequence of dict
        Those of run.json.
    entries : sequence of dict
        The journal.
    """
    known = {Path(entry["file"]).name for entry in frame_entries(entries).values()}
    there = (path.name for path in (folder.path / "frames").glob("*") if _FRAME.fullmatch(path.name))
    names = sorted(name for name in there if name not in known)
    finished = steps_on_disk(entries)
    step_of = {
        Path(frame_name(number)).name: step["index"]
        for step in steps
        if step["index"] not in finished
        for number in range(step["first_frame"], step["first_frame"] + step["frames"])
    }
    strange = [name for name in names if name.removesuffix(".part") not in step_of]
    cut_off = [name for name in names if name.removesuffix(".part") in step_of]
    if len({step_of[name.removesuffix(".part")] for name in cut_off}) > 1 or len(cut_off) > MOST_CUT_OFF:
        return OrphanFiles((), tuple(names))
    return OrphanFiles(tuple(cut_off), tuple(strange))
