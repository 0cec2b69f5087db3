"""Steps of a run that have to be taken again because a frame of theirs is gone or damaged.

A displacement lives between two steps, and the reference was taken right before so that drift does not count; so a
step is taken again together with its reference, and with what is displaced from it.

A step that keeps what it has counts from its first frame on, finished or not.
"""

from collections.abc import Sequence

from daq.errors import RunDamaged
from daq.plans.steps import Step
from daq.runs.frame_check import Track, frame_faults, named, untracked
from daq.runs.journal import Entry
from daq.runs.run_folder import RunFolder, finished_steps, frame_entries


def steps_to_retake(
    folder: RunFolder, steps: Sequence[Step], entries: Sequence[Entry], retake: bool, track: Track = untracked
) -> frozenset[int]:
    """Check every frame that is about to count as done; return the steps that must be taken again.

    Parameters
    ----------
    folder : RunFolder
        The run.
    steps : sequence of Step
        Its plan.
    entries : sequence of dict
        Its journal.
    retake : bool
        Whether anything may be taken again.
    track : Track, optional
        Shows how many frames have been read.

    Raises
    ------
    RunDamaged
        A frame is missing or damaged, and nothing may be taken again.
    """
    kept = finished_steps(entries) | {step.index for step in steps if step.may_have_gaps}
    counting = {number: entry for number, entry in frame_entries(entries).items() if entry["step"] in kept}
    faults = frame_faults(folder, counting, track)
    if faults and not retake:
        raise RunDamaged(
            f"{folder.path}: {len(faults)} of {len(counting)} frames are not what was written ({named(faults)}); "
            f"restore them from a copy, or take their steps again with rtpiv resume {folder.path} --retake"
        )
    return _with_partners({fault.step for fault in faults}, steps) & kept


def _with_partners(indices: set[int], steps: Sequence[Step]) -> frozenset[int]:
    roots = {index if (reference := steps[index].reference) is None else reference for index in indices}
    return frozenset(roots | {step.index for step in steps if step.reference in roots})
