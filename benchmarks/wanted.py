"""What is measured beside what is wanted, one row a question: the table of a budget of seconds.

    python -m benchmarks.wanted [--rounds 5] [--only kernels commands series] [--size 2016] [--folder FRAMES]

Each row is measured as its own benchmark does, `benchmarks.race`, `benchmarks.commands` and `benchmarks.series`,
and ends with how many times the wanted figure it is: 1 or less is met. Kernels are ratios of processor time within
a round; commands and series are wall clock, which needs idle cores: the load says whether they were. A row of a
contender that is not installed is left out with a line that says so. Not measured here: PIV beside PIVTOOLs
(``python -m benchmarks.piv --peer pivtools=PYTHON``), live vectors (``python -m benchmarks.pipeline --flow``).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.commands import frames_of, measured
from benchmarks.contenders import race, start, stop
from benchmarks.options import options
from benchmarks.race import measure
from benchmarks.scenes import MOVED, bench_scene
from piv.files.frame_file import read_frame
from tracer.strategies.ray_map import build_ray_map

ROWS = ("one_sphere_250", "two_spheres_500", "three_spheres_500", "pyramid_500")
COMMANDS = {
    "check": 0.5,
    "trace": 1.0,
    "correct": 1.0,
    "evaluate": 2.5,
    "calibrate": 5.0,
}  # seconds that are wanted
FIRST_MAP = """
from pathlib import Path
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map
build_ray_map(load_scene(Path(%r)))
"""


class Row(NamedTuple):
    """A question with its figure, what is wanted, and whether more is better."""

    what: str
    found: float
    wanted: float
    more: bool = False

    def __str__(self) -> str:
        """Return it as a row of a table."""
        ratio = self.wanted / self.found if self.more else self.found / self.wanted
        return f"| {self.what} | {self.found:.3g} | {'>=' if self.more else '<='} {self.wanted:g} | {ratio:.2f} |"


def kernel_rows(rounds: int) -> Iterator[Row]:
    """Maps and frames beside peers and what memory allows, scenes as a fit leaves them."""

    def ratios(scene: str, own: str, peers: list[str]) -> dict[str, float]:
        table = measure(scene, own, peers, rounds)
        return {task: each["ours_through_it"][1] for task, each in table.items() if "ours_through_it" in each}

    for name in ROWS:
        found = ratios(name + MOVED, "rtpiv, ray maps", ["plain C", *(["drjit"] if name == ROWS[0] else [])])
        for peer, wanted in (("plain C", 1.1), ("drjit", 0.6)):
            if f"{peer}: ray_map" in found:
                yield Row(f"ray map, {name}, through {peer}", found[f"{peer}: ray_map"], wanted)
    empty = ratios("empty" + MOVED, "rtpiv, ray maps", ["filling"])
    yield Row("camera without bodies through filling", empty["filling: ray_map"], 1.3)
    two = ratios("two_spheres_500" + MOVED, "rtpiv, ray maps", [])
    yield Row("fresh memory through reused", 1.0 / two["rtpiv, ray maps: ray_map, fresh"], 1.1)
    frames = ratios("two_spheres_500" + MOVED, "rtpiv, frames", [])
    yield Row("quintic frame through OpenCV's cubic", frames["rtpiv, frames: OpenCV cubic"], 1.0)
    inverse = measure("one_sphere_250" + MOVED, "rtpiv, correction maps", [], rounds)
    task_ms = {task.partition(": ")[2]: each["core_ms"][1] for task, each in inverse.items()}
    yield Row("correction map in writings", task_ms["correction map"] / task_ms["writing"], 4.0)


def bed_rows(rounds: int) -> Iterator[Row]:
    """Beds: time for each ball that a ray meets, and the correction map of a thousand on all cores."""
    for count in (16, 128, 1000):
        name = f"bed {count}{MOVED}"
        rays = build_ray_map(bench_scene(name))
        seen = np.bincount(rays.branch.ravel(), minlength=len(rays.branches))
        met = sum(int(pixels) * len(way) for pixels, way in zip(seen, rays.branches, strict=True))
        core_ms = measure(name, "rtpiv, ray maps", [], rounds)["rtpiv, ray maps: ray_map"]["core_ms"][1]
        yield Row(f"bed of {count}, ns a ball met", 1e6 * core_ms / met, 15.0)
    if (racer := start("rtpiv, correction maps", "bed 1000" + MOVED)) is not None:
        race([racer], 2)
        yield Row("correction map of 1000 balls, ms", 1e3 * float(np.median(racer.wall["correction map"])), 1100.0)
        stop([racer])


def command_rows(rounds: int, size: int, kept: Path | None) -> Iterator[Row]:
    """Commands with their pictures, seconds to wait for."""
    with frames_of(size, kept) as folder:
        for name, parts in measured(folder, list(COMMANDS), rounds, False).items():
            if name in COMMANDS:
                yield Row(f"{name}, s", parts["all"][0], COMMANDS[name])
        script = FIRST_MAP % str(folder / "frames" / "truth.yaml")
        timed = f"import time\nbegan = time.perf_counter()\n{script}\nprint(time.perf_counter() - began)"
        found = [float(subprocess.check_output([sys.executable, "-c", timed])) for _ in range(rounds)]
        yield Row("import and first map, s", float(np.median(found)), 0.5)
        frames = [read_frame(folder / "frames" / f"particles_clear_{name}.tif") for name in "ab"]
        yield Row(
            "a pair by two threads, times as fast as by one", gain_of_threads(frames, rounds), 1.87, more=True
        )


def gain_of_threads(frames: list[NDArray[Any]], rounds: int) -> float:
    """How many times as fast two threads evaluate a pair as one, by wall clock, in turns."""
    from piv.correlation.pair import evaluate_pair

    times: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(rounds + 1):
        for threads, taken in times.items():
            with patch.dict(os.environ, RTPIV_THREADS=str(threads)):
                began = time.perf_counter()
                evaluate_pair(*frames)
                taken.append(time.perf_counter() - began)
    return float(np.median(times[1][1:]) / np.median(times[2][1:]))


def series_rows() -> Iterator[Row]:
    """Two workers of a series of 24 pairs beside one."""
    words = [
        "-m",
        "benchmarks.series",
        "--pairs",
        "24",
        "--side",
        "1008",
        "--chunk",
        "2",
        "--workers",
        "1",
        "2",
        "-o",
    ]
    with tempfile.TemporaryDirectory() as folder:
        said = subprocess.check_output([sys.executable, *words, folder], text=True).splitlines()
    one, two = (json.loads(line.partition(": ")[2])["wall_s"] for line in said[-2:])
    yield Row("two workers, times as fast as one", one / two, 1.8, more=True)


def main() -> None:
    """Measure and print each row as soon as it is known."""
    asked = options(__doc__, rounds=5, only=["kernels", "commands", "series"], size=2016, folder=Path)
    print(f"load before: {os.getloadavg()[0]:.1f}\n\n| what | found | wanted | times wanted |\n|---|---|---|---|")
    groups: dict[str, Callable[[], Iterator[Row]]] = {
        "kernels": lambda: chain(kernel_rows(asked.rounds), bed_rows(2)),
        "commands": lambda: command_rows(asked.rounds, asked.size, asked.folder),
        "series": series_rows,
    }
    for name in asked.only:
        for row in groups[name]():
            print(row, flush=True)


if __name__ == "__main__":
    main()
