"""What arrangements show against how well: one point each, and those that no other beats."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm

from rtpiv.analysis.pictures.plane_axes import Figure
from rtpiv.analysis.pictures.saved import save_picture
from rtpiv.analysis.views.figures import ViewFigures

NAMED = 12  # of the unbeaten ones, by their number in the table


def draw_views(path: Path, views: Sequence[ViewFigures], best: Sequence[ViewFigures], error_px: float) -> None:
    """Draw the picture as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    views, best : sequence of ViewFigures
        All that show something, and the unbeaten among them in the order of their numbers.
    error_px : float
        What was asked for; drawn as a line.
    """
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    shown = [view for view in views if np.isfinite(view.noise_px)]
    light = np.array([view.light for view in shown])
    scale = LogNorm(light.min() / light.max(), 1.0) if light.min() < light.max() else LogNorm(0.1, 1.0)
    for some, size, edge in ((shown, 22, "none"), (best, 70, "black")):
        points = axes.scatter(
            [view.noise_px for view in some],
            [100.0 * view.usable for view in some],
            c=[view.light / light.max() for view in some],
            s=size,
            norm=scale,
            cmap="viridis",
            edgecolors=edge,
        )
    for number, view in enumerate(best[:NAMED], start=1):
        place = (view.noise_px, 100.0 * view.usable)
        axes.annotate(str(number), place, textcoords="offset points", xytext=(7, 4), fontsize=9)
    axes.axvline(error_px, linestyle="--", color="0.5", linewidth=1)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set(
        xlabel="noise of a displacement behind glass, median [corrected px]",
        ylabel="usable share of what the balls hide [%]",
        title=f"{len(shown)} arrangements; numbered: no other beats them",
    )
    figure.colorbar(points, ax=axes, format="{x:g}", label="light of a particle's picture, the brightest = 1")
    save_picture(figure, path, 110)
