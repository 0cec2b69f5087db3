"""Displacements of a shift experiment: commanded, measured and (simulated bench only) true.

The displacement is that of the target between a step and its reference step, in world coordinates:

    commanded   from the planned positions
    measured    from what the controllers reported at rest
    true        from where the carriages of the simulated bench really stood

Evaluations must use `measured`; `true` is there to score them.  Where hands move the target, `sigma` is the
standard deviation of `measured` in each direction, from how well each scale is read: twice for an axis that was
turned, not at all for one that was not touched, and unknown (None) where a motor moves.

displacements.json is a list with one entry a line, each with its seal (runs.seal).
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    NotRequired,  # that of typing cannot be checked before Python 3.12
)

from pydantic import Field, TypeAdapter

from daq.atomic_write import write_text
from daq.bench.elements import DIRECTIONS, TARGET, Vector
from daq.errors import RunDamaged, RunUnsuitable
from daq.runs.journal import Entry
from daq.runs.records import CURE, MAX_RECORD_BYTES, Count, Record, Tag, Way, parse_record, read_record
from daq.runs.run_file import SEALED_FROM
from daq.runs.run_folder import RunFolder
from daq.runs.seal import add_seal
from ground.plain_file import read_plain

if TYPE_CHECKING:  # who reads pairs does not wait for plans
    from daq.bench.bench_table import Bench
    from daq.plans.steps import Step

FILE = "displacements.json"


SigmaMm = Annotated[float, Field(ge=0.0, le=100.0)]
Sigmas = tuple[float | None, float | None, float | None]


class Moved(Record):
    """Displacement of one step from its reference [mm]: an entry of displacements.json."""

    tag: Tag
    frames: tuple[Count, Count]  # first frame of the reference, first frame of the step
    commanded_mm: Way
    measured_mm: Way
    true_mm: Way | None
    sigma_mm: NotRequired[tuple[SigmaMm | None, SigmaMm | None, SigmaMm | None]]  # of measured_mm, by hand


_ENTRY: TypeAdapter[Moved] = TypeAdapter(Moved)
_LIST: TypeAdapter[list[Moved]] = TypeAdapter(list[Moved])


def displacements(bench: "Bench", steps: Sequence["Step"], entries: Sequence[Entry]) -> list[Moved]:
    """Return the displacement of every finished step that has a reference.

    Parameters
    ----------
    bench : Bench
        Says which axes carry the target.
    steps : sequence of Step
        The plan.
    entries : sequence of dict
        The journal.
    """
    done = {int(entry["step"]): entry for entry in entries if entry["kind"] == "step"}
    found = []
    for step in steps:
        if step.reference is None or step.index not in done or step.reference not in done:
            continue
        before, after = done[step.reference], done[step.index]
        has_truth = "true_mm" in before and "true_mm" in after
        moved: Moved = {
            "tag": step.tag,
            "frames": (steps[step.reference].first_frame, step.first_frame),
            "commanded_mm": _between(bench, before["planned_mm"], after["planned_mm"]),
            "measured_mm": _between(bench, before["measured_mm"], after["measured_mm"]),
            "true_mm": _between(bench, before["true_mm"], after["true_mm"]) if has_truth else None,
        }
        if (sigma_mm := _sigma(bench, before, after)) is not None:
            moved["sigma_mm"] = sigma_mm
        found.append(moved)
    return found


def _between(bench: "Bench", before_mm: Mapping[str, float], after_mm: Mapping[str, float]) -> Vector:
    before, after = bench.table.offset_mm(TARGET, before_mm), bench.table.offset_mm(TARGET, after_mm)
    x, y, z = (b - a for a, b in zip(before, after, strict=True))
    return (x, y, z)


def _sigma(bench: "Bench", before: Entry, after: Entry) -> Sigmas | None:
    """Uncertainty of the displacement along x, y, z by readings; None where no hand moves the target."""
    by_hand = bench.table.stages.by_hand
    carried = bench.table.axes_of(TARGET)
    if not by_hand.keys() & carried.keys():
        return None
    places = [(entry["planned_mm"], entry["measured_mm"]) for entry in (before, after)]
    found: list[float | None] = []
    for direction in DIRECTIONS:
        along = [name for name, axis in carried.items() if axis.along == direction]
        touched = [name for name in along if any(a[name] != b[name] for a, b in zip(*places, strict=True))]
        read_mm = [by_hand[name] * 1e-3 for name in touched if name in by_hand]
        known = bool(read_mm) or (bool(along) and by_hand.keys() >= set(along))
        found.append(math.sqrt(2.0 * sum(mm**2 for mm in read_mm)) if known else None)
    x, y, z = found
    return (x, y, z)


def write_displacements(folder: RunFolder, found: Sequence[Moved]) -> None:
    """Write what `displacements` found to displacements.json; DiskError if it cannot be written."""
    records = [add_seal(json.dumps(entry, allow_nan=False).encode()).decode() for entry in found]
    write_text(folder.path / FILE, "\n".join(["[", *[f"{r}," for r in records[:-1]], *records[-1:], "]", ""]))


def read_displacements(folder: RunFolder) -> list[Moved]:
    """Read displacements.json.

    Raises
    ------
    RunUnsuitable
        There is none: no shift run, or one that is not finished.
    RunDamaged
        An entry is not what was written, or is not what the plan leads to.
    """
    path = folder.path / FILE
    if not path.is_file():
        raise RunUnsuitable(f"{folder.path}: holds no displacements; evaluate a finished shift run")
    about = folder.about
    found = _read_sealed(path) if about["layout"] >= SEALED_FROM else read_record(_LIST, path, sealed=False)
    steps = about["steps"]
    wanted = [
        (step["tag"], (steps[step["reference"]]["first_frame"], step["first_frame"]))
        for step in steps
        if step["reference"] is not None
    ]
    if [(entry["tag"], entry["frames"]) for entry in found] != wanted:
        raise RunDamaged(f"{path}: its {len(found)} entries are not the {len(wanted)} of the plan; {CURE}")
    return found


def _read_sealed(path: Path) -> list[Moved]:
    try:
        lines = read_plain(path, MAX_RECORD_BYTES).split(b"\n")
    except OSError as error:
        raise RunDamaged(f"{path}: cannot be read ({error.strerror}); {CURE}") from None
    if lines[0] != b"[" or lines[-2:] != [b"]", b""]:
        raise RunDamaged(f"{path}: is not a list with an entry a line; {CURE}")
    return [
        parse_record(_ENTRY, line.removesuffix(b","), path, number, sealed=True)
        for number, line in enumerate(lines[1:-2], start=2)
    ]
