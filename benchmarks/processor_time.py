"""Processor time of this process' threads, of its children and of everybody, from /proc (Linux).

    meter = ProcessorTime({"page's server": pid}); ...; meter.report()

Threads of ours are told apart by their Python names; kernels run in threads called rtpiv-rows. Children with a
name count with all that they have started, a browser's processes each under its type; the others are the camera's.
"""

import os
import re
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
TYPE = re.compile(rb"--type=([a-z-]+)")  # of a browser's process


class ProcessorTime:
    """Counts from its making to `report`.

    Parameters
    ----------
    named : mapping of str to int
        Children of ours that are told apart, by process id.
    """

    def __init__(self, named: Mapping[str, int] | None = None) -> None:
        self._named = {str(pid): name for name, pid in (named or {}).items()}
        self._begun_s = time.monotonic()
        self._parts = _parts(self._named)
        self._everybody_s = _everybody_s()

    def report(self) -> dict[str, float]:
        """Cores in use by part, and by processes that are not ours; their sum is at most the number of cores."""
        seconds = time.monotonic() - self._begun_s
        now = _parts(self._named)
        used = {name: (now[name] - self._parts[name]) / seconds for name in now}
        everybody = (_everybody_s() - self._everybody_s) / seconds
        used["other processes"] = everybody - sum(used.values())
        return {name: round(cores, 3) for name, cores in sorted(used.items(), key=lambda item: -item[1])}


def _parts(named: Mapping[str, str]) -> Counter[str]:
    parts: Counter[str] = Counter()
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    for task in Path("/proc/self/task").iterdir():
        name = names.get(int(task.name), "other threads").rstrip("_0123456789")
        parts[name] += _used_s(task / "stat")
    for child in _children("self"):
        _family(child, named.get(child, "camera's process"), parts)
    return parts


def _family(process: str, name: str, parts: Counter[str]) -> None:
    """Add a process and all below it; whoever ends meanwhile is left out."""
    with suppress(OSError):
        kind = TYPE.search(Path("/proc", process, "cmdline").read_bytes())
        parts[f"{name}: {kind[1].decode()}" if kind else name] += _used_s(Path("/proc", process, "stat"))
        for child in _children(process):
            _family(child, name, parts)


def _children(process: str) -> list[str]:
    tasks = Path("/proc", process, "task").iterdir()
    return [child for task in tasks for child in (task / "children").read_text().split()]


def _used_s(stat: Path) -> float:
    fields = stat.read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S  # utime, stime; see proc(5)


def _everybody_s() -> float:
    fields = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    return (sum(fields[:8]) - fields[3] - fields[4]) * TICK_S  # all but idle and waiting for a disk
