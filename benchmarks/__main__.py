"""Run time against error, side by side with the peers that are installed: `make benchmark`.

Every contender has its own process; rounds are interleaved; medians and the spread (first and third quartile)
are given for wall clock, and medians for processor time, which neighbours on the machine disturb less.
Errors are taken against 50 digits (mpmath) of `--rays` rays a scene; a line says what is left out because
something is not installed.  `--beds` adds packed beds of 2 to 1000 spheres (minutes).
"""

import importlib.util
import json
import os
import platform
import statistics
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.contenders import IDEAL_LENS, SOLID_BALLS, STACKED, Racer, race, start, stop
from benchmarks.growth import growth
from benchmarks.limits import limits, limits_of
from benchmarks.options import options
from benchmarks.picture import draw
from benchmarks.scenes import BENCH_LIKE, PAPER, bench_scene
from correction.maps.correction_map import build_correction_map
from ground.rows import thread_count
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

BEDS = ("bed 2", "bed 16", "bed 128", "bed 1000")


def main() -> None:
    """Measure, print, write."""
    asked = options(
        __doc__, out=Path("benchmarks/results"), rounds=9, rays=300, scenes=[*PAPER, BENCH_LIKE], beds=False
    )
    about: dict[str, Any] = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "threads": thread_count(),
        "rounds": asked.rounds,
        "limits": limits(),
    }
    rows = [measure(name, asked.rounds, asked.rays) for name in asked.scenes]
    for row, name in zip(rows, asked.scenes, strict=True):
        row["limit_ms"] = limits_of(bench_scene(name), about["limits"])
    rows += [measure(name, 3, 0) for name in BEDS if asked.beds]
    report = {"about": about, "scenes": rows, "growth": growth(bench_scene(asked.scenes[-1]))}
    asked.out.mkdir(parents=True, exist_ok=True)
    (asked.out / "benchmark.json").write_text(json.dumps(report, indent=1))
    draw(report, asked.out / "benchmark.png")
    console = Console(width=150)
    for row in rows:
        console.print(table(row))
    console.print(about)


def in_one_row(scene: Scene) -> bool:
    """Return whether the peers' formulas serve: clear spheres in one row, and a camera without lens terms."""
    table = scene.sphere_table()
    row = bool((np.ptp(table[:, :2], axis=0) == 0.0).all()) if len(table) else False
    return (
        row
        and solid(scene)
        and not table[:, 5].any()
        and len(table) == len(scene.bodies)
        and scene.camera.lens.is_ideal
    )


def solid(scene: Scene) -> bool:
    """Return whether no sphere has another in it."""
    return not any(sphere.cores for sphere in scene.spheres)


def measure(name: str, rounds: int, rays: int) -> dict[str, Any]:
    """One scene: times of all contenders that are installed, errors of those that make a ray map."""
    scene = bench_scene(name)
    pixels = scene.camera.shape[0] * scene.camera.shape[1]
    names = ["rtpiv", *(["drjit", "torch", "jax", "mitsuba"] if rays else [])]
    if not in_one_row(scene):
        names = [peer for peer in names if peer not in STACKED]
    if not solid(scene):
        names = [peer for peer in names if peer not in SOLID_BALLS]
    if not scene.camera.lens.is_ideal:
        names = [peer for peer in names if peer not in IDEAL_LENS]
    racers = [racer for peer in names if (racer := start(peer, name))]
    race(racers, rounds)
    slow = ["raysect", "rtpiv, ray by ray", *(["numpy"] if in_one_row(scene) else [])]
    if not solid(scene):
        slow.remove("raysect")
    late = [racer for peer in (slow if rays else []) if (racer := start(peer, name))]
    race(late, 2)
    ray_map = build_ray_map(scene)
    recovered = build_correction_map(scene, ray_map).recovered
    known = known_pixels(scene, rays) if rays and scene.spheres else []
    result = {
        "scene": Path(name).stem if name.endswith(".yaml") else name,
        "glass_share": float((ray_map.branch != 0).mean()),
        "recovered_share": float(recovered.mean()),
        "px_um": 1e3 * scene.camera.position_mm[2] / scene.camera.focal_px,
        "contenders": {racer.name: times(racer, pixels, known) for racer in [*racers, *late]},
    }
    stop([*racers, *late])
    return result


def known_pixels(scene: Scene, rays: int) -> list[Any]:
    """Pixels with what 50 digits say about them; none where they cannot be reckoned."""
    if importlib.util.find_spec("mpmath") is None:
        print("errors are left out: mpmath is not installed", file=sys.stderr)
        return []
    from benchmarks.reference import reference_pixels

    return reference_pixels(scene, rays)


def times(racer: Racer, pixels: int, known: list[Any]) -> dict[str, Any]:
    """Times and errors of one contender."""
    tasks = {}
    for task, wall in racer.wall.items():
        quartiles = statistics.quantiles(wall, n=4) if len(wall) > 2 else [min(wall), wall[0], max(wall)]
        cpu = statistics.median(racer.cpu[task])
        tasks[task] = {
            "wall_ms": 1e3 * statistics.median(wall),
            "wall_ms_quartiles": [1e3 * quartiles[0], 1e3 * quartiles[2]],
            "cpu_ms": 1e3 * cpu,
            "cpu_ns_px": 1e9 * cpu / pixels,
        }
    result = {"version": racer.about["version"], "first_s": racer.about["first_s"], "tasks": tasks}
    if known and "ray_map" in tasks:
        from benchmarks.reference import errors_um

        result["error_um"] = errors_um(racer.ray_map(), known)
    return result


def table(row: dict[str, Any]) -> Table:
    """One scene as a table."""
    made = Table(title=f"{row['scene']}: {row['glass_share']:.0%} glass, {row['recovered_share']:.0%} recovered")
    for heading in ("contender", "task", "wall ms (quartiles)", "core ms", "core ns/px", "max error um by region"):
        made.add_column(heading, justify="left" if heading in ("contender", "task") else "right")
    for name, contender in row["contenders"].items():
        errors = contender.get("error_um", {})
        shown = "  ".join(f"{place} {value['max_um']:.0e}" for place, value in errors.items())
        for task, value in contender["tasks"].items():
            low, high = value["wall_ms_quartiles"]
            made.add_row(
                f"{name} {contender['version']}",
                task,
                f"{value['wall_ms']:.1f} ({low:.1f}-{high:.1f})",
                f"{value['cpu_ms']:.1f}",
                f"{value['cpu_ns_px']:.2f}",
                shown if task == "ray_map" else "",
            )
    return made


if __name__ == "__main__":
    main()
