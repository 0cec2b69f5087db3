"""`rtpiv resume`: go on with a run that was interrupted, by whatever."""

from pathlib import Path

from daq.runner.session import reopen
from daq.terminal import console
from daq.verbs.acquire import run_and_report


def resume(run: Path, home: bool = False) -> Path:
    """Do what is left of a run: plan minus journal.

    Parameters
    ----------
    run : Path
        Folder of the run.
    home : bool
        Home every axis first, in the configured order; needed if a controller has lost its position.

    Returns
    -------
    Path
        Folder of the run.

    Raises
    ------
    ResumeRefused
        The run is finished, or plan, bench or scene are not those it began with.
    """
    screen = console()
    request, bench, plan, folder = reopen(run)
    screen.print(f"{run}: plan, bench and scene are those it began with")
    run_and_report(screen, request, bench, plan, folder, home)
    return run
