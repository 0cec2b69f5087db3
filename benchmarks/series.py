"""A series of many pairs on this machine: memory while it grows, and what a second process gains.

    python -m benchmarks.series [--pairs 96] [--side 2016] [--chunk 16] [--workers 1 2] [-o FOLDER]

A flow run of `--pairs` pairs is written (particles that move by a few pixels behind two balls, a few different
pairs over and over), then evaluated into a new folder with each number of workers in turn.  Said are the resident
memory of one process as pairs go by, the largest of any process, wall time, and processor time, which neighbours
on the machine disturb less.  One worker has one thread, as each of several has.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.options import options
from daq.runs.journal import Journal
from daq.runs.pairs import pairs_of
from daq.runs.raw_frame import checksum, write_raw
from daq.runs.run_folder import RunFolder
from rtpiv.analysis.pairs.piv_file import piv_choice
from rtpiv.analysis.series.run_series import run_series
from rtpiv.analysis.series.series_input import series_input
from rtpiv.analysis.series.series_pairs import pairs_of_series
from sim.demo.scenes import at_size, demo_scene
from tracer.scene.scene_file import dump_scene

ONE_THREAD = {"RTPIV_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
DIFFERENT = 4  # pairs; what they hold does not matter for time and memory
PER_PX, COUNTS, FLOOR, NOISE = 0.03, 300.0, 35.0, 3.0
BENCH = """name: bench
scene: scene.yaml
stages:
  controllers: {box: {driver: zaber_ascii, port: /dev/box}}
  axes:
    target_x: {controller: box, channel: 1/1, carries: target, along: x, limits_mm: [-9.0, 9.0], speed_mm_s: 1.0,
               acceleration_mm_s2: 1.0}
  home_order: [target_x]
