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
    figure = Figure(figsize=(12.0, 5.0), layout="constrained")
    curve, stages = figure.subplots(1, 2)
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
    figure.savefig(path, dpi=130)
