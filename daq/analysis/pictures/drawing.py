"""The scene from the side, with rays: what stands where, and what the glass does to the view."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from tracer.bodies import Sphere
from tracer.ray_path import ray_path
from tracer.scene import Scene

RAYS = 41


def scene_figure(scene: Scene) -> Figure:
    """Draw the bodies and a fan of rays over the x axis, seen along y."""
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.add_subplot()
    top = max([body.highest_mm for body in scene.bodies], default=50.0)
    _draw_rays(axes, scene)
    for body in Sphere.among(scene.bodies):
        x, _, z = body.centre_mm
        glass = body.medium is not None
        axes.add_patch(Circle((z, x), body.radius_mm, color="#8fb7d3" if glass else "#5c667a", alpha=0.35, lw=0))
        for core in body.cores:  # the denser, the bluer
            share = min(1.0, 2.0 * (core.medium.n(scene.wavelength_nm) - 1.0))
            axes.add_patch(Circle((z, x), core.radius_mm, color="white", lw=0))
            axes.add_patch(Circle((z, x), core.radius_mm, color="#8fb7d3", alpha=0.35 * share, lw=0))
        for radius_mm in (body.radius_mm, *(core.radius_mm for core in body.cores)):
            axes.add_patch(Circle((z, x), radius_mm, color="#1d2433", fill=False, lw=0.8))
        axes.annotate(body.name, (z, x), ha="center", va="center", fontsize=8, color="#1d2433")
    for support in scene.bodies:
        if not support.media and support.capsule.start_mm != support.capsule.end_mm:
            ends = np.array(support.capsule[:2])
            axes.plot(ends[:, 2], ends[:, 0], color="#5c667a", linewidth=4, solid_capstyle="round")
    axes.axvline(0.0, color="#1d2433", linewidth=1.5)
    reach = 1.2 * _reach_mm(scene)
    axes.set(xlim=(-0.05 * top, 1.35 * top), ylim=(-reach, reach), xlabel="z [mm], camera to the right")
    axes.set(ylabel="x [mm]", aspect="equal")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure


def _reach_mm(scene: Scene) -> float:
    return max([abs(sphere.centre_mm[0]) + sphere.radius_mm for sphere in scene.spheres], default=50.0)


def _draw_rays(axes: Axes, scene: Scene) -> None:
    """Draw a fan of rays; those that pass through glass in colour."""
    targets = np.zeros((RAYS, 3))
    targets[:, 0] = np.linspace(-1.2, 1.2, RAYS) * _reach_mm(scene)
    for pixel in scene.camera.project(targets):
        corners = ray_path(scene, pixel)
        colour, width = ("#b9c0cc", 0.6) if len(corners) == 2 else ("#dd7a3a", 0.8)
        axes.plot(corners[:, 2], corners[:, 0], color=colour, linewidth=width)
