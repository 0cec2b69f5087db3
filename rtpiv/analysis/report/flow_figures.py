"""Figures of a mean flow beyond its vectors: profiles, steps at a rim, streamlines, stresses, convergence."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from piv.statistics.derived import Profile, RimStep
from rtpiv.analysis.pictures.canvas import Figure
from rtpiv.analysis.pictures.plane_axes import (
    INK,
    NOTHING,
    SOFT,
    bare_figure,
    colour_bar,
    draw_outlines,
    plane_panels,
)
from rtpiv.analysis.report.figures import HEAT, SERIES, plain_decades
from rtpiv.analysis.series.history import BINS, History
from rtpiv.analysis.series.mean_flow import MeanFlow
from tracer.scene.scene import Scene

LINES = LinearSegmentedColormap.from_list("lines", HEAT(np.linspace(0.25, 1.0, 64)))  # the palest is paper
SIGNED = LinearSegmentedColormap.from_list(
    "signed", ("#173f6b", "#5b93c2", "#f7f5f0", "#dd8a5a", "#8a2531")
).with_extremes(bad=NOTHING)

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def profiles_figure(profiles: Sequence[tuple[str, Profile, Bools]], component: int, label: str) -> Figure:
    """Draw one component along lines with its sigma; behind glass (a bool a point) the line is heavy."""
    figure, axes = bare_figure(5.8, 3.9)
    for colour, (name, found, glass) in zip(SERIES, profiles, strict=False):
        place = found.points[:, 0]
        value, sigma = found.uv[:, component], found.sigma[:, component]
        axes.fill_between(place, value - 2 * sigma, value + 2 * sigma, color=colour, alpha=0.25, linewidth=0)
        axes.plot(place, value, color=colour, linewidth=1.0, label=name)
        axes.plot(place, np.where(glass, value, np.nan), color=colour, linewidth=2.6)
    axes.axhline(0.0, color=NOTHING, linewidth=0.8, zorder=0)
    axes.set(xlabel="x [mm]", ylabel=label)
    axes.legend(frameon=False, fontsize=8)
    return figure


def steps_figure(steps: RimStep, centre: tuple[float, float]) -> Figure:
    """Draw steps across a rim by the angle around it, with 1 sigma."""
    figure, axes = bare_figure(5.8, 3.2)
    angle = np.degrees(np.arctan2(steps.place[:, 1] - centre[1], steps.place[:, 0] - centre[0]))
    order = np.argsort(angle)
    for component, (name, colour) in enumerate(zip(("u, to the right", "v, up"), SERIES, strict=False)):
        value, sigma = steps.step[order, component], steps.sigma[order, component]
        shown = angle[order] + (component - 0.5) * 2.0
        axes.errorbar(shown, value, sigma, fmt="o", color=colour, markersize=4, linewidth=1.0, label=name)
    axes.axhline(0.0, color=SOFT, linewidth=0.8)
    axes.set(xlabel="angle around the rim [degrees]", ylabel="inside minus outside [px]", xlim=(-185, 185))
    axes.set_xticks(range(-180, 181, 60))
    axes.legend(frameon=False, fontsize=8)
    return figure


def streamlines_figure(mean: MeanFlow, scene: Scene, speed: Floats) -> Figure:
    """Draw streamlines of the mean, in the colour of its speed; vectors are missing where nothing is seen."""
    figure, (axes,) = plane_panels(_ratio(mean))
    known = np.isfinite(mean.mean_m_s).all(axis=-1)
    u, v = (np.ma.masked_where(~known, np.nan_to_num(mean.mean_m_s[..., k])) for k in range(2))
    x, y = (np.linspace(side[0], side[-1], len(side)) for side in (mean.x_mm, mean.y_mm))
    colour = np.ma.masked_where(~known, np.nan_to_num(speed))
    top = float(np.nanmax(speed)) if known.any() else 1.0
    lines = axes.streamplot(
        x, y, u, v, color=colour, cmap=LINES, norm=Normalize(0.0, max(top, 1e-9)), density=1.4, linewidth=1.0
    )
    _plane(axes, mean, scene)
    colour_bar(lines.lines, axes, "mean speed [m/s]")
    return figure


def maps_figure(
    mean: MeanFlow, scene: Scene, maps: Sequence[tuple[str, Floats]], columns: int = 2, signed: bool = True
) -> Figure:
    """Draw scalars (ny, nx) on the plane, each with its own scale."""
    figure, panels = plane_panels(_ratio(mean), len(maps), columns, 2.9)
    half = 0.5 * (mean.x_mm[1] - mean.x_mm[0])
    extent = (mean.x_mm[0] - half, mean.x_mm[-1] + half, mean.y_mm[0] - half, mean.y_mm[-1] + half)
    for axes, (label, values) in zip(panels, maps, strict=True):
        known = values[np.isfinite(values)]
        top = max(float(np.percentile(np.abs(known), 99)), 1e-12) if known.size else 1.0
        both = signed and bool(known.size) and float(np.percentile(known, 2)) < -0.05 * top
        image = axes.imshow(
            values, extent=extent, origin="lower", interpolation="nearest", cmap=SIGNED if both else HEAT,
            vmin=-top if both else 0.0, vmax=top,
        )  # fmt: skip
        _plane(axes, mean, scene)
        axes.tick_params(labelsize=7)
        colour_bar(image, axes, label, "both" if both else "max")
    return figure


def convergence_figure(found: History) -> Figure:
    """Draw how the mean of the first n pairs came near that of all."""
    figure, axes = bare_figure(5.6, 3.2)
    known = np.isfinite(found.off_px) & (found.off_px > 0.0)
    axes.plot(found.pairs[known], found.off_px[known], "o-", color=SERIES[0], label="first n pairs minus all")
    axes.plot(found.pairs, found.expected_px, "--", color=SERIES[1], linewidth=1.0, label="independent pairs")
    axes.set(xlabel="pairs n", ylabel="rms difference [px]", yscale="log")
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(True, which="major", color=NOTHING, linewidth=0.5)
    plain_decades(axes)
    axes.legend(frameon=False, fontsize=8)
    return figure


def fractions_figure(found: History) -> Figure:
    """Draw where between pixels the displacements of all pairs fall."""
    figure, axes = bare_figure(5.6, 2.6)
    edges = np.linspace(-0.5, 0.5, BINS + 1)
    share = 100.0 * found.fractions / max(int(found.fractions.sum()), 1)
    axes.stairs(share, edges, color=SERIES[0], fill=True, alpha=0.6)
    axes.axhline(100.0 / BINS, color=INK, linewidth=0.8, linestyle="--")
    axes.set(xlabel="displacement minus the nearest whole pixel [px]", ylabel="share [%]", xlim=(-0.5, 0.5))
    return figure


def divergence_figure(ratios: dict[str, Floats]) -> Figure:
    """Draw how divergence over its sigma is spread in regions, beside what chance alone would do."""
    figure, axes = bare_figure(5.6, 2.9)
    edges = np.linspace(-5.0, 5.0, 51)
    for colour, (name, values) in zip(SERIES, ratios.items(), strict=False):
        share, _ = np.histogram(np.clip(values, -5.0, 5.0), edges)
        axes.stairs(100.0 * share / max(values.size, 1), edges, color=colour, label=name, linewidth=1.3)
    middle = 0.5 * (edges[1:] + edges[:-1])
    chance = 100.0 * (edges[1] - edges[0]) * np.exp(-0.5 * middle**2) / np.sqrt(2.0 * np.pi)
    axes.plot(middle, chance, "--", color=SOFT, linewidth=1.0, label="chance alone")
    axes.set(xlabel="divergence of the mean / its sigma", ylabel="share [%]", xlim=(-5.0, 5.0))
    axes.legend(frameon=False, fontsize=8)
    return figure


def _ratio(mean: MeanFlow) -> float:
    """Height over width of what is drawn."""
    return float((mean.y_mm[-1] - mean.y_mm[0]) / (mean.x_mm[-1] - mean.x_mm[0]))


def _plane(axes: Axes, mean: MeanFlow, scene: Scene) -> None:
    """Draw the outlines of the bodies; the plane in mm."""
    draw_outlines(axes, scene, names=False)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.set(xlim=(mean.x_mm[0], mean.x_mm[-1]), ylim=(mean.y_mm[0], mean.y_mm[-1]))
