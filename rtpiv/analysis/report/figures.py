"""Figures of an evaluation: the vector field as in Figs. 7 and 8 of Martins et al. (2018), errors by radius.

Drawn narrow with large letters, so that they can be read on a phone and in a column of a paper.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from correction.evaluate.particle_tracks import PlaneVectors
from correction.evaluate.regions import Scatter
from correction.grid import PlaneGrid
from daq.runs.run_views import length_unit
from ground.plain_words import quantity
from piv.correlation.vector_field import VectorField
from rtpiv.analysis.pictures.plane_axes import (
    INK,
    NOTHING,
    SOFT,
    Figure,
    bare,
    bare_figure,
    colour_bar,
    draw_outlines,
    log_scale,
    plane_panels,
)
from tracer.scene.scene import Scene

ARROWS = 30  # drawn along the longer side, at most
MAX_ARROW = 1.6  # length over that of the 98th percentile: an outlier must not cross the picture
MOST_TRACKS = 4000  # drawn, evenly chosen
SERIES = ("#2b6a99", "#b4472f", "#6a8f3c", "#8a5a9e")
CUT = "#c2185b"  # clipped vectors
HEAT = LinearSegmentedColormap.from_list(
    "heat", ("#fbf7ea", "#f4cf6b", "#dd7a3a", "#a8323e", "#451a3f")
).with_extremes(bad=NOTHING)

GROUND = LinearSegmentedColormap.from_list(  # behind dark arrows: nowhere dark itself
    "ground", ("#fffdf6", "#fbe6a2", "#f5b971", "#e88a6a", "#d2728a")
).with_extremes(bad=NOTHING)
COMPONENTS = ("u, to the right", "v, down")

Floats = NDArray[np.float64]


def vector_figure(
    field: VectorField,
    grid: PlaneGrid,
    scene: Scene,
    colour: Floats,
    label: str,
    limit: float | None = None,
    scale: tuple[float, str] = (1.0, "px"),
) -> Figure:
    """Draw vectors, as many as can be seen apart, over a coloured background, on the plane in mm.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    grid : PlaneGrid
        Its scale.
    scene : Scene
        Whose bodies are outlined, as the camera sees them on the plane.
    colour : (ny, nx) float64
        Value behind each vector; NaN is grey.
    label : str
        Said at the colour bar.
    limit : float, optional
        End of the colour scale; default the 99th percentile of `colour`.
    scale : (float, str)
        Value of 1 px, and its unit, for the reference arrow above the picture.
    """
    x_mm, y_mm = _axes_mm(field, grid)
    half = 0.5 * field.step_px * grid.pitch_mm
    extent = (x_mm[0] - half, x_mm[-1] + half, y_mm[-1] - half, y_mm[0] + half)
    figure, (axes,) = plane_panels((extent[3] - extent[2]) / (extent[1] - extent[0]))
    top = limit if limit is not None else colour_limit(colour)
    image = axes.imshow(colour, extent=extent, cmap=GROUND, vmin=0.0, vmax=top, interpolation="nearest")
    draw_outlines(axes, scene, names=False)
    every = max(1, -(-max(field.flags.shape) // ARROWS))
    some = (slice(every // 2, None, every), slice(every // 2, None, every))
    shown = field.valid[some]
    grid_x, grid_y = np.meshgrid(x_mm, y_mm)
    place = np.stack((grid_x[some][shown], grid_y[some][shown]), axis=-1)
    shift = np.stack((field.u_px[some][shown], -field.v_px[some][shown]), axis=-1)
    draw_arrows(axes, place, shift, 1.7 * every * half, np.full(len(place), INK), scale)
    unit = length_unit(scene)
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]", aspect="equal", xlim=extent[:2], ylim=extent[2:])
    colour_bar(image, axes, label, "max")
    return figure


def draw_arrows(
    axes: Axes,
    place: Floats,
    shift: Floats,
    cell_mm: float,
    colours: NDArray[np.str_],
    scale: tuple[float, str] | None = None,
) -> None:
    """Draw arrows (N, 2) at places (N, 2) [mm]; one of the 98th percentile is `cell_mm` long.

    Vectors longer than MAX_ARROW times that percentile are clipped, drawn in another colour, and counted above the
    picture.  With the value and the unit of a length 1 a reference arrow stands there as well.
    """
    length = np.hypot(shift[:, 0], shift[:, 1])
    longest = max(float(np.percentile(length, 98)), 1e-9) if len(length) else 1.0
    cut = length > MAX_ARROW * longest
    drawn = np.where(cut[:, None], shift * (MAX_ARROW * longest / np.maximum(length, 1e-300))[:, None], shift)
    arrows = axes.quiver(
        *place.T,
        *drawn.T,
        color=np.where(cut, CUT, colours),
        pivot="mid",
        angles="xy",
        scale_units="xy",
        scale=longest / cell_mm,
        width=0.0034,
        headwidth=3.6,
        headlength=4.2,
        headaxislength=3.6,
        edgecolor="white",
        linewidth=0.3,
    )
    if scale is not None and len(length):
        said = f"{longest * scale[0]:.2g} {scale[1]}"
        axes.quiverkey(arrows, 0.04, 1.03, longest, said, labelpos="E", labelsep=0.06, fontproperties={"size": 8})
    if cut.any():
        many = quantity(int(cut.sum()), "vector")
        title = f"{many} clipped (longest {length.max() / longest:.2g} x reference)"
        axes.set_title(title, fontsize=8, color=CUT, loc="right")


def track_figure(tracks: PlaneVectors, scene: Scene) -> Figure:
    """Draw tracks where they are, at most `MOST_TRACKS` of them, on the plane in mm."""
    figure, axes = bare_figure(6.2, 5.3)
    draw_outlines(axes, scene, names=False)
    every = -(-len(tracks.branch) // MOST_TRACKS)
    place, shift = tracks.place_mm[::every], tracks.shift_mm[::every]
    low, high = tracks.place_mm.min(axis=0), tracks.place_mm.max(axis=0)
    colours = np.where(tracks.branch[::every] == 0, SERIES[0], SERIES[1])
    draw_arrows(axes, place, shift, 0.04 * float(np.max(high - low)), colours)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return figure


def colour_limit(colour: Floats) -> float:
    """End of a colour scale: what 99 % of the values stay below."""
    known = colour[np.isfinite(colour)]
    return max(float(np.percentile(known, 99)), 1e-6) if len(known) else 1.0


def radius_figure(rings: Mapping[tuple[float, float], Scatter]) -> Figure:
    """Draw errors behind the glass, u and v apart, against r / R."""
    figure, panels = _side_by_side(3.4)
    radius = [0.5 * (low + high) for low, high in rings]
    for component, axes in enumerate(panels):
        rms = [scatter.total_px[component] for scatter in rings.values()]
        axes.plot(radius, rms, "o-", color=SERIES[0], markersize=4, label="rms error")
        sigma = [scatter.sigma_px[component] for scatter in rings.values()]
        axes.plot(radius, sigma, "--", color=SERIES[0], linewidth=1.0, label="random sigma")
        axes.set(xlabel="r / R", xlim=(0.0, None), title=COMPONENTS[component])
        axes.grid(True, which="both", color=NOTHING, linewidth=0.5)
    panels[0].set_ylabel("error [px]")
    for axes in panels:
        log_scale(axes.yaxis)
    _legend_below(figure, panels[0])
    return figure


def error_histogram(errors: Mapping[str, Floats]) -> Figure:
    """Draw how the errors (N, 2) of regions are spread, u and v apart."""
    figure, panels = _side_by_side(3.2)
    reach = max((float(np.percentile(np.abs(e), 99)) for e in errors.values() if e.size), default=1.0)
    edges = np.linspace(-reach, reach, 61)
    for component, axes in enumerate(panels):
        for colour, (name, values) in zip(SERIES, errors.items(), strict=False):
            share, _ = np.histogram(values[:, component], edges)
            heights = 100.0 * share / max(len(values), 1)
            axes.stairs(heights, edges, color=colour, label=f"{name}, {len(values)}", linewidth=1.3)
        axes.axvline(0.0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="error [px]", ylim=(0.0, None), title=COMPONENTS[component])
    panels[0].set_ylabel("share of the vectors [%]")
    _legend_below(figure, panels[0])
    return figure


def _side_by_side(height_in: float) -> tuple[Figure, tuple[Axes, Axes]]:
    """A figure with one panel for u and one for v, on the same scale."""
    figure = Figure(figsize=(6.4, height_in), layout="constrained")
    one, other = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes in (one, other):
        bare(axes)
        axes.title.set(fontsize=10, color=SOFT)
    return figure, (one, other)


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)


def grey_histogram(counts: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """Draw intensity histograms (edges, pixels) by name on a logarithmic axis."""
    figure, axes = bare_figure(5.6, 2.8)
    for colour, (name, (edges, values)) in zip(SERIES, counts.items(), strict=False):
        axes.stairs(values, edges, label=name, color=colour)
    filled = [float(edges[np.nonzero(values)[0][-1] + 1]) for edges, values in counts.values() if values.any()]
    axes.set(xlabel="grey level", ylabel="pixels", xlim=(0.0, max(filled, default=None)))
    log_scale(axes.yaxis)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _axes_mm(field: VectorField, grid: PlaneGrid) -> tuple[Floats, Floats]:
    x_mm = grid.origin_mm[0] + field.x_px * grid.pitch_mm
    return x_mm, grid.origin_mm[1] - field.y_px * grid.pitch_mm
