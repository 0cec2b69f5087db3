"""Pairs of a flow run: two frames, each lit by one of two light pulses, as the line of each frame says.

Nothing is concluded from the order of frames.  While the run was recorded a marker told which exposure each
frame is (runner.pair_finder), and the frame's line says it: exposure A or B, the time between the pulses as
commanded and, if somebody measured it, as measured with its standard deviation.  Here the lines of a pair are held
against each other; two that contradict one another are named with file and line: nothing tells which one is right.
"""

from collections.abc import Mapping, Sequence
from math import isclose
from typing import NoReturn

from daq.errors import RunDamaged
from daq.runs.exposure_times import exposure_times_s
from daq.runs.frame_pair import FramePair
from daq.runs.journal_lines import Entry
from daq.runs.records import CURE
from daq.runs.run_file import PlannedStep
from daq.runs.run_folder import RunFolder, frame_entries
from piv.errors import PairError

SAME = 1e-9  # relative; two lines write the same number
READ_BACK = 1e-6  # relative; of an exposure that nobody has changed


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
        self._agree: set[tuple[int, int, int]] = set()  # records that many lines share, and the step; by identity
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
            self._damaged(two, f"was exposed before frame {one} of its pair, by the camera's clock")
        for number, exposure in ((one, "A"), (two, "B")):
            self._exposure(number, exposure, step.get("background", False))

    def _records(self, step: PlannedStep, one: int, two: int) -> None:
        """Judge what both lines say of their pair."""
        for number, exposure in ((one, "A"), (two, "B")):
            record = self._frames[number].get("pair")
            if record is None:
                self._damaged(number, "does not say which exposure of a pair its frame is")
            if record["exposure"] != exposure:
                self._damaged(
                    number, f"says exposure {record['exposure']} where the run keeps exposure {exposure}"
                )
            if record.get("background", False) != step.get("background", False):
                self._damaged(number, "says something else about the background than the plan")
            if not isclose(record["dt_us"], step["dt_us"], rel_tol=SAME):
                self._damaged(number, f"says dt_us {record['dt_us']:g} and the plan says {step['dt_us']:g}")
        before, after = (self._frames[number]["pair"] for number in (one, two))
        for key in sorted({*before, *after} - {"exposure"}):
            if before.get(key) != after.get(key):
                self._damaged(two, f"says {key} {after.get(key)} and frame {one} of its pair {before.get(key)}")
        if "dt_sigma_us" in before and "dt_measured_us" not in before:
            self._damaged(one, "has a dt_sigma_us and no dt_measured_us that it belongs to")

    def _exposure(self, number: int, exposure: str, is_background: bool) -> None:
        """Background and pairs must be exposed for the same time: what is subtracted is light."""
        exposed_us = self._frames[number]["exposure_us"]
        if exposed_us is None:
            return
        known_us, known = self._exposed.setdefault((exposure, is_background), (exposed_us, number))
        if not isclose(known_us, exposed_us, rel_tol=READ_BACK):
            self._damaged(number, f"says {exposed_us:g} us of exposure and frame {known} {known_us:g} us")
        other_us, other = self._exposed.get((exposure, not is_background), (exposed_us, number))
        if not isclose(other_us, exposed_us, rel_tol=READ_BACK):
            raise PairError(
                f"{self._place(number)}: exposure {exposure} took {exposed_us:g} us and that of frame {other} "
                f"{other_us:g} us, so the background does not belong to the pairs; begin a new run"
            )

    def _place(self, number: int) -> str:
        return f"{self._folder.journal_path}:{self._lines[number]}"

    def _damaged(self, number: int, what: str) -> NoReturn:
        raise RunDamaged(f"{self._place(number)}: {what}; {CURE}")
