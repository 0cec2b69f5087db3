"""Processor time of this process' threads, of its children and of everybody, from /proc (Linux).

    meter = ProcessorTime(); ...; meter.report()

Threads of ours are told apart by their Python names; kernels run in threads called rtpiv-rows.
"""

import os
import threading
import time
from collections import Counter
from pathlib import Path

TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class ProcessorTime:
    """Counts from its making to `report`."""

    def __init__(self) -> None:
        self._begun_s = time.monotonic()
        self._parts = _parts()
        self._everybody_s = _everybody_s()

    def report(self) -> dict[str, float]:
        """Cores in use by part, and by processes that are not ours; their sum is at most the number of cores."""
        seconds = time.monotonic() - self._begun_s
        now = _parts()
        used = {name: (now[name] - self._parts[name]) / seconds for name in now}
        everybody = (_everybody_s() - self._everybody_s) / seconds
        used["other processes"] = everybody - sum(used.values())
        return {name: round(cores, 3) for name, cores in sorted(used.items(), key=lambda item: -item[1])}


def _parts() -> Counter[str]:
    parts: Counter[str] = Counter()
    names = {thread.native_id: thread.name for thread in threading.enumerate()}
    for task in Path("/proc/self/task").iterdir():
        name = names.get(int(task.name), "other threads").rstrip("_0123456789")
        parts[name] += _used_s(task / "stat")
        for child in (task / "children").read_text().split():
            parts["camera's process"] += _used_s(Path("/proc") / child / "stat")
    return parts


def _used_s(stat: Path) -> float:
    fields = stat.read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S  # utime, stime; see proc(5)


def _everybody_s() -> float:
    fields = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    return (sum(fields[:8]) - fields[3] - fields[4]) * TICK_S  # all but idle and waiting for a disk
