"""Memory is estimated before it is taken: what does not fit is refused in one sentence, not killed after minutes.

Linux hands memory out that it does not have, and ends the process that uses it.  What is free is the least of
what the system says, what the limits of its control group leave, and what the limit of the process leaves; where
nothing of that can be known, nothing is refused.
"""

import os
from pathlib import Path

from ground.errors import MemoryShort

MOST_PX = 1 << 28  # of a sensor or an image; the largest have half of that
SHARE = 0.9  # of what is free; the rest is for everybody else
ASKED_FROM_BYTES = 50_000_000  # less is not worth asking for
_GROUP = Path("/sys/fs/cgroup")


def free_bytes() -> int | None:
    """Memory that this process can still take; None if the system does not say."""
    found = [each for each in (_of_system(), _of_group(), _of_process()) if each is not None]
    return min(found) if found else None


def require_memory(needed_bytes: float, what: str) -> None:
    """Refuse what does not fit.

    Parameters
    ----------
    needed_bytes : float
        Estimate of all that is held at the same time.
    what : str
        What needs it, as the beginning of a sentence.

    Raises
    ------
    MemoryShort
        Less is free.
    """
    free = free_bytes() if needed_bytes >= ASKED_FROM_BYTES else None
    if free is not None and needed_bytes > SHARE * free:
        raise MemoryShort(
            f"{what} needs about {needed_bytes / 1e9:.1f} GB of memory, and {max(0, free) / 1e9:.1f} GB are free"
        )


def _of_system() -> int | None:
    lines = _lines(Path("/proc/meminfo"))
    for line in lines:
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) * 1024
    names = getattr(os, "sysconf_names", {})
    if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _of_group() -> int | None:
    """Left of the control group's limit (version 2); what the system only caches there counts as free."""
    limit, used = (_lines(_GROUP / f"memory.{name}") for name in ("max", "current"))
    if not (limit and used and limit[0].isdecimal() and used[0].isdecimal()):
        return None
    cached = sum(
        int(line.split()[1]) for line in _lines(_GROUP / "memory.stat") if line.startswith("inactive_file ")
    )
    return int(limit[0]) - int(used[0]) + cached


def _of_process() -> int | None:
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:  # not on this system
        return None
    limit = getrlimit(RLIMIT_AS)[0]
    pages = _lines(Path("/proc/self/statm"))
    if limit == RLIM_INFINITY or not pages:
        return None
    return limit - int(pages[0].split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []
