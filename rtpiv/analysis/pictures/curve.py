"""The radial distortion curve r_i/R against r_o/R: Fig. 5 of Martins et al. (2018)."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from rtpiv.analysis.pictures.canvas import Figure
from rtpiv.analysis.pictures.saved import save_picture
from tracer.scene.scene import Scene
from tracer.strategies.fov import FieldOfView, radial_curve


def draw_curve(path: Path, scene: Scene, view: FieldOfView, title: str) -> None:
    """Draw the curve of a coaxial scene as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    scene : Scene
        The scene.
    view : FieldOfView
        Its figures, marked in the picture.
    title : str
        Said on top.
    """
    radius = view.radius_mm
    image = np.linspace(0.0, view.silhouette_mm, 1500)[:-1]
    plane, _ = radial_curve(scene, image)
    before = image <= view.fold_mm
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    limit = 1.05 * max(view.silhouette_mm, view.edge_mm) / radius
    axes.plot([0, limit], [0, limit], "--", color="0.6", label="no glass")
    axes.plot(image[before] / radius, abs(plane[before]) / radius, color="C0", label="through the glass")
    shown = ~before & (abs(plane) < limit * radius)
    axes.plot(image[shown] / radius, abs(plane[shown]) / radius, ":", color="C0", label="beyond the fold")
    axes.axvline(view.silhouette_mm / radius, color="C3", linewidth=1, label="silhouette")
    axes.plot(view.fold_mm / radius, view.edge_mm / radius, "o", color="C1", label="edge of the recovered region")
    axes.set(xlim=(0, limit), ylim=(0, limit), xlabel="image radius rᵢ / R", ylabel="plane radius |rₒ| / R")
    axes.set_title(title)
    axes.legend()
    save_picture(figure, path, 110)
