"""How run time and memory grow: with the pixels of the sensor, the bodies, and the region that is recovered."""

import math
import os
import statistics
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.scenes import bed
from correction.maps.correction_map import build_correction_map
from correction.maps.corrector import Corrector
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

REPEATS = 5
THREAD_ROUNDS = 25
SPHERES = (2, 16, 128, 432, 1000)
SHARES = (0.25, 0.5, 0.75, 1.0)


def core_ms(task: Callable[[], Any]) -> float:
    """Median processor time of all threads [ms], warm."""
    task()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        task()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times)


def with_pixels(scene: Scene, factor: float) -> Scene:
    """The same view on a sensor with `factor` times the pixels each way."""
    return scene.with_camera(scene.camera.with_width(max(8, round(scene.camera.sensor_px[0] * factor))))


def over_pixels(scene: Scene) -> list[dict[str, float]]:
    """Ray map and correction map of the same view on larger and larger sensors."""
    rows = []
    for factor in (0.25, 0.5, 0.75, 1.0):
        smaller = with_pixels(scene, factor)
        ray_map = build_ray_map(smaller)
        corrected = build_correction_map(smaller, ray_map)
        rows.append(
            {
                "pixels": float(ray_map.status.size),
                "ray_map_ms": core_ms(lambda s=smaller, m=ray_map: build_ray_map(s, m)),  # type: ignore[misc]
                "correction_map_ms": core_ms(
                    lambda s=smaller, m=ray_map, c=corrected: build_correction_map(s, m, out=c)  # type: ignore[misc]
                ),
            }
        )
    return rows


def over_bodies() -> list[dict[str, float]]:
    """Ray maps of body-centred cubic and of random beds over the same square, 252 x 252 pixels."""
    rows = []
    for count in SPHERES:
        for packing in ("bcc", "random"):
            scene = with_pixels(bed(count, packing=packing), 0.125)
            made = build_ray_map(scene)
            time_ms = core_ms(lambda s=scene: build_ray_map(s))  # type: ignore[misc]
            covered = float(np.count_nonzero(made.branch))
            rows.append(
                {
                    "spheres": float(len(scene.spheres)),
                    "random": float(packing == "random"),
                    "core_ms": time_ms,
                    "us_covered_px": 1e3 * time_ms / max(covered, 1.0),
                    "covered_share": covered / made.branch.size,
                    "branches": float(len(made.branches)),
                }
            )
    return rows


def over_region(scene: Scene) -> list[dict[str, float]]:
    """Frames of which less and less is recovered: rows of the corrected image left out."""
    corrected = build_correction_map(scene, build_ray_map(scene))
    frame = np.random.default_rng(1).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    rows = []
    for share in SHARES:
        status = corrected.status.copy()
        status[round(share * len(status)) :] = 1
        corrector = Corrector(replace(corrected, status=status))
        out = np.empty(status.shape, np.float32)
        nodes = float((status == 0).sum())
        rows.append({"nodes": nodes, "quintic_ms": core_ms(lambda c=corrector, o=out: c(frame, o))})  # type: ignore[misc]
    return rows


def over_threads(scene: Scene) -> dict[str, float]:
    """How much faster all threads are than one: best wall clock of interleaved rounds with one and with all."""
    ray_map = build_ray_map(scene)
    corrected = build_correction_map(scene, ray_map)
    corrector, spare = Corrector(corrected), build_correction_map(scene, ray_map)
    frame = np.random.default_rng(1).integers(0, 4096, scene.camera.shape).astype(np.uint16)
    out = np.empty(corrected.grid.shape, np.float32)
    tasks: dict[str, Callable[[], Any]] = {
        "ray map": lambda: build_ray_map(scene, ray_map),
        "correction map": lambda: build_correction_map(scene, ray_map, out=spare),
        "quintic frame": lambda: corrector(frame, out),
    }
    asked = os.environ.get("RTPIV_THREADS")
    best = {(name, threads): math.inf for name in tasks for threads in ("1", asked)}
    for _ in range(THREAD_ROUNDS):
        for name, threads in best:
            os.environ["RTPIV_THREADS"] = threads or ""
            start = time.perf_counter()
            tasks[name]()
            best[name, threads] = min(best[name, threads], time.perf_counter() - start)
    os.environ["RTPIV_THREADS"] = asked or ""
    return {name: best[name, "1"] / best[name, asked] for name in tasks}


def memory(scene: Scene) -> dict[str, float]:
    """Bytes a pixel, at the peak while it is made and afterwards, of ray map and correction map."""
    pixels = float(np.prod(scene.camera.shape))
    ray_map = build_ray_map(scene)
    tasks: dict[str, Callable[[], Any]] = {
        "ray map": lambda: build_ray_map(scene),
        "correction map": lambda: build_correction_map(scene, ray_map),
    }
    result = {}
    for name, task in tasks.items():
        task()
        tracemalloc.start()
        kept = task()
        held, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        del kept
        result[f"{name}, peak"], result[f"{name}, kept"] = peak / pixels, held / pixels
    return result


def growth(scene: Scene) -> dict[str, Any]:
    """All of it."""
    return {
        "pixels": over_pixels(scene),
        "bodies": over_bodies(),
        "region": over_region(scene),
        "threads": over_threads(scene),
        "memory_bytes_px": memory(scene),
    }
