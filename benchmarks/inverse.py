"""Correction maps: in ray maps, without the skip of views that cannot win, and after one sphere has moved.

    python -m benchmarks.inverse [--scenes two_spheres_500 ...] [--rounds 9]

Processor time of all threads [ms], medians of interleaved rounds; arrays of the map before are written again.
`moved` takes each sphere in turn a tenth of its radius aside (shrunk by as much, so that it touches nobody) and
back; its time is that of the map alone, both ray maps given, as that of a rebuild.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.scenes import bench_scene
from correction.correction_map import build_correction_map
from correction.moved import invert_again
from tracer.ray_map import build_ray_map
from tracer.rows import thread_count
from tracer.scene import Scene

SIDE_BY_SIDE = "six side by side"


def core_ms(task: Callable[[], object]) -> float:
    """Processor time of one call."""
    start = time.process_time()
    task()
    return 1e3 * (time.process_time() - start)


def aside(scene: Scene, which: int) -> Scene:
    """The scene with one sphere moved and smaller."""
    bodies = list(scene.spheres)
    ball = bodies[which]
    (x, y, z), shift = ball.centre_mm, 0.1 * ball.radius_mm
    bodies[which] = replace(ball, centre_mm=(x + shift, y, z), radius_mm=ball.radius_mm - shift)
    return scene.with_bodies(bodies)


def side_by_side() -> Scene:
    """Six spheres that hide nothing of each other: what moves touches a sixth of the glass."""
    scene = bench_scene("pyramid_500")
    places = [(x, y, 25.0) for x in (-45.0, 0.0, 45.0) for y in (-30.0, 30.0)]
    balls = [replace(scene.spheres[0], name=f"s{k}", centre_mm=c, radius_mm=19.0) for k, c in enumerate(places)]
    return scene.with_bodies(balls)


def measure(name: str, rounds: int) -> dict[str, object]:
    """Medians of one scene."""
    scene = side_by_side() if name == SIDE_BY_SIDE else bench_scene(name)
    rays = build_ray_map(scene)
    spare_rays, spare = build_ray_map(scene), build_correction_map(scene, rays)
    tasks: dict[str, Callable[[], object]] = {
        "ray map": lambda: build_ray_map(scene, spare_rays),
        "correction map": lambda: build_correction_map(scene, rays, out=spare),
        "without skip": lambda: build_correction_map(scene, rays, out=spare, skip=False),
    }
    times: dict[str, list[float]] = {task: [] for task in tasks}
    for number in range(rounds + 1):
        for task, function in tasks.items():
            taken = core_ms(function)
            if number:
                times[task].append(taken)
    ms = {task: round(float(np.median(taken)), 1) for task, taken in times.items()}
    ratios = [after_moving(scene, aside(scene, which), rounds) for which in range(len(scene.spheres))]
    return {**ms, "in ray maps": round(ms["correction map"] / ms["ray map"], 2), "moved, of a rebuild": ratios}


def after_moving(scene: Scene, other: Scene, rounds: int) -> float:
    """Time of a map after a move there or back, in rebuilds."""
    pair = (scene, other)
    rays, spare = [build_ray_map(each) for each in pair], build_correction_map(other, build_ray_map(other))
    moved, anew = [], []
    for number in range(rounds + 1):
        a, b = number % 2, 1 - number % 2
        kept = build_correction_map(pair[a], rays[a])
        moved.append(core_ms(partial(invert_again, kept, pair[a], rays[a], pair[b], rays[b], spare=spare)))
        anew.append(core_ms(partial(build_correction_map, pair[b], rays[b], out=spare)))
    return round(float(np.median(moved[1:]) / np.median(anew[1:])), 2)


def main() -> None:
    """Measure and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument(
        "--scenes", nargs="+", default=["one_sphere_250", "two_spheres_500", "pyramid_500", SIDE_BY_SIDE]
    )
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    report = {name: measure(name, options.rounds) for name in options.scenes}
    print(json.dumps({"threads": thread_count(), "core_ms": report}, indent=1))


if __name__ == "__main__":
    main()
