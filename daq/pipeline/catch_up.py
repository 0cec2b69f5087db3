"""Correct from the disk what was not corrected while the frames arrived."""

from collections.abc import Iterable

from daq.pipeline.corrections import Corrections
from daq.plans.steps import Step
from daq.runs.acquired import read_acquired
from daq.runs.run_folder import RunFolder


def uncorrected(folder: RunFolder, corrections: Corrections, steps: Iterable[Step]) -> list[tuple[Step, int]]:
    """Return the frames (step, number) that are to be corrected and have no corrected file yet."""
    return [
        (step, number)
        for step in steps
        if corrections.of(step) is not None
        for number in step.numbers
        if folder.frame_path(number).exists() and not folder.corrected_path(number).exists()
    ]


def correct_from_disk(folder: RunFolder, corrections: Corrections, step: Step, number: int) -> None:
    """Correct one raw frame of a run.

    Raises
    ------
    FrameDamaged, RunDamaged
        The raw frame is not what the journal has acknowledged.
    DiskError
        The disk takes no corrected one.
    """
    corrector = corrections.of(step)
    assert corrector is not None
    source = folder.frame_path(number)
    pixels = read_acquired(source)
    corrections.write(folder.corrected_path(number), corrector(pixels), step, source.name)
