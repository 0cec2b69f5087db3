"""Whole commands, as a person waits for them: cold and warm, and what the time goes into.

    python -m benchmarks.commands [-o FOLDER] [--size 2016] [--rounds 3] [--cold] [--only correct] [--keep]

Frames of three spheres are made once, then each command runs in a process of its own, as from a shell; `--cold`
first runs each once in a cache that is empty at the beginning, so that each compiles what those before it did not.
Each process counts its own time by what its first thread is at: starting Python, importing modules, compiling
kernels, loading compiled ones, drawing (pictures and pages, which come last), writing files; what is left is work.
Processor time is that of all threads and of the processes that the command started; compare it on a busy machine.

The budget: processor time in units of a fixed program (`REFERENCE`, NumPy and plain Python, nothing of ours) that
runs before each command.  `commands.json` holds the last record, by command and stage; what grew is printed, and
`--keep` writes the present figures in its place.  Who adds work to a command keeps it, and says which stage grew.
"""

import builtins
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from importlib.abc import Loader
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from threading import current_thread, main_thread
from types import FunctionType, ModuleType
from typing import Any

from benchmarks.options import keep, options

Times = dict[str, list[float]]  # part -> seconds of wall clock, of processors
PARTS = ("start", "import", "compile", "load", "work", "draw", "write", "children")
DRAWS = ("rtpiv.analysis.pictures.", "rtpiv.analysis.report.")
WRITES = (
    "piv.files.frame_file",
    "piv.files.vector_file",
    "daq.atomic_write",
    "rtpiv.analysis.report.pair_folder",
)
DRAWN = ("trace", "correct", "evaluate", "calibrate")
TOLD = "RTPIV_TIMES"  # file in which a measured process leaves its times
REFERENCE = """
import numpy
values = numpy.random.default_rng(0).normal(size=1_000_000)
for _ in range(5):
    numpy.sort(values), numpy.fft.rfft(values), numpy.exp(values).cumsum()
    sum(number * number for number in range(1_000_000))
"""
RECORD = Path(__file__).with_suffix(".json")
GREW, LEAST = (
    1.15,
    0.1,
)  # times the record, and by how many references, from which a stage has grown: noise is less
INSIDE = "import sys; from benchmarks.commands import inside; sys.exit(inside(sys.argv[2:], float(sys.argv[1])))"


class Parts:
    """Seconds of this process by what its first thread is at; parts may begin within others."""

    def __init__(self) -> None:
        self.seconds: Times = {part: [0.0, 0.0] for part in PARTS}
        self._stack = ["work"]
        self._since = (time.perf_counter(), time.process_time())

    def begin(self, part: str) -> None:
        """From now on the time is that of a part, until its end."""
        if current_thread() is main_thread():
            self._switch()
            self._stack.append(part)

    def end(self) -> None:
        """Go back to what was before."""
        if current_thread() is main_thread():
            self._switch()
            self._stack.pop()

    def _switch(self) -> None:
        now = (time.perf_counter(), time.process_time())
        for kind in (0, 1):
            self.seconds[self._stack[-1]][kind] += now[kind] - self._since[kind]
        self._since = now

    def timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        """Return a function whose time is that of a part."""

        @wraps(function)
        def called(*arguments: object, **options: object) -> object:
            self.begin(part)
            try:
                return function(*arguments, **options)
            finally:
                self.end()

        return called


