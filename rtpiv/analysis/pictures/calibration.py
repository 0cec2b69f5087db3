"""Pictures of a calibration: residuals as arrows, and the sigma of the map."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator

from correction.fit.judge.result import FitStep
from correction.fitted.map_sigma import MapSigma
from rtpiv.analysis.calibration import Panel
from rtpiv.analysis.pictures.plane_axes import NOTHING, Figure, colour_bar, draw_outlines, plane_panels
from rtpiv.analysis.pictures.saved import save_picture
from tracer.scene.scene import Scene

SIGMAS = colormaps["viridis"].with_extremes(bad=NOTHING)
REACH = 2.0  # an arrow's length over that of the 95th percentile, at most: an outlier must not cross the picture


def draw_residuals(path: Path, panels: list[Panel], shape: tuple[int, int]) -> None:
    """Draw errors at their pixels as arrows, one panel a scene, as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    panels : list of (title, pixel (N, 2), error_px (N, 2))
        What to draw; each panel scales its arrows so that the 95th percentile is 1/25 of the frame, and none is
        longer than twice that.
    shape : (int, int)
        Rows and columns of the frame.
    """
    figure, drawn_in = plane_panels(shape[0] / shape[1], len(panels), max(len(panels), 1), 6.4)
    FigureCanvasAgg(figure)
    for axes, (title, pixel, error) in zip(drawn_in, panels, strict=True):
        length = np.hypot(error[:, 0], error[:, 1])
        typical = max(float(np.percentile(length, 95)), 1e-6)
        longest = REACH * typical
        drawn = error * np.minimum(1.0, longest / np.maximum(length, 1e-300))[:, None]
        shown = axes.quiver(
            *pixel.T,
            *drawn.T,
            length,
            angles="xy",
            scale_units="xy",
            scale=25.0 * typical / shape[1],
            width=0.0015,
            clim=(0.0, typical),
        )
        colour_bar(shown, axes, "distance [px]", "max")
        axes.set(xlim=(0, shape[1]), ylim=(shape[0], 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        axes.set_title(f"{title}: 95 % within {typical:.2f} px")
    save_picture(figure, path, 100)


def draw_map_sigma(path: Path, sigma: MapSigma, scene: Scene) -> None:
    """Draw the standard deviation of the correction as PNG."""
    figure = map_sigma_figure(sigma, scene)
    FigureCanvasAgg(figure)
    save_picture(figure, path, 100)


def map_sigma_figure(sigma: MapSigma, scene: Scene) -> Figure:
    """The standard deviation of the correction, both axes together, on a logarithmic scale of plain numbers."""
    total = np.hypot(sigma.sigma_px[..., 0], sigma.sigma_px[..., 1])
    known = total[np.isfinite(total) & (total > 0.0)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1e-3, 1e-2)
    height, width = total.shape
    figure, (axes,) = plane_panels(height / width)
    x0, y0, pitch = *sigma.grid.origin_mm, sigma.grid.pitch_mm
    extent = (x0, x0 + width * pitch, y0 - height * pitch, y0)
    shown = axes.imshow(
        np.maximum(total, low), extent=extent, cmap=SIGMAS, norm=LogNorm(low, max(high, 1.01 * low)),
        interpolation="nearest",
    )  # fmt: skip
    bar = colour_bar(shown, axes, "sigma [corrected px]")
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_formatter("")
    draw_outlines(axes, scene)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    return figure


def draw_convergence(path: Path, history: Sequence[FitStep]) -> None:
    """Draw the rms of every step of a fit that fitted something, with its corners, as PNG."""
    steps = [step for step in history if step.corners]
    figure = Figure(figsize=(8.0, 1.6 + 0.35 * len(steps)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    places = np.arange(len(steps))
    axes.plot([step.rms_px for step in steps], places, "o-")
    for place, step in zip(places, steps, strict=True):
        axes.annotate(f"  {step.corners}", (step.rms_px, place), va="bottom", fontsize=8)
    axes.set_yticks(places, [step.name for step in steps], fontsize=8)
    axes.set(xscale="log", xlabel="rms per axis [px], with the number of corners", title="convergence of the fit")
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    save_picture(figure, path, 100)
