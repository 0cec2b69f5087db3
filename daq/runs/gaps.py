"""Frames that a step was to have and never got, as a run records them: ranges of numbers, first and last.

Only a step that may have gaps (a stream) is ever finished with some; they stand in its line of the journal, in
done.json, and in one sentence at the end.
"""

from collections.abc import Container, Iterable, Sequence

from daq.plans.steps import Step
from daq.runs.journal import Entry
from daq.runs.run_folder import steps_on_disk

Gaps = list[list[int]]
NAMED = 5  # gaps that a sentence names


def gaps_of(numbers: Iterable[int], present: Container[int]) -> Gaps:
    """Return the numbers that are not present as [first, last] of each gap, in order."""
    found: Gaps = []
    for number in numbers:
        if number in present:
            continue
        if found and found[-1][1] == number - 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return found


def gaps_by_step(entries: Sequence[Entry]) -> dict[int, Gaps]:
    """Return the gaps of every finished step that has any."""
    finished = steps_on_disk(entries)
    lines = [entry for entry in entries if entry["kind"] == "step" and entry["step"] in finished]
    return {entry["step"]: entry["gaps"] for entry in lines if entry.get("gaps")}


def numbers_in(gaps: Iterable[Sequence[int]]) -> set[int]:
    """Return every number of some gaps."""
    return {number for first, last in gaps for number in range(first, last + 1)}


def next_place(step: Step, present: Container[int]) -> int:
    """Return the first place of a step that is still to be filled.

    What lies before it stays as it is.  Places that belong together are filled from the first of them on, so it is
    a multiple of the step's group.
    """
    taken = [place for place, number in enumerate(step.numbers) if number in present]
    behind = taken[-1] + 1 if taken else 0
    return min(step.frames, -(-behind // step.group) * step.group)


def gap_sentence(gaps: Sequence[Sequence[int]], frames: int) -> str:
    """Say how many frames are missing and which; "" if none is."""
    if not gaps:
        return ""
    missing = sum(last - first + 1 for first, last in gaps)
    named = ", ".join(str(first) if first == last else f"{first} to {last}" for first, last in gaps[:NAMED])
    more = f" and {len(gaps) - NAMED} gaps more" if len(gaps) > NAMED else ""
    return f"{missing} of {frames} frames never came: {named}{more}"