camera: {backend: files}
"""
# A process of its own, so that its memory and its time are those of one evaluation.
ONCE = """
import sys
from pathlib import Path
from benchmarks.series import once
run, out, workers, chunk, warm = sys.argv[1:]
once(Path(run), Path(out), int(workers), int(chunk), warm == "1")
"""
Floats = NDArray[np.float64]


def main() -> None:
    """Measure and print."""
    asked = options(__doc__, pairs=96, side=2016, chunk=16, workers=[1, 2])
    with TemporaryDirectory() as own:
        folder = asked.out or Path(own)
        run = next(folder.glob("*_flow"), None) or written_run(folder, asked.pairs, asked.side)
        for workers in asked.workers:
            shutil.rmtree(folder / "series", ignore_errors=True)
            series_input(run, folder / "series", piv_choice())  # the scene; its map is made before the clock runs
            command = [sys.executable, "-c", ONCE, str(run), str(folder / "series")]
            for warm in (True, False):
                if not warm:
                    shutil.rmtree(folder / "series" / "chunks")
                words = [*command, str(workers), str(asked.chunk), "1" if warm else "0"]
                own = os.environ | ONE_THREAD
                said = subprocess.run(words, check=True, capture_output=True, text=True, env=own).stdout
            print(f"{workers} workers: {said.strip().splitlines()[-1]}", flush=True)


def once(run: Path, out: Path, workers: int, chunk: int, warm: bool) -> None:
    """Evaluate a run into a folder and print what it took, as JSON; `warm`: its first pair only."""
    given = series_input(run, out, piv_choice())
    if warm:
        few = pairs_of_series(run, pairs_of(run))
        few = replace(few, pairs=few.pairs[:2])
        run_series(replace(given, given=few), 1, chunk)
        return
    watch = _Watch()
    wall = time.perf_counter()
    run_series(given, workers, chunk, watch if workers == 1 else None)
    wall = time.perf_counter() - wall
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    found: dict[str, Any] = {
        "pairs": len(given.given.pairs),
        "wall_s": round(wall, 1),
        "processor_s": round(sum(each.ru_utime + each.ru_stime for each in used), 1),
        "largest_MB": round(max(each.ru_maxrss for each in used) / 1024),
    }
    if watch.resident_mb:
        found["resident_MB_by_pairs"] = dict(zip(watch.pairs, watch.resident_mb, strict=True))
    print(json.dumps(found))


class _Watch(Executor):
    """Works here, and looks at the memory after each chunk."""

    def __init__(self) -> None:
        self.pairs: list[int] = []
        self.resident_mb: list[int] = []

    def submit(self, function: Callable[..., Any], /, *jobs: Any, **options: Any) -> Future[Any]:  # noqa: ANN401
        """Call it now."""
        (job,) = jobs
        future: Future[Any] = Future()
        future.set_result(function(job))
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.pairs.append(sum(self.pairs[-1:]) + len(job.pairs))
        self.resident_mb.append(round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20))
        return future


def written_run(folder: Path, pairs: int, side: int) -> Path:
    """Write a flow run."""
    scene = at_size(demo_scene("two_spheres_500"), side)
    step = {"index": 0, "tag": "flow", "first_frame": 0, "frames": 2 * pairs, "view": "glass", "shows": "sheet",
            "on_plane": True, "reference": None, "group": 2, "dt_us": 500.0}  # fmt: skip
    asked = {"bench": "bench.yaml", "plan": "plan.yaml", "simulate": True, "correct": False, "scene": None,
             "target_clear": None, "dewarp_order": 2, "method": "quintic", "live_queue": 4}  # fmt: skip
    about = {"name": "flow", "request": asked, "hashes": {}, "versions": {}, "plan": "flow", "bench": BENCH,
             "scene": dump_scene(scene), "square_mm": 2.5, "steps": [step]}  # fmt: skip
    run = RunFolder.create(folder, "flow", about)
    journal = Journal(run.journal_path)
    rng, here_mm = np.random.default_rng(1), {"target_x": 0.0}
    drawn = [_pair(rng, side) for _ in range(DIFFERENT)]
    for number in range(2 * pairs):
        pixels = drawn[number // 2 % DIFFERENT][number % 2]
        pixels[0, 0] = number  # no camera gives a picture twice
        facts = {"step": 0, "tag": "flow", "crc32": checksum(pixels), "frame_id": number, "sequence": number,
                 "timestamp_ns": 10**9 + 10**8 * (number // 2) + 500_000 * (number % 2), "received_ns": 10**9,
                 "exposure_us": 100.0, "bits": 12, "planned_mm": here_mm, "measured_mm": here_mm,
                 "pair": {"exposure": "AB"[number % 2], "chunk": 0, "dt_us": 500.0,
                          "marker": "halves"}}  # fmt: skip
        write_raw(run.frame_path(number), pixels, facts)
        journal.append("frame", frame=number, file=f"frames/{number:06d}.tif", **facts)
    journal.close()
    return run.path


def _pair(rng: np.random.Generator, side: int) -> list[NDArray[np.uint16]]:
    """Frames A and B of particles that move by some pixels and turn."""
    count = round(PER_PX * side * side)
    places, light = rng.uniform(0.0, side, (count, 2)), rng.uniform(0.2, 1.0, count) * COUNTS
    off = places / side - 0.5
    way = np.stack((4.0 - 6.0 * off[:, 1], 2.0 + 6.0 * off[:, 0]), axis=-1)
    return [_drawn(rng, places + sign * way, light, side) for sign in (-0.5, 0.5)]


def _drawn(rng: np.random.Generator, places: Floats, light: Floats, side: int) -> NDArray[np.uint16]:
    image = rng.normal(FLOOR, NOISE, (side, side))
    middle = np.rint(places).astype(int)
    for row in range(-3, 4):
        for column in range(-3, 4):
            at = middle + np.array((column, row))
            inside = ((at >= 0) & (at < side)).all(axis=1)
            height = light * np.exp(-((at - places) ** 2).sum(axis=1) / (2 * 0.9**2))
            np.add.at(image, (at[inside, 1], at[inside, 0]), height[inside])
    return np.clip(np.rint(image), 0, 4095).astype(np.uint16)


if __name__ == "__main__":
    main()
