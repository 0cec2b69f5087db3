"""Files and folders as people name them: as text or as `Path`, one or several."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from daq.errors import RunUsageError
from tracer.scene.scene import Scene

Named: TypeAlias = str | Path


def path_of(named: Named | Scene | None) -> Path | None:
    """Return an optional path; RunUsageError for a scene, whose fit would not be found."""
    if isinstance(named, Scene):
        raise RunUsageError("give the scene's file: the fit beside it says how sure the map is")
    return None if named is None else Path(named)


def file_of(named: Named | Scene) -> Path:
    """Return the path of a file; RunUsageError as `path_of`."""
    found = path_of(named)
    assert found is not None
    return found


def paths_of(named: Sequence[Named] | Named) -> list[Path]:
    """Return several paths; one alone is a list of one."""
    return [Path(named)] if isinstance(named, str | Path) else [Path(one) for one in named]
