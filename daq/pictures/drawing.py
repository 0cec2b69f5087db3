"""The scene from the side, with rays: what stands where, and what the glass does to the view."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from tracer.bodies import Sphere
from tracer.ray_path import ray_path
from tracer.scene import Scene

RAYS = 41


def draw_scene(path: Path, scene: Scene, title: str) -> None:
    """Draw the bodies and a fan of rays over the x axis as PNG."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    top = max([body.highest_mm for body in scene.bodies], default=50.0)
    _draw_rays(axes, scene)
    for body in scene.bodies:
        if isinstance(body, Sphere):
            x, _, z = body.centre_mm
            colour = "0.3" if body.medium is None else "C0"
            axes.add_patch(Circle((z, x), body.radius_mm, color=colour, alpha=0.25, linewidth=0))
        else:
            ends = np.array([body.start_mm, body.end_mm])
            axes.plot(ends[:, 2], ends[:, 0], color="0.3", linewidth=4, solid_capstyle="round")
    axes.axvline(0.0, color="k", linewidth=1)
    reach = 1.2 * max([abs(b.centre_mm[0]) + b.radius_mm for b in scene.spheres], default=50.0)
    axes.set(xlim=(-0.05 * top, 1.35 * top), ylim=(-reach, reach), xlabel="z [mm], camera to the right")
    axes.set(ylabel="x [mm]", title=title, aspect="equal")
    figure.savefig(path, dpi=110)


def _draw_rays(axes: Axes, scene: Scene) -> None:
    """Draw a fan of rays; those that pass through glass in colour."""
    reach = max([abs(b.centre_mm[0]) + b.radius_mm for b in scene.spheres], default=50.0)
    targets = np.zeros((RAYS, 3))
    targets[:, 0] = np.linspace(-1.2 * reach, 1.2 * reach, RAYS)
    for pixel in scene.camera.project(targets):
        corners = ray_path(scene, pixel)
        colour = "0.75" if len(corners) == 2 else "C1"
        axes.plot(corners[:, 2], corners[:, 0], color=colour, linewidth=0.7)
