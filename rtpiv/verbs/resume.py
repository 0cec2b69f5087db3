"""`rtpiv acquire --resume`: resume an interrupted run."""

from pathlib import Path

from daq.bench.opened import require_camera_libraries
from daq.runner.session import reopen
from daq.runs.run_folder import remaining
from ground.plain_words import quantity
from ground.terminal import console, progress_if_long
from rtpiv.verbs.acquire import run_and_report
from rtpiv.verbs.operator import operator_of, require_person
from rtpiv.verbs.paths import Named


def resume(
    run: Named, /, home: bool = False, retake: bool = False, operator: str | None = None, live: bool = False
) -> Path:
    """Execute the remaining steps of a run: plan minus journal.

    Parameters
    ----------
    run : path
        Folder of the run.
    home : bool
        Home every axis first, in the configured order; required if a controller has lost its position.
    retake : bool
        Repeat steps with a missing or damaged frame, also of a finished run.
    operator : str, optional
        As for `acquire`.
    live : bool
        As for `acquire`.

    Returns
    -------
    Path
        Folder of the run.

    Raises
    ------
    ResumeRefused
        The run is finished or uncertain, or plan, bench or scene have changed since its start.
    RunDamaged
        A record is not what was written; or, without `retake`, a frame.
    WrongDevice
        Other controllers answer than those that the run began with.
    """
    screen = console()
    run = Path(run)
    found = reopen(run, retake, progress_if_long)
    screen.print(f"{run}: plan, bench and scene are those it began with, and every frame that counts is right")
    require_camera_libraries(found.bench, found.request.simulate)
    if found.again:
        screen.print(f"taken again for missing or damaged frames: {quantity(len(found.again), 'step')}")
    person = operator_of(operator, found.request.simulate)
    by_hand = [] if found.request.simulate else list(found.bench.table.stages.by_hand)
    require_person(person, remaining(found.plan.steps, found.folder.entries(), found.again), by_hand)
    run_and_report(screen, found, home, person, live, is_new=False)
    return run
