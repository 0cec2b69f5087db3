"""Pairs of a run, as its records define them: displaced by a measured distance, or a time apart.

A shift run has steps that are displaced from a reference step: its pairs are the first frames of both, with the
displacement that the stages measured.  A stream has groups, frames that belong together: its pairs are neighbours
within a group, with the time between their exposures on the camera's clock.  A flow run has pairs of light pulses:
every frame's line says which exposure of a pair it is and how far the pulses were apart.

One lost frame would swap first and second exposure for the rest of a stream if frames were paired in the order of
arrival.  A run numbers the frames of a stream by their ids and goes on with whole groups, so the number says the
place within the group; a frame whose partner is missing is in no pair, and is counted.  Ids cannot tell that the
camera was armed between the two exposures of a pair; time stamps can.

**Pairs of light pulses.**  Nothing is concluded from the order of frames.  While the run was recorded a marker
identified the exposure of each frame (runner.pair_finder), and the frame's line says it: exposure A or B, the time
between the pulses as commanded and, if it was measured, as measured with its standard deviation.  Here the
lines of a pair are held against each other; two that contradict one another are named with file and line: nothing
tells which one is right.

**Times of exposure**, in seconds since the first frame.  The camera's own clock stamps every exposure to a
microsecond or better, and drifts against the computer's by some millionths.  It begins anew when the camera
restarts, and two sessions of a run may have a reboot of the computer between them.  So differences are the
camera's as long as its clock went on, and the computer's across a break: by the arrival of the frames within one
session, and by the time of day between sessions.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from math import isclose
from pathlib import Path
from typing import NoReturn

from daq.bench.elements import Vector
from daq.errors import RunDamaged, RunUnsuitable
from daq.runs.displacement import read_displacements
from daq.runs.journal import Entry
from daq.runs.journal_lines import ReadingRecord
from daq.runs.lab_readings import Shown, reading_statistics
from daq.runs.records import CURE
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, frame_entries
from piv.errors import PairError

# by which arrivals may differ from a clock that went on: frames queue up
JITTER_NS, DRIFT = 10_000_000_000, 1e-3


def exposure_times_s(entries: Sequence[Entry], numbers: Iterable[int]) -> dict[int, float | None]:
    """Return the time of each frame since the first one.

    Parameters
    ----------
    entries : sequence of dict
        Lines of the journal.
    numbers : iterable of int
        Frames, all of which are in the journal.

    Returns
    -------
    dict of int to float or None
        By number [s]; None for all if the camera has no clock.
    """
    frames, sessions, session_of = frame_entries(entries), [], {}
    for entry in entries:
        if entry["kind"] == "session":
            sessions.append(entry)
        elif entry["kind"] == "frame":
            session_of[entry["frame"]] = len(sessions) - 1
    wanted = sorted(numbers)
    if any(frames[number]["timestamp_ns"] == 0 for number in wanted):
        return dict.fromkeys(wanted)
    times: dict[int, float | None] = {}
    elapsed_ns, before = 0, None
    for number in wanted:
        if before is not None:
            places = [session_of[before], session_of[number]]
            arrived_ns = [frames[n]["received_ns"] for n in (before, number)]
            if places[0] != places[1]:
                elapsed_ns += _across(sessions, places, arrived_ns)
            else:
                by_camera = frames[number]["timestamp_ns"] - frames[before]["timestamp_ns"]
                by_computer = arrived_ns[1] - arrived_ns[0]
                off_ns = abs(by_camera - by_computer)
                went_on = by_camera > 0 and off_ns <= JITTER_NS + DRIFT * abs(by_computer)
                elapsed_ns += by_camera if went_on else by_computer
        times[number], before = elapsed_ns * 1e-9, number
    return times


def _across(sessions: Sequence[Entry], places: Sequence[int], arrived_ns: Sequence[int]) -> int:
    """Time between the arrivals of two frames of different sessions [ns]."""
    lines = [sessions[place] for place in places]
    if not all("monotonic_ns" in line for line in lines):  # an older run: the computer was not started in between
        return max(0, arrived_ns[1] - arrived_ns[0])
    day_ns = [round(1e9 * datetime.fromisoformat(line["utc"]).timestamp()) for line in lines]
    since_ns = [arrived - line["monotonic_ns"] for arrived, line in zip(arrived_ns, lines, strict=True)]
    return int(day_ns[1] + since_ns[1] - day_ns[0] - since_ns[0])


@dataclass(frozen=True)
class FramePair:
    """Two frames between which something has moved.

    Parameters
    ----------
    tag : str
        Names the pair within its run.
    glass : bool
        Taken through the glass, or bare.
    frames : (Path, Path)
        Before and after, always two files: a buffer with both exposures is cut in two as it arrives.
    commanded_mm, measured_mm : (float, float, float), optional
        Displacement of the target in the world, as planned and as the stages reported it; None if it did not move.
    sigma_mm : (float or None, ...), optional
        Standard deviation of `measured_mm` in each direction where hands moved it, None for a motor; see
        `runs.displacement`.
    dt_s : float, optional
        From the first exposure, or light pulse, to the second: measured if it was, else commanded; None if
        not known.
    dt_sigma_s : float, optional
        Standard deviation of `dt_s`; None if it was not measured.
    time_s : float, optional
        From the first exposure of the first pair of the run to that of this one, on the camera's clock; across a
        restart of the camera or of the run, on the computer's. None if the camera has no clock.
    is_background : bool
        Taken before the seeding was opened: reflections and dark level, no particles.
    """

    tag: str
    glass: bool
    frames: tuple[Path, Path]
    commanded_mm: Vector | None = None
    measured_mm: Vector | None = None
    sigma_mm: tuple[float | None, ...] | None = None
    dt_s: float | None = None
    dt_sigma_s: float | None = None
    time_s: float | None = None
    is_background: bool = False


SAME = 1e-9  # relative; two lines write the same number
READ_BACK = 1e-6  # relative; of an unchanged exposure


def flow_pairs(folder: RunFolder, entries: Sequence[Entry]) -> tuple[list[FramePair], list[int]]:
    """Return the pairs of a flow run in order, and the numbers of frames without their partner.

    Parameters
    ----------
    folder : RunFolder
        The run.
    entries : sequence of dict
        Its journal.

    Raises
    ------
    RunDamaged
        Lines of a pair contradict each other or the plan.
    PairError
        The background was exposed otherwise than the pairs.
    """
    frames = frame_entries(entries)
    lines = {entry["frame"]: line for line, entry in enumerate(entries, start=1) if entry["kind"] == "frame"}
    judge = _Judge(folder, frames, lines)
    found: list[tuple[PlannedStep, int]] = []
    alone: list[int] = []
    for step in folder.about["steps"]:
        if "dt_us" not in step:
            continue
        first = step["first_frame"]
        for one in range(first, first + step["frames"] - 1, 2):
            here = [number for number in (one, one + 1) if number in frames]
            if len(here) < 2:
                alone += here
                continue
            judge.pair(step, one)
            found.append((step, one))
    times = exposure_times_s(entries, [one for _, one in found])
    pairs, place = [], folder.inside("frames").parent  # no line names a file elsewhere
    for step, one in found:
        record = frames[one]["pair"]
        dt_us = record.get("dt_measured_us", record["dt_us"])
        sigma_us = record.get("dt_sigma_us") if "dt_measured_us" in record else None
        pairs.append(
            FramePair(
                f"{step['tag']}_{one:06d}",
                step["view"] == "glass",
                (place / frames[one]["file"], place / frames[one + 1]["file"]),
                dt_s=dt_us * 1e-6,
                dt_sigma_s=None if sigma_us is None else sigma_us * 1e-6,
                time_s=times[one],
                is_background=step.get("background", False),
            )
        )
    return pairs, alone


class _Judge:
    """Holds the lines of pairs against each other, and the exposures of all of them."""

    def __init__(self, folder: RunFolder, frames: Mapping[int, Entry], lines: Mapping[int, int]) -> None:
        self._folder = folder
        self._frames = frames
        self._lines = lines
        # records that many lines share, and the step; by identity
        self._agree: set[tuple[int, int, int]] = set()
        self._exposed: dict[tuple[str, bool], tuple[float, int]] = {}  # A or B, background: [us], first frame

    def pair(self, step: PlannedStep, one: int) -> None:
        """Judge the frames `one` and the next one."""
        two = one + 1
        first, second = self._frames[one], self._frames[two]
        records = id(first.get("pair")), id(second.get("pair")), step["index"]
        if records not in self._agree:
            self._records(step, one, two)
            self._agree.add(records)
        if second["timestamp_ns"] < first["timestamp_ns"]:
            self._raise_damaged(two, f"was exposed before frame {one} of its pair, by the camera's clock")
        for number, exposure in ((one, "A"), (two, "B")):
            self._exposure(number, exposure, step.get("background", False))

    def _records(self, step: PlannedStep, one: int, two: int) -> None:
        """Judge what both lines say of their pair."""
        for number, exposure in ((one, "A"), (two, "B")):
            record = self._frames[number].get("pair")
            if record is None:
                self._raise_damaged(number, "does not say which exposure of a pair its frame is")
            if record["exposure"] != exposure:
                self._raise_damaged(
                    number, f"says exposure {record['exposure']} where the run keeps exposure {exposure}"
                )
            if record.get("background", False) != step.get("background", False):
                self._raise_damaged(number, "says something else about the background than the plan")
            if not isclose(record["dt_us"], step["dt_us"], rel_tol=SAME):
                self._raise_damaged(number, f"says dt_us {record['dt_us']:g} and the plan says {step['dt_us']:g}")
        before, after = (self._frames[number]["pair"] for number in (one, two))
        for key in sorted({*before, *after} - {"exposure"}):
            if before.get(key) != after.get(key):
                self._raise_damaged(
                    two, f"says {key} {after.get(key)} and frame {one} of its pair {before.get(key)}"
                )
        if "dt_sigma_us" in before and "dt_measured_us" not in before:
            self._raise_damaged(one, "has a dt_sigma_us and no dt_measured_us that it belongs to")

    def _exposure(self, number: int, exposure: str, is_background: bool) -> None:
        """Background and pairs must be exposed for the same time: what is subtracted is light."""
        exposed_us = self._frames[number]["exposure_us"]
        if exposed_us is None:
            return
        known_us, known = self._exposed.setdefault((exposure, is_background), (exposed_us, number))
        if not isclose(known_us, exposed_us, rel_tol=READ_BACK):
            self._raise_damaged(number, f"says {exposed_us:g} us of exposure and frame {known} {known_us:g} us")
        other_us, other = self._exposed.get((exposure, not is_background), (exposed_us, number))
        if not isclose(other_us, exposed_us, rel_tol=READ_BACK):
            raise PairError(
                f"{self._place(number)}: exposure {exposure} took {exposed_us:g} us and that of frame {other} "
                f"{other_us:g} us, so the background does not belong to the pairs; begin a new run"
            )

    def _place(self, number: int) -> str:
        return f"{self._folder.journal_path}:{self._lines[number]}"

    def _raise_damaged(self, number: int, what: str) -> NoReturn:
        raise RunDamaged(f"{self._place(number)}: {what}; {CURE}")


SWAPPED = 2.0  # times the gap to the next pair, and a pair is none; frames in regular order have 1


@dataclass(frozen=True)
class RunPairs:
    """Pairs of a run in the order of the plan, the numbers of frames that lost their partner, and all their lines.

    A journal of a million frames is read once: with the pairs come the lines of their frames, by number, and
    what gauges of the lab showed, by step.
    """

    pairs: tuple[FramePair, ...]
    alone: tuple[int, ...]
    lines: Mapping[int, Entry] = field(default_factory=dict)
    readings: Mapping[int, Mapping[str, ReadingRecord]] = field(default_factory=dict)

    def statistics_during(self, pairs: Iterable[FramePair]) -> dict[str, Shown]:
        """Statistics of the gauges over the steps of these pairs; empty where there are none."""
        if not self.readings:
            return {}
        used = {step: records for pair in pairs for step, records in self.readings_during(pair).items()}
        return reading_statistics(used[step] for step in sorted(used))

    def readings_during(self, pair: FramePair) -> dict[int, Mapping[str, ReadingRecord]]:
        """Readings of the gauges at each step of a pair."""
        if not self.readings:
            return {}
        used = {self._step_of[path.name] for path in pair.frames}
        return {step: self.readings[step] for step in sorted(used) if step in self.readings}

    @cached_property
    def _step_of(self) -> dict[str, int]:
        """Step by the name of a frame's file."""
        return {Path(entry["file"]).name: entry["step"] for entry in self.lines.values()}


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
    pairs = list(_pairs_by_shift(folder, steps, entries)) if moved else []
    alone: list[int] = []
    if any("dt_us" in step for step in steps):
        pairs, alone = flow_pairs(folder, lines)
    else:
        timed: dict[int, FramePair] = {}
        for step in steps:
            timed |= _neighbour_pairs(folder, step, entries, alone)
        times = exposure_times_s(lines, timed)
        pairs += [replace(pair, time_s=times[one]) for one, pair in timed.items()]
    if not pairs:
        raise RunUnsuitable(f"{path}: no pair is complete; resume the run first")
    readings = {line["step"]: line["readings"] for line in lines if line["kind"] == "step" and "readings" in line}
    return RunPairs(tuple(pairs), tuple(alone), entries, readings)


def _pairs_by_shift(
    folder: RunFolder, steps: list[PlannedStep], entries: Mapping[int, Entry]
) -> Iterator[FramePair]:
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
            tuple(entry["sigma_mm"]) if "sigma_mm" in entry else None,
        )


def _neighbour_pairs(
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
