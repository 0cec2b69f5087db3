"""What the derivatives of a ray cost: `landings` against a plain `trace` of the same rays.

    python -m benchmarks.jacobian

Rays are those of corners: scattered over the sensor, all of them through glass where the scene allows it.
Both are called in turn; medians of the ratio over the rounds, in processor time and wall clock.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import PAPER, bench_scene
from tracer.scene.scene import Scene
from tracer.strategies.branches import DIRECT
from tracer.strategies.sensitivity import landings
from tracer.strategies.trace import trace

CLOCKS: dict[str, Callable[[], float]] = {"core": time.process_time, "wall": time.perf_counter}


def rays_through_glass(scene: Scene, count: int) -> NDArray[np.float64]:
    """Pixels (count, 2) scattered over what the glass covers."""
    width, height = scene.camera.sensor_px
    pixels = np.random.default_rng(0).uniform(0.0, (width - 1.0, height - 1.0), (20 * count, 2))
    behind = pixels[trace(scene, pixels).rays["key"] != DIRECT]
    return behind[np.arange(count) % len(behind)]


def ratios(scene: Scene, count: int, rounds: int) -> dict[str, list[float]]:
    """Ratio of each round, by clock."""
    pixels = rays_through_glass(scene, count)
    found: dict[str, list[float]] = {name: [] for name in CLOCKS}
    for _ in range(rounds + 1):
        spent = []
        for work in (trace, landings):
            before = {name: clock() for name, clock in CLOCKS.items()}
            work(scene, pixels)
            spent.append({name: clock() - before[name] for name, clock in CLOCKS.items()})
        for name in CLOCKS:
            found[name].append(spent[1][name] / spent[0][name])
    return {name: values[1:] for name, values in found.items()}  # the first round compiles


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.jacobian", description=__doc__)
    parser.add_argument("--rays", type=int, default=20000)
    parser.add_argument("--rounds", type=int, default=21)
    options = parser.parse_args()
    for name in PAPER:
        scene = bench_scene(name)
        found = ratios(scene, options.rays, options.rounds)
        words = ", ".join(f"{clock} {statistics.median(values):.2f}" for clock, values in found.items())
        print(f"{name}: derivatives by all {14 + 5 * len(scene.spheres) + 6} numbers cost {words} plain traces")


if __name__ == "__main__":
    main()
