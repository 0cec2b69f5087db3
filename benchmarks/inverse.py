"""Correction maps in ray maps, with and without mirrors, in filling as much memory, and without a skip.

    python -m benchmarks.inverse [--scenes two_spheres_500 ...] [--rounds 9]

Processor time of all threads [ms], medians of interleaved rounds; arrays of the map before are written again.  The
skip is that of views that cannot win.
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np

from benchmarks.limits import fill
from benchmarks.scenes import bench_scene
from correction.maps.correction_map import build_correction_map
from ground.rows import run_rows, thread_count
from tracer.strategies.lockstep import ALL_SKIPS, SKIP_MIRRORED, trace_lockstep
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.strategy import Kind, choose


def core_ms(task: Callable[[], object]) -> float:
    """Processor time of one call."""
    start = time.process_time()
    task()
    return 1e3 * (time.process_time() - start)


def measure(name: str, rounds: int) -> dict[str, object]:
    """Medians of one scene."""
    scene = bench_scene(name)
    rays = build_ray_map(scene)
    spare_rays, spare = build_ray_map(scene), build_correction_map(scene, rays)
    tasks: dict[str, Callable[[], object]] = {
        "ray map": lambda: build_ray_map(scene, spare_rays),
        "ray map, no mirrors": lambda: trace_lockstep(
            scene, spare_rays.plane_mm, spare_rays.status, spare_rays.branch, ALL_SKIPS & ~SKIP_MIRRORED
        ),
        "correction map": lambda: build_correction_map(scene, rays, out=spare),
        "without skip": lambda: build_correction_map(scene, rays, out=spare, skip=False),
    }
    arrays = [value for value in vars(spare).values() if isinstance(value, np.ndarray)]
    lines = [array.reshape(-1, array.shape[-1]) for array in arrays]
    tasks["writing"] = lambda: [run_rows(lambda a, b, x=x: fill(a, b, x), len(x)) for x in lines]  # type: ignore[misc]
    if choose(scene).kind is not Kind.LOCKSTEP:
        del tasks["ray map, no mirrors"]
    times: dict[str, list[float]] = {task: [] for task in tasks}
    for number in range(rounds + 1):
        for task, function in tasks.items():
            taken = core_ms(function)
            if number:
                times[task].append(taken)
    ms = {task: round(float(np.median(taken)), 1) for task, taken in times.items()}
    ratios = {
        f"in units of a {rays}": round(ms["correction map"] / ms[rays], 2)
        for rays in ms
        if "ray map" in rays or rays == "writing"
    }
    return {**ms, **ratios}


def main() -> None:
    """Measure and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument(
        "--scenes", nargs="+", default=["one_sphere_250", "two_spheres_500", "three_spheres_500", "pyramid_500"]
    )
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    report = {name: measure(name, options.rounds) for name in options.scenes}
    print(json.dumps({"threads": thread_count(), "core_ms": report}, indent=1))


if __name__ == "__main__":
    main()
