"""Which plane frames show: the light sheet, or a print on the target's stage."""

from collections.abc import Iterable
from pathlib import Path

from correction.errors import FrameError
from daq.acquisition.runs.acquired import run_of
from daq.acquisition.runs.run_file import PlannedStep


def shows_light_sheet(frames: Iterable[Path]) -> bool:
    """Whether frames show particles in the light sheet; a frame of no run does.

    Raises
    ------
    FrameError
        Some do, and others show a print.
    RunUnsuitable, RunDamaged
        A run cannot be read.
    """
    runs = {None if run is None else run.path: run for run in map(run_of, frames)}
    found = {run is None or any(map(in_light_sheet, run.about["steps"])) for run in runs.values()}
    if len(found) > 1:
        raise FrameError(
            "some frames show a print on the target's stage, others the light sheet; correct them apart"
        )
    return found != {False}


def in_light_sheet(step: PlannedStep) -> bool:
    """Whether the frames of a step of a run do: those of a flow or a stream."""
    return "dt_us" in step or step.get("group", 1) > 1
