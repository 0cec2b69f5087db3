"""Files among the frames of a run that its journal does not have.

A kill, or a power cut, may come between the moment in which a frame gets its name and that in which its line is on
the disk.  The line of a step is brought to the disk before the next step begins, so what is left behind belongs to
one step that is not finished, and is no more than a moment's frames; `resume` removes it and takes that step
again.  More frames without lines, or those of several steps, mean something else: the journal has lost its end.
Those are never removed.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.runs.journal import Entry
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, finished_steps, frame_entries, frame_name

MOST_CUT_OFF = 64  # what two writers hold, and at 200 frames/s those whose lines a power cut takes (SYNC_S)
NAMED = 5  # files that a sentence names
_FRAME = re.compile(r"\d{6,}\.tif(\.part)?")  # what else people keep there is theirs


@dataclass(frozen=True, slots=True)
class Unclaimed:
    """Names of files among the frames: left behind where a step was `cut_off`, or without any explanation."""

    cut_off: tuple[str, ...]
    strange: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What is strange, and what to do about it; "" if nothing is."""
        if not self.strange:
            return ""
        more = f" and {len(self.strange) - NAMED} more" if len(self.strange) > NAMED else ""
        named = ", ".join(self.strange[:NAMED])
        return (
            f"frames/ holds {named}{more}, which the journal does not have and no kill explains; "
            "restore the journal from a copy, or move them away"
        )


def unclaimed(folder: RunFolder, steps: Sequence[PlannedStep], entries: Sequence[Entry]) -> Unclaimed:
    """Look for files that nobody vouches for.

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
    finished = finished_steps(entries)
    step_of = {
        Path(frame_name(number)).name: step["index"]
        for step in steps
        if step["index"] not in finished
        for number in range(step["first_frame"], step["first_frame"] + step["frames"])
    }
    strange = [name for name in names if name.removesuffix(".part") not in step_of]
    cut_off = [name for name in names if name.removesuffix(".part") in step_of]
    if len({step_of[name.removesuffix(".part")] for name in cut_off}) > 1 or len(cut_off) > MOST_CUT_OFF:
        return Unclaimed((), tuple(names))
    return Unclaimed(tuple(cut_off), tuple(strange))
