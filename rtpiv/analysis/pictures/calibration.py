"""Pictures of a calibration: residuals as arrows, the sigma of the map, and what the test of the model looks at.

That is the smooth part of the residuals, path by path through the glass.  Corners scatter; a model that is wrong
bends.  Every panel shows one path, a ball or a chain of them, its arrows scaled by themselves and as many as can
be seen apart: a field that turns or points outwards is a ball that is not the sphere of the file, or a board that
is not flat; arrows that point anywhere are noise.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from correction.fit.judge.result import FitStep, SceneFit
from correction.fitted.map_sigma import MapSigma
from correction.fitted.scene_sigma import StoredVerdict
from rtpiv.analysis.calibration import Panel
from rtpiv.analysis.pictures.plane_axes import (
    NOTHING,
    Figure,
    colour_bar,
    draw_outlines,
    log_scale,
    plane_panels,
)
from rtpiv.analysis.pictures.saved import save_picture, short
from tracer.scene.scene import Scene

SIGMAS = colormaps["viridis"].with_extremes(bad=NOTHING)
MAX_RESIDUAL_ARROW = 2.0  # length over that of the 95th percentile: an outlier must not cross the picture


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
    for axes, (title, pixel, error) in zip(drawn_in, panels, strict=True):
        length = np.hypot(error[:, 0], error[:, 1])
        typical = max(float(np.percentile(length, 95)), 1e-6)
        longest = MAX_RESIDUAL_ARROW * typical
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
        np.maximum(total, low),
        extent=extent,
        cmap=SIGMAS,
        norm=LogNorm(low, max(high, 1.01 * low)),
        interpolation="nearest",
    )
    bar = colour_bar(shown, axes, "sigma [corrected px]")
    within = MaxNLocator(3, steps=[1, 2, 5, 10])  # of less than a decade a logarithmic one finds a dozen
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high > 5.0 * low else within)
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_formatter("")
    draw_outlines(axes, scene)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    return figure


def draw_convergence(path: Path, history: Sequence[FitStep]) -> None:
    """Draw the rms of every step of a fit that fitted something, with its corners, as PNG."""
    steps = [step for step in history if step.corners]
    figure = Figure(figsize=(8.0, 1.6 + 0.35 * len(steps)), layout="constrained")
    axes = figure.add_subplot()
    places = np.arange(len(steps))
    axes.plot([step.rms_px for step in steps], places, "o-")
    for place, step in zip(places, steps, strict=True):
        axes.annotate(f"  {step.corners}", (step.rms_px, place), va="bottom", fontsize=8)
    axes.set_yticks(places, [step.name for step in steps], fontsize=8)
    axes.set(xlabel="rms per axis [px], with the number of corners", title="convergence of the fit")
    axes.invert_yaxis()
    log_scale(axes.xaxis)
    axes.grid(alpha=0.3)
    save_picture(figure, path, 100)


Floats = NDArray[np.float64]

SIZES = ListedColormap(colormaps["viridis_r"](np.linspace(0.15, 1.0, 64)))  # the palest is paper
MOST_WAYS = 6  # with the most corners
MIN_CORNERS_DRAWN = 12  # corners of a way that is drawn
LEAST_PX = 1e-4  # that is drawn at its own scale: nothing smaller matters
ACROSS = 18  # arrows along a side of a panel, at most: each is the mean of its cell
ARROW = 1.5 / ACROSS  # length of an arrow of typical size, of the panel


def draw_smooth(path: Path, fit: SceneFit) -> None:
    """Draw it for a fit, as PNG; nothing where no way shows enough corners."""
    figure = smooth_figure(StoredVerdict.of(fit))
    if figure is not None:
        save_picture(figure, path, 100)


def smooth_figure(found: StoredVerdict, which: Literal["all", "first", "others"] = "all") -> Figure | None:
    """Draw the smooth part of the residuals, a panel for each path with many corners; None if there is none.

    Parameters
    ----------
    found : StoredVerdict
        Of a fit.
    which : {"all", "first", "others"}
        Panels: the first is the path behind glass with the most corners, or beside it where there is none.
    """
    count = np.bincount(found.way, minlength=len(found.ways))
    order = np.argsort(-count, kind="stable")
    drawn = [int(way) for way in order[:MOST_WAYS] if count[way] >= MIN_CORNERS_DRAWN]
    first = next((way for way in drawn if found.ways[way]), drawn[0] if drawn else -1)
    if which != "all":
        drawn = [way for way in drawn if (way == first) == (which == "first")]
    if not drawn:
        return None
    drawn.sort(key=lambda way: (len(found.ways[way]), found.ways[way]))
    columns = min(len(drawn), 2)
    figure, panels = plane_panels(1.0, len(drawn), columns)
    for axes, way in zip(panels, drawn, strict=True):
        here = found.way == way
        rms = float(np.sqrt(np.mean(found.smooth_px[here] ** 2)))
        pixel, smooth = _cell_means(found.pixel[here], found.smooth_px[here])
        length = np.hypot(*smooth.T)
        typical = max(float(np.percentile(length, 95)), LEAST_PX)
        low, high = pixel.min(axis=0), pixel.max(axis=0)
        middle, reach = 0.5 * (low + high), 0.55 * max(float((high - low).max()), 1.0)
        shown = axes.quiver(
            *pixel.T,
            *(smooth * np.minimum(1.0, typical / np.maximum(length, 1e-300))[:, None]).T,
            length,
            angles="xy",
            scale_units="xy",
            scale=typical / (2.0 * ARROW * reach),
            width=0.006,
            cmap=SIZES,
            clim=(0.0, typical),
        )
        bar = colour_bar(shown, axes, "smooth part [px]", "max")
        bar.ax.yaxis.set_major_locator(MaxNLocator(4))
        u, v = middle.tolist()
        axes.set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach), xlabel="u [px]", ylabel="v [px]")
        name = short(found.ways[way], 30) or "beside the glass"
        size = f"{rms:.2g}" if rms >= LEAST_PX else f"less than {LEAST_PX:g}"
        axes.set_title(f"{name}: {size} px rms", fontsize=10, parse_math=False)
    return figure


def _cell_means(pixel: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Means of places (N, 2) and values (N, 2) over cells, `ACROSS` of them along the longer side."""
    low = pixel.min(axis=0)
    cell = max(float((pixel.max(axis=0) - low).max()), 1.0) / ACROSS
    numbers = np.minimum(((pixel - low) / cell).astype(np.int64), ACROSS - 1) @ np.array([1, ACROSS])
    _, which, count = np.unique(numbers, return_inverse=True, return_counts=True)

    def means(each: Floats) -> Floats:
        return np.stack([np.bincount(which, part, len(count)) / count for part in each.T], axis=-1)

    return means(pixel), means(values)
