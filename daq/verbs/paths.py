"""Files and folders as people name them: as text or as `Path`, one or several."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

Named: TypeAlias = str | Path


def path_of(named: Named | None) -> Path | None:
    """Return an optional path."""
    return None if named is None else Path(named)


def paths_of(named: Sequence[Named] | Named) -> list[Path]:
    """Return several paths; one alone is a list of one."""
    return [Path(named)] if isinstance(named, str | Path) else [Path(one) for one in named]
