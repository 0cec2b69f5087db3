"""Files and folders given by the user."""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from daq.errors import RunUsageError
from tracer.scene.scene import Scene

Named: TypeAlias = str | Path


def path_of(named: Named | Scene | None) -> Path | None:
    """Return an optional path; RunUsageError for a scene, whose fit would not be found."""
    if isinstance(named, Scene):
        raise RunUsageError("give the scene's file: the fit beside it holds the map uncertainty")
    return None if named is None else Path(named)


def file_of(named: Named | Scene) -> Path:
    """Return the path of a file; RunUsageError as `path_of`."""
    found = path_of(named)
    assert found is not None
    return found


def paths_of(named: Sequence[Named] | Named) -> list[Path]:
    """Return several paths; one alone is a list of one."""
    return [Path(named)] if isinstance(named, str | Path) else [Path(one) for one in named]


def one_of(named: Sequence[Named] | Named) -> Path:
    """Return the one path that was named; of several runs of one plan the newest finished one, which is said.

    Raises
    ------
    RunUsageError
        Several paths that are not runs, or runs of several plans.
    """
    paths = paths_of(named)
    if len(paths) == 1:
        return paths[0]
    from daq.runs.names import MAPS, is_run, main_run
    from daq.runs.run_folder import RunFolder  # most commands have no run
    from ground.terminal import console

    # Beside runs their maps are kept, which `runs/*` names, too.
    if len(paths := [path for path in paths if path.name != MAPS] or paths) == 1:
        return paths[0]
    if not all(map(is_run, paths)):
        raise RunUsageError(
            f"one folder is wanted, not {len(paths)}: {', '.join(map(str, paths))}; give one of them"
        )
    if len(set(map(main_run, paths))) < len(set(map(os.path.realpath, paths))):
        named = shlex.join(map(str, paths))
        raise RunUsageError(
            "these are cameras of one run, each with a view of its own; give one, or join them:"
            f" rtpiv mean --join {named}"
        )
    runs = [RunFolder.open(path) for path in paths]
    plans = sorted({run.about["name"] for run in runs})
    newest = max(runs, key=lambda run: (run.is_done, run.path.name)).path
    if len(plans) > 1:
        raise RunUsageError(f"the runs are of several plans ({', '.join(plans)}); give one: {newest}?")
    finished = "finished " if RunFolder(newest).is_done else ""
    said = f"{len(runs)} runs of {plans[0]} are given; using the newest {finished}one: {newest}"
    console().print(said, soft_wrap=True, highlight=False)
    return newest
