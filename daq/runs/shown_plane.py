"""Which plane frames show: the light sheet, or a print on the target's stage."""

from collections.abc import Iterable
from pathlib import Path

from daq.runs.acquired import run_of
from daq.runs.run_file import PlannedStep
from piv.errors import FrameError
from tracer.scene.scene import Scene


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


def where_lit(scene: Scene) -> str:
    """Say in which plane particles were taken to lie, how unsure that is, and what makes it surer."""
    if scene.sheet is not None:
        return f"Particles were taken to lie in {scene.sheet.summary}; its sigma is in that of the vectors."
    return (
        "The scene file does not say where the light sheet is, so particles were taken to lie in"
        f" {scene.lit.summary}; all of that is in the sigma of map and vectors. Find it with rtpiv sheet, or"
        " measure it and write `sheet` into the scene file."
    )
