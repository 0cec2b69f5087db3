"""Frames through one correction map: ours against OpenCV and SciPy, interleaved in one run.

    python -m benchmarks.resample [--scenes two_spheres_500 ...] [--rounds 9]

Processor time of all threads [ms] a frame, median; wall clock beside it.  `region` corrects a window of the grid
that is a quarter of its sides, a sixteenth of its nodes.  OpenCV's cubic is a 4 x 4 kernel that does not reproduce
a ramp; SciPy's order 5 is the same spline as ours, on one thread.  Errors are measured in
tests/piv/resampling/test_sample.py.
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from benchmarks.scenes import bench_scene
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector, to_uint16
from ground.rows import thread_count
from piv.resampling.sample import Method, prefilter
from tracer.strategies.ray_map import build_ray_map

METHODS: tuple[Method, ...] = ("quintic", "bilinear")
SLOW = ("SciPy order 5",)


def contenders(scene_name: str) -> dict[str, Callable[[], object]]:
    """One frame of a scene by each."""
    scene = bench_scene(scene_name)
    cmap = build_correction_map(scene, build_ray_map(scene))
    frame = np.random.default_rng(0).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    rows, columns = cmap.grid.shape
    window = np.zeros((rows, columns), bool)
    window[3 * rows // 8 : 5 * rows // 8, 3 * columns // 8 : 5 * columns // 8] = True
    position = np.nan_to_num(cmap.pixel[0], nan=-1.0)
    u, v = (np.ascontiguousarray(position[..., k], np.float32) for k in (0, 1))
    coordinates = np.moveaxis(position[..., ::-1], -1, 0)
    out, coefficients = np.empty((rows, columns), np.float32), np.empty(frame.shape, np.float32)

    def ours(method: Method, mask: Any) -> Callable[[], object]:  # noqa: ANN401
        corrector = Corrector(cmap, method=method, mask=mask)
        return lambda: corrector(frame, out)

    made = {method: ours(method, None) for method in METHODS}
    made |= {f"{method}, region": ours(method, window) for method in METHODS}
    return {
        **made,
        "prefilter alone": lambda: prefilter(frame, coefficients),
        "to uint16": lambda: to_uint16(out),
        "OpenCV cubic": lambda: cv2.remap(frame, u, v, cv2.INTER_CUBIC),
        "OpenCV linear": lambda: cv2.remap(frame, u, v, cv2.INTER_LINEAR),
        "SciPy order 5": lambda: ndimage.map_coordinates(frame, coordinates, np.float32, order=5, mode="mirror"),
    }


def measure(scene_name: str, rounds: int) -> dict[str, dict[str, float]]:
    """Median times [ms] of each contender over interleaved rounds, the slow ones twice."""
    tasks = contenders(scene_name)
    core: dict[str, list[float]] = {name: [] for name in tasks}
    wall: dict[str, list[float]] = {name: [] for name in tasks}
    for name, task in tasks.items():
        if name not in SLOW:
            task()
    for number in range(rounds):
        for name, task in tasks.items():
            if name in SLOW and number >= 2:
                continue
            start, cpu = time.perf_counter(), time.process_time()
            task()
            core[name].append(1e3 * (time.process_time() - cpu))
            wall[name].append(1e3 * (time.perf_counter() - start))
    return {
        name: {
            "core_ms": round(float(np.median(core[name])), 2),
            "wall_ms": round(float(np.median(wall[name])), 2),
        }
        for name in tasks
    }


def main() -> None:
    """Measure and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--scenes", nargs="+", default=["one_sphere_250", "two_spheres_500", "pyramid_500"])
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    cv2.setNumThreads(thread_count())
    report = {name: measure(name, options.rounds) for name in options.scenes}
    print(json.dumps({"threads": thread_count(), "frames": report}, indent=1))


if __name__ == "__main__":
    main()