class _Finder:
    """Lets functions be timed as soon as their modules are run: whoever imports them gets the timed ones."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> object:
        if not (name.startswith(DRAWS) or name in WRITES or name == "numba.core.caching"):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _Watched(spec.loader, self._parts)
        return spec


class _Watched(Loader):
    def __init__(self, loader: Loader, parts: Parts) -> None:
        self._loader, self._parts = loader, parts

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        if module.__name__ == "numba.core.caching":
            _watch_numba(self._parts, module)
            return
        for name, value in list(vars(module).items()):
            own = isinstance(value, FunctionType) and value.__module__ == module.__name__
            if own and module.__name__ not in WRITES:
                setattr(module, name, self._parts.timed(value, "draw"))
            elif own and name.startswith("write"):
                setattr(module, name, self._parts.timed(value, "draw" if name.endswith("page") else "write"))


def _watch_numba(parts: Parts, caching: ModuleType) -> None:
    from numba.core import event

    class Compiling(event.Listener):
        def on_start(self, event: object) -> None:
            parts.begin("compile")

        def on_end(self, event: object) -> None:
            parts.end()

    event.register("numba:compile", Compiling())
    caching.Cache.load_overload = parts.timed(caching.Cache.load_overload, "load")
    caching.Cache._load_overload = parts.timed(caching.Cache._load_overload, "load")
    caching.Cache.save_overload = parts.timed(caching.Cache.save_overload, "compile")


def inside(arguments: list[str], began_s: float) -> int:
    """Run a command in this process and leave its times where the environment says."""
    parts, plain, within = Parts(), builtins.__import__, False
    parts.seconds["start"] = [time.time() - began_s, time.process_time()]

    def imported(name: str, *more: object, **named: object) -> ModuleType:
        nonlocal within
        if within or current_thread() is not main_thread():
            return plain(name, *more, **named)
        within = True
        parts.begin("import")
        try:
            return plain(name, *more, **named)
        finally:
            parts.end()
            within = False

    builtins.__import__ = imported
    sys.meta_path.insert(0, _Finder(parts))
    try:
        from rtpiv.command_line.cli import main

        return main(arguments)
    finally:
        parts.begin("work")
        children = os.times()
        parts.seconds["children"][1] = children.children_user + children.children_system
        Path(os.environ[TOLD]).write_text(json.dumps(parts.seconds))


@contextmanager
def frames_of(size: int, folder: Path | None) -> Iterator[Path]:
    """Folder with frames of three spheres, made once."""
    from sim.demo.frames import make_frames

    with tempfile.TemporaryDirectory() as own:
        kept = folder or Path(own)
        if not (kept / "frames").is_dir():
            make_frames("three_spheres_500", size, 3, kept / "frames", samples=3, stack=False)
        yield kept


def commands(folder: Path) -> dict[str, list[str]]:
    """What is measured, by name; each needs something that those before it have not compiled."""
    frames, out = folder / "frames", ["-o", str(folder / "out")]
    true, nominal = ["--scene", str(frames / "truth.yaml")], ["--scene", str(frames / "scene.yaml")]
    target, *pair = (
        str(frames / f"{name}.tif") for name in ("target_glass", "particles_glass_a", "particles_glass_b")
    )
    named = {
        "trace": ["trace", true[1], *out],
        "correct": ["correct", target, *true, *out],
        "evaluate": ["evaluate", *pair, *true, *out],
        "calibrate": ["calibrate", str(frames), *nominal, *out],
    }
    plain = {f"{name}, no pictures": [*words, "--no-pictures"] for name, words in named.items()}
    return {"help": ["--help"], "check": ["check", true[1]], **named, **plain}


def run(words: list[str], folder: Path, cache: Path | None = None) -> Times:
    """Run a command as a process of its own; its times by part and in all."""
    told = folder / "times.json"
    environment = {**os.environ, TOLD: str(told), **({} if cache is None else {"RTPIV_CACHE": str(cache)})}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # modules are compiled once, as everywhere
    told.unlink(missing_ok=True)
    both = _seconds([sys.executable, "-c", INSIDE, str(time.time()), *words], environment)
    return {**json.loads(told.read_text()), "all": both}


def _seconds(command: list[str], environment: dict[str, str]) -> list[float]:
    """Wall clock and processor time of a process."""
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    after, wall = os.times(), time.perf_counter() - began
    if done.returncode:
        raise SystemExit(f"{' '.join(command[-3:])} ended with {done.returncode}:\n{done.stderr}")
    return [wall, after.children_user + after.children_system - before.children_user - before.children_system]


def run_reference() -> Times:
    """Times of the fixed program, as those of a command without parts."""
    both = _seconds([sys.executable, "-c", REFERENCE], {**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    return {**{part: [0.0, 0.0] for part in PARTS}, "all": both}


def budget(table: dict[str, Times]) -> dict[str, dict[str, float]]:
    """Processor time of each command and stage, in units of the reference."""
    unit = table["reference"]["all"][1]
    return {
        name: {part: round(used / unit, 3) for part, (_, used) in parts.items()}
        for name, parts in table.items()
        if name != "reference" and not name.endswith("cold")
    }


def compare(now: dict[str, dict[str, float]], record: dict[str, dict[str, float]]) -> list[str]:
    """Lines with each command beside its record, and with the stages that have grown."""
    lines = []
    for name, parts in now.items():
        before = record.get(name, {})
        grew = [
            f"{part} {before[part]:.2f} -> {value:.2f}"
            for part, value in parts.items()
            if part in before and value > GREW * before[part] and value > before[part] + LEAST
        ]
        known = f"{parts['all'] / before['all']:.2f} of the record" if before.get("all") else "no record"
        lines.append(
            f"{name}: {parts['all']:.2f} references, {known}{'; grew: ' if grew else ''}{', '.join(grew)}"
        )
    return lines


def measured(folder: Path, names: list[str], rounds: int, cold: bool) -> dict[str, Times]:
    """Medians of each command, warm; before them one cold run of each if asked for."""
    todo = {name: words for name, words in commands(folder).items() if not names or name in names}
    table: dict[str, Times] = {}
    if cold:
        with tempfile.TemporaryDirectory() as cache:
            for name, words in todo.items():
                if "no pictures" not in name:
                    table[f"{name}, cold"] = run(words, folder, Path(cache))
    found: dict[str, list[Times]] = {name: [] for name in ("reference", *todo)}
    for _ in range(rounds):
        for name, words in todo.items():
            found["reference"].append(run_reference())
            found[name].append(run(words, folder))
    for name, runs in found.items():
        table[name] = {
            part: [statistics.median(each[part][kind] for each in runs) for kind in (0, 1)]
            for part in ("all", *PARTS)
        }
    return table


def said(table: dict[str, Times]) -> str:
    """Rows of a table in Markdown: both times of all, then processor time by part."""
    head = ("command", "wall", "processor", *PARTS)
    rows = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, parts in table.items():
        figures = [*parts["all"], *(parts[part][1] for part in PARTS)]
        rows.append(f"| {name} | " + " | ".join(f"{value:.2f}" for value in figures) + " |")
    return "\n".join(rows)


def main() -> None:
    """Measure and print."""
    asked = options(__doc__, size=2016, rounds=3, cold=False, only=[], folder=Path, keep=False)
    with frames_of(asked.size, asked.folder) as folder:
        table = measured(folder, asked.only, asked.rounds, asked.cold)
    print(said(table))
    record = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
    print("\n".join(compare(budget(table), record)))
    if asked.keep:
        RECORD.write_text(json.dumps(record | budget(table), indent=1) + "\n")
    if asked.out is not None:
        keep(table, asked.out / "commands.json")


if __name__ == "__main__":
    main()
