"""Figures of an evaluation: the vector field as in Figs. 7 and 8 of Martins et al. (2018), errors by radius.

Drawn narrow with large letters, so that they can be read on a phone and in a column of a paper.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from correction.evaluate.shift import Scatter
from correction.evaluate.velocity_route import PlaneVectors
from correction.grid import PlaneGrid
from correction.piv.vector_field import VectorField
from tracer.scene import Scene

EVERY = 2  # vectors drawn along each axis
MOST_TRACKS = 4000  # drawn, evenly chosen
FEW_DECADES = 1000.0  # from the lowest to the highest: with more of them there is no room for labels between
INK, SOFT, NOTHING = "#1d2433", "#5c667a", "#d9dee8"
SERIES = ("#2b6a99", "#b4472f", "#6a8f3c", "#8a5a9e")
HEAT = LinearSegmentedColormap.from_list(
    "heat", ("#fbf7ea", "#f4cf6b", "#dd7a3a", "#a8323e", "#451a3f")
).with_extremes(bad=NOTHING)

Floats = NDArray[np.float64]


def vector_figure(
    field: VectorField, grid: PlaneGrid, scene: Scene, colour: Floats, label: str, limit: float | None = None
) -> Figure:
    """Draw every second vector over a coloured background, on the plane in mm.

    Parameters
    ----------
    field : VectorField
        Vectors on the corrected image.
    grid : PlaneGrid
        Its scale.
    scene : Scene
        Whose spheres are outlined.
    colour : (ny, nx) float64
        Value behind each vector; NaN is grey.
    label : str
        Said at the colour bar.
    limit : float, optional
        End of the colour scale; default the 99th percentile of `colour`.
    """
    figure, axes = bare_figure(6.2, 5.3)
    x_mm, y_mm = _axes_mm(field, grid)
    half = 0.5 * field.step_px * grid.pitch_mm
    extent = (x_mm[0] - half, x_mm[-1] + half, y_mm[-1] - half, y_mm[0] + half)
    top = limit if limit is not None else colour_limit(colour)
    image = axes.imshow(colour, extent=extent, cmap=HEAT, vmin=0.0, vmax=top, interpolation="nearest")
    for sphere in scene.spheres:
        x, y, _ = sphere.centre_mm
        axes.add_patch(Circle((x, y), sphere.radius_mm, fill=False, edgecolor=SOFT, linewidth=0.8, linestyle="--"))
    some = (slice(EVERY // 2, None, EVERY), slice(EVERY // 2, None, EVERY))
    shown = field.valid[some]
    u, v = field.u_px[some][shown], -field.v_px[some][shown]
    longest = max(float(np.percentile(np.hypot(u, v), 98)), 1e-9) if len(u) else 1.0
    grid_x, grid_y = np.meshgrid(x_mm, y_mm)
    axes.quiver(
        grid_x[some][shown],
        grid_y[some][shown],
        u,
        v,
        color=INK,
        pivot="mid",
        angles="xy",
        scale_units="xy",
        scale=longest / (1.7 * EVERY * half),
        width=0.0016,
        headwidth=4.0,
        headlength=4.5,
        headaxislength=4.0,
    )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=extent[:2], ylim=extent[2:])
    figure.colorbar(image, ax=axes, label=label, shrink=0.85, extend="max", pad=0.02)
    return figure


def track_figure(tracks: PlaneVectors, scene: Scene) -> Figure:
    """Draw tracks where they are, at most `MOST_TRACKS` of them, on the plane in mm."""
    figure, axes = bare_figure(6.2, 5.3)
    for sphere in scene.spheres:
        x, y, _ = sphere.centre_mm
        axes.add_patch(Circle((x, y), sphere.radius_mm, fill=False, edgecolor=SOFT, linewidth=0.8, linestyle="--"))
    every = -(-len(tracks.branch) // MOST_TRACKS)
    place, shift = tracks.place_mm[::every], tracks.shift_mm[::every]
    low, high = tracks.place_mm.min(axis=0), tracks.place_mm.max(axis=0)
    longest = max(float(np.percentile(np.linalg.norm(shift, axis=1), 98)), 1e-9)
    axes.quiver(
        *place.T,
        *shift.T,
        color=np.where(tracks.branch[::every] == 0, SERIES[0], SERIES[1]),
        pivot="mid",
        angles="xy",
        scale_units="xy",
        scale=longest / (0.04 * float(np.max(high - low))),
        width=0.0018,
    )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return figure


def colour_limit(colour: Floats) -> float:
    """End of a colour scale: what 99 % of the values stay below."""
    known = colour[np.isfinite(colour)]
    return max(float(np.percentile(known, 99)), 1e-6) if len(known) else 1.0


def radius_figure(
    image: Mapping[tuple[float, float], Scatter], velocity: Mapping[tuple[float, float], Scatter]
) -> Figure:
    """Draw the errors of both routes behind the glass against r / R; `velocity` may be empty."""
    figure, axes = bare_figure(5.6, 3.3)
    for rings, name, colour in ((image, "image route", SERIES[0]), (velocity, "velocity route", SERIES[1])):
        if not rings:
            continue
        radius = [0.5 * (low + high) for low, high in rings]
        axes.plot(radius, [scatter.rms_px for scatter in rings.values()], "o-", color=colour, label=f"{name}, rms")
        sigma = [float(np.sqrt(np.mean(np.square(scatter.sigma_px)))) for scatter in rings.values()]
        axes.plot(radius, sigma, "--", color=colour, linewidth=1.0, label=f"{name}, its own sigma")
    axes.set(xlabel="r / R", ylabel="error [px]", yscale="log", xlim=(0.0, None))
    axes.grid(True, which="both", color=NOTHING, linewidth=0.5)
    plain_decades(axes)
    axes.legend(frameon=False, fontsize=8)
    return figure


def error_histogram(errors: Mapping[str, Floats]) -> Figure:
    """Draw how the errors (N, 2) of regions are spread, per axis together."""
    figure, axes = bare_figure(5.6, 3.0)
    reach = max((float(np.percentile(np.abs(e), 99)) for e in errors.values() if e.size), default=1.0)
    edges = np.linspace(-reach, reach, 61)
    for colour, (name, values) in zip(SERIES, errors.items(), strict=False):
        share, _ = np.histogram(values, edges)
        heights = 100.0 * share / max(values.size, 1)
        axes.stairs(heights, edges, color=colour, label=name, linewidth=1.3)
    axes.set(xlabel="error of u and v [px]", ylabel="share of the vectors [%]", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def grey_histogram(counts: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """Draw intensity histograms (edges, pixels) by name on a logarithmic axis."""
    figure, axes = bare_figure(5.6, 2.8)
    for colour, (name, (edges, values)) in zip(SERIES, counts.items(), strict=False):
        axes.stairs(values, edges, label=name, color=colour)
    filled = [float(edges[np.nonzero(values)[0][-1] + 1]) for edges, values in counts.values() if values.any()]
    axes.set(yscale="log", xlabel="grey level", ylabel="pixels", xlim=(0.0, max(filled, default=None)))
    plain_decades(axes)
    axes.legend(frameon=False, fontsize=8)
    return figure


def plain_decades(axes: Axes) -> None:
    """Label decades, and 2 and 5 between few, as plain numbers: formulas would take longer than the curves."""
    axes.yaxis.set_major_formatter("{x:g}")
    low, high = axes.get_ylim()
    between = "25" if high < FEW_DECADES * low else ""
    axes.yaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in between else "")


def _axes_mm(field: VectorField, grid: PlaneGrid) -> tuple[Floats, Floats]:
    x_mm = grid.origin_mm[0] + field.x_px * grid.pitch_mm
    return x_mm, grid.origin_mm[1] - field.y_px * grid.pitch_mm


def bare_figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """A figure with one pair of axes, without frame."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(SOFT)
    axes.tick_params(color=SOFT, labelcolor=INK)
    return figure, axes
