"""`rtpiv check`: whether runs on the disk are what was acquired."""

from pathlib import Path

from daq.acquisition.runs.run_check import RunCheck, check_run
from daq.errors import RunDamaged
from daq.terminal import console, progress


def check(runs: list[Path]) -> list[RunCheck]:
    """Check runs against themselves: records, every frame, books, hash, corrected frames; nothing is changed.

    Parameters
    ----------
    runs : list of Path
        Folders of runs.

    Returns
    -------
    list of RunCheck
        One a run; `check_run` makes one without printing anything.

    Raises
    ------
    RunDamaged
        A run is not what was acquired; all of them have been looked at and shown.
    """
    screen = console()
    checks = []
    for path in runs:
        found = check_run(path, progress)
        screen.print(path, soft_wrap=True)  # as all lines here: whoever copies a path wants it in one piece
        for finding in found.findings:
            sound = "ok " if finding.sound else "BAD"
            screen.print(f"  {finding.part:<13} {sound}  {finding.said}", soft_wrap=True)
        checks.append(found)
    bad = [found for found in checks if not found.is_sound]
    if bad:
        parts = [finding.part for found in bad for finding in found.findings if not finding.sound]
        named = ", ".join(str(found.path) for found in bad)
        raise RunDamaged(f"{named}: not what was acquired in {', '.join(dict.fromkeys(parts))}; see above")
    return checks
