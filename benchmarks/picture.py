"""The curve: run time of a ray map against its largest error outside the last 1 % of a sphere."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

MARKERS = "osD^vP*X"
FLOOR_PX = 1e-16


def draw(report: dict[str, Any], path: Path) -> None:
    """Draw run time against error, and run time of all stages by scene."""
    mpl.use("agg")
    figure = Figure(figsize=(12.0, 13.0), layout="constrained")
    (curve, stages), (pixels, bodies), (region, memory) = figure.subplots(3, 2)
    rows = report["scenes"]
    names = sorted({name for row in rows for name in row["contenders"]})
    for marker, name in zip(MARKERS, names, strict=False):
        points = []
        for row in rows:
            contender = row["contenders"].get(name, {})
            errors = [e["max_um"] for place, e in contender.get("error_um", {}).items() if place != "last 1 %"]
            if errors:
                points.append((contender["tasks"]["ray_map"]["wall_ms"], max(*errors, FLOOR_PX) / row["px_um"]))
        if points:
            curve.loglog(*np.transpose(points), marker, label=name, alpha=0.8)
    curve.set(xlabel="ray map, wall clock [ms]", ylabel="largest error outside the last 1 % [px]")
    curve.legend()
    curve.grid(alpha=0.3)
    labels = [row["scene"] for row in rows]
    tasks = ("ray_map", "correction_map", "quintic", "bilinear")
    for offset, task in enumerate(tasks):
        values = [row["contenders"]["rtpiv"]["tasks"][task]["wall_ms"] for row in rows]
        stages.bar(np.arange(len(rows)) + 0.2 * offset, values, 0.2, label=task.replace("_", " "))
    stages.set_yscale("log")
    stages.set_xticks(np.arange(len(rows)) + 0.3, labels, rotation=25, ha="right")
    stages.set_ylabel(f"wall clock [ms], {report['about']['threads']} threads")
    stages.legend()
    grown = report["growth"]
    for task in ("ray_map_ms", "correction_map_ms"):
        pixels.loglog(*_columns(grown["pixels"], "pixels", task), "o-", label=task[:-3].replace("_", " "))
    pixels.set(xlabel="pixels", ylabel="processor time [ms]")
    for random, label in ((0.0, "body-centred cubic"), (1.0, "random")):
        rows = [row for row in grown["bodies"] if row["random"] == random]
        bodies.loglog(*_columns(rows, "spheres", "us_covered_px"), "o-", label=label)
    bodies.set(xlabel="spheres", ylabel="processor time a covered pixel [us]")
    region.plot(*_columns(grown["region"], "nodes", "quintic_ms"), "o-", label="quintic frame")
    region.set(xlabel="recovered nodes", ylabel="processor time [ms]", ylim=(0.0, None))
    held = grown["memory_bytes_px"]
    memory.barh(list(held), list(held.values()))
    memory.axvline(48.0, color="k", lw=0.8, label="6 planes of float64")
    memory.set_xlabel("bytes a pixel")
    for axes in (pixels, bodies, region, memory):
        axes.legend()
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=130)


def _columns(rows: list[dict[str, float]], one: str, other: str) -> tuple[list[float], list[float]]:
    return [row[one] for row in rows], [row[other] for row in rows]
