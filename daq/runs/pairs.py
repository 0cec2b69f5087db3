"""Which frames of a run form pairs, as the run itself says: moved by a measured way, or a time apart.

A shift run has steps that are displaced from a reference step: its pairs are the first frames of both, with the
displacement that the stages measured.  A stream has groups, frames that belong together: its pairs are neighbours
within a group, with the time between their exposures on the camera's clock.  A flow run has pairs of light pulses:
every frame's line says which exposure of a pair it is and how far the pulses were apart (runs.flow_pairs).

One lost frame would swap first and second exposure for the rest of a stream if frames were paired in the order of
arrival.  A run numbers the frames of a stream by their ids and goes on with whole groups, so the number says the
place within the group; a frame whose partner is missing is in no pair, and is counted.  Ids cannot tell that the
camera was armed between the two exposures of a pair; time stamps can.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from daq.errors import RunUnsuitable
from daq.runs.displacement import read_displacements
from daq.runs.exposure_times import exposure_times_s
from daq.runs.flow_pairs import flow_pairs
from daq.runs.frame_pair import FramePair as FramePair  # who asks for pairs gets these
from daq.runs.journal import Entry
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, frame_entries
from piv.errors import PairError

SWAPPED = 2.0  # times the gap to the next pair, and a pair is none; frames in regular order have 1


@dataclass(frozen=True)
class RunPairs:
    """Pairs of a run in the order of the plan, the numbers of frames that lost their partner, and all their lines.

    A journal of a million frames is read once: whoever has the pairs has the lines of their frames, by number.
    """

    pairs: tuple[FramePair, ...]
    alone: tuple[int, ...]
    lines: Mapping[int, Entry] = field(default_factory=dict)


def pairs_of(path: Path) -> RunPairs:
    """Return the pairs of a run.

    Raises
    ------
    RunUnsuitable
        The folder is no run, or a run that is not far enough.
    RunDamaged
        What it says is not what was written.
    PairError
        No frames of this run belong together, or their time stamps contradict it.
    """
    folder = RunFolder.open(path)
    steps, lines = folder.about["steps"], folder.entries()
    entries = frame_entries(lines)
    moved = any(step["reference"] is not None for step in steps)
    if not moved and all(step.get("group", 1) == 1 for step in steps):
        raise PairError(f"{path}: no frames of this run form pairs; give a shift run, or a stream with a group")
    pairs = list(_moved(folder, steps, entries)) if moved else []
    alone: list[int] = []
    if any("dt_us" in step for step in steps):
        pairs, alone = flow_pairs(folder, lines)
    else:
        timed: dict[int, FramePair] = {}
        for step in steps:
            timed |= _timed(folder, step, entries, alone)
        times = exposure_times_s(lines, timed)
        pairs += [replace(pair, time_s=times[one]) for one, pair in timed.items()]
    if not pairs:
        raise RunUnsuitable(f"{path}: no pair is complete; resume the run first")
    return RunPairs(tuple(pairs), tuple(alone), entries)


def _moved(folder: RunFolder, steps: list[PlannedStep], entries: Mapping[int, Entry]) -> Iterator[FramePair]:
    views = {step["tag"]: step["view"] for step in steps}
    for entry in read_displacements(folder):
        first, second = (entries.get(number) for number in entry["frames"])
        if first is None or second is None:
            continue
        yield FramePair(
            entry["tag"],
            views[entry["tag"]] == "glass",
            (folder.inside(first["file"]), folder.inside(second["file"])),
            entry["commanded_mm"],
            entry["measured_mm"],
        )


def _timed(
    folder: RunFolder, step: PlannedStep, entries: Mapping[int, Entry], alone: list[int]
) -> dict[int, FramePair]:
    """Pairs of one step by their first frame; adds to `alone` the frames that are in none."""
    first, group = step["first_frame"], step.get("group", 1)
    present = [number for number in range(first, first + step["frames"]) if number in entries]
    to_next_ns = {
        one: entries[two]["timestamp_ns"] - entries[one]["timestamp_ns"]
        for one, two in pairwise(present)
        if two == one + 1 and entries[two]["sequence"] == entries[one]["sequence"] + 1
    }
    last_of = {number: number + group - 1 - (number - first) % group for number in to_next_ns}
    starts = [number for number, last in last_of.items() if number != last]
    for one in starts:
        if to_next_ns[one] < 0:
            raise PairError(
                f"{folder.path}: frame {one + 1} was exposed before frame {one}, by the camera's clock"
            )
    swapped = [n for n in starts if to_next_ns[n] > SWAPPED * to_next_ns.get(last_of[n], math.inf)]
    if 2 * len(swapped) > len(starts):
        raise PairError(
            f"{folder.path}: the frames of most pairs lie farther apart than the next pair, such as "
            f"{swapped[0]} and {swapped[0] + 1}: the first frame of the stream was not the first of a pair"
        )
    found = {}
    for one in starts:
        dt_s = to_next_ns[one] * 1e-9 or None  # 0: the camera has no clock
        files = (folder.inside(entries[one]["file"]), folder.inside(entries[one + 1]["file"]))
        found[one] = FramePair(f"{step['tag']}_{one:06d}", step["view"] == "glass", files, dt_s=dt_s)
    if group > 1:
        alone += sorted(set(present).difference(*[(one, one + 1) for one in starts]))
    return found
