"""Ray maps in turns, as ratios: python -m benchmarks.race [--scenes ...] [--peers ...] [--rounds 15].

    python -m benchmarks.race --ours "rtpiv, correction maps" --peers    # in ray maps and in writings
    python -m benchmarks.race --ours "rtpiv, frames" --peers             # beside OpenCV and SciPy
    python -m benchmarks.race --before CHECKOUT                          # raced beside another one
    python -m benchmarks.race --rays 300                                 # and errors beside 50 digits

Scenes are as a fit leaves them unless named otherwise: the camera 3 mm aside and tilted.  Every contender has a
process of its own and takes its turn in every round.  Said are medians and quartiles: of the processor time of
all threads, and of our own first task divided by each task of the same round.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.contenders import IDEAL_LENS, STACKED, Racer, race, start, stop
from benchmarks.options import options
from benchmarks.scenes import MOVED, bench_scene
from tracer.scene.scene import Scene

SCENES = ("empty", "one_sphere_250", "one_sphere_500", "two_spheres_500", "three_spheres_500", "pyramid_500")
PEERS = ["filling", "plain C", "drjit", "mitsuba"]
MOST_OF_PLAIN = 16  # spheres that plain.c has room for; more of them no longer come by their heights
Table = dict[str, dict[str, Any]]


def in_one_row(scene: Scene) -> bool:
    """True if a formula for solid spheres on the camera's axis holds."""
    table = scene.sphere_table()
    row = bool((np.ptp(table[:, :2], axis=0) == 0.0).all()) if len(table) else False
    solid = not any(sphere.cores for sphere in scene.spheres) and len(table) == len(scene.bodies)
    return row and solid and not table[:, 5].any() and scene.camera.lens.is_ideal


def quartiles(values: list[float], digits: int) -> list[float]:
    """First quartile, median, third quartile."""
    return [round(float(x), digits) for x in np.percentile(values, (25, 50, 75))]


def apart(ours: Racer, peer: Racer) -> float:
    """Share of the pixels whose plane points are more than 1 um apart, or known to one of both only."""
    first, second = ours.ray_map(), peer.ray_map()
    near = np.abs(first - second).max(axis=2) < 1e-3
    return float(1.0 - (near | np.isnan(first + second).any(axis=2) & np.isnan(first).any(axis=2)).mean())


def measure(
    name: str, own: str, peers: list[str], rounds: int, before: Path | None = None, rays: int = 0
) -> Table:
    """One scene: core ms of all tasks; ratios of our first one to each; how many pixels differ; errors of rays."""
    scene = bench_scene(name)
    left_out = () if in_one_row(scene) else STACKED
    left_out += () if scene.camera.lens.is_ideal else (*IDEAL_LENS, "plain C")
    left_out += ("plain C",) if len(scene.spheres) > MOST_OF_PLAIN else ()
    names = [own, *(peer for peer in peers if peer not in left_out)]
    racers = [racer for peer in names if (racer := start(peer, name))]
    if before is not None and (racer := start(own, name, before)):
        racer.name = "before"
        racers.append(racer)
    race(racers, rounds)
    ours = np.array(next(iter(racers[0].cpu.values())))
    core: Table = {}
    for racer in racers:
        for task, taken in racer.cpu.items():
            core[f"{racer.name}: {task}"] = {
                "core_ms": quartiles([1e3 * t for t in taken], 2),
                "ours_through_it": quartiles((ours / np.array(taken)).tolist(), 3),
            }
    for racer in racers[1:]:
        if racer.name != "filling" and "ray_map" in racer.cpu:
            core[f"{racer.name}: ray_map"]["share_of_other_pixels"] = [apart(racers[0], racer)]
    if rays and scene.spheres:
        from benchmarks.reference import errors_um, reference_pixels  # needs mpmath

        known = reference_pixels(scene, rays)
        for racer in racers:
            if racer.name != "filling" and "ray_map" in racer.cpu:
                core[f"{racer.name}: ray_map"]["error_um"] = errors_um(racer.ray_map(), known)
    stop(racers)
    return core


def main() -> None:
    """Measure and print a line of JSON for each task of each scene."""
    scenes = [name + MOVED for name in SCENES]
    asked = options(__doc__, scenes=scenes, ours="rtpiv, ray maps", peers=PEERS, rounds=15, before=Path, rays=0)
    for name in asked.scenes:
        for task, said in measure(name, asked.ours, asked.peers, asked.rounds, asked.before, asked.rays).items():
            print(json.dumps({"scene": name, "task": task, **said}), flush=True)


if __name__ == "__main__":
    main()
