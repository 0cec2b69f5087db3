"""The chapters of a mean flow that ask whether it can be true, and their figures.

Across the rim, along lines, mass, convergence: profiles, steps at a rim, streamlines, stresses, history.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from correction.evaluate.regions import Region, Regions, regions_of
from piv.statistics.derived import (
    Axis,
    Profile,
    RimStep,
    divergence,
    jet_axis,
    profile,
    rates,
    rim_steps,
)
from rtpiv.analysis.pictures.plane_axes import (
    INK,
    NOTHING,
    SOFT,
    Figure,
    bare_figure,
    colour_bar,
    draw_outlines,
    log_scale,
    plane_panels,
)
from rtpiv.analysis.report.figures import HEAT, SERIES
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.report.tables import ALL, parts_of
from rtpiv.analysis.series.history import BINS, History, history
from rtpiv.analysis.series.joined_views import JoinedViews
from rtpiv.analysis.series.mean_flow import MeanFlow, image_field
from rtpiv.analysis.series.series_folder import Chunks
from rtpiv.analysis.series.series_view import SeriesView
from tracer.scene.scene import Scene

Floats = NDArray[np.float64]
STREAM_COLOURS = LinearSegmentedColormap.from_list(
    "lines", HEAT(np.linspace(0.25, 1.0, 64))
)  # the palest is paper
SIGNED = LinearSegmentedColormap.from_list(
    "signed", ("#173f6b", "#5b93c2", "#f7f5f0", "#dd8a5a", "#8a2531")
).with_extremes(bad=NOTHING)

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
        x,
        y,
        u,
        v,
        color=colour,
        cmap=STREAM_COLOURS,
        norm=Normalize(0.0, max(top, 1e-9)),
        density=1.4,
        linewidth=1.0,
    )
    _plane(axes, mean, scene, mean.length)
    colour_bar(lines.lines, axes, f"mean speed [{mean.unit}]")
    return figure


def maps_figure(
    mean: MeanFlow | JoinedViews, scene: Scene, maps: Sequence[tuple[str, Floats]], length: str = "mm"
) -> Figure:
    """Draw scalars (ny, nx) on the plane, each with its own scale."""
    figure, panels = plane_panels(_ratio(mean), len(maps), *((2, 2.9) if len(maps) > 1 else ()))
    half = 0.5 * (mean.x_mm[1] - mean.x_mm[0])
    extent = (mean.x_mm[0] - half, mean.x_mm[-1] + half, mean.y_mm[0] - half, mean.y_mm[-1] + half)
    for axes, (label, values) in zip(panels, maps, strict=True):
        known = values[np.isfinite(values)]
        top = max(float(np.percentile(np.abs(known), 99)), 1e-12) if known.size else 1.0
        both = bool(known.size) and float(np.percentile(known, 2)) < -0.05 * top
        image = axes.imshow(
            values,
            extent=extent,
            origin="lower",
            interpolation="nearest",
            cmap=SIGNED if both else HEAT,
            vmin=-top if both else 0.0,
            vmax=top,
        )
        _plane(axes, mean, scene, length)
        axes.tick_params(labelsize=7)
        colour_bar(image, axes, label, "both" if both else "max")
    return figure


def convergence_figure(found: History) -> Figure:
    """Draw how the mean of the first n pairs came near that of all."""
    figure, axes = bare_figure(5.6, 3.2)
    known = np.isfinite(found.off_px) & (found.off_px > 0.0)
    axes.plot(found.pairs[known], found.off_px[known], "o-", color=SERIES[0], label="first n pairs minus all")
    axes.plot(found.pairs, found.expected_px, "--", color=SERIES[1], linewidth=1.0, label="independent pairs")
    axes.set(xlabel="pairs n", ylabel="rms difference [px]")
    log_scale(axes.xaxis, base=2)
    axes.grid(True, which="major", color=NOTHING, linewidth=0.5)
    log_scale(axes.yaxis)
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


def _ratio(mean: MeanFlow | JoinedViews) -> float:
    """Height over width of what is drawn."""
    return float((mean.y_mm[-1] - mean.y_mm[0]) / (mean.x_mm[-1] - mean.x_mm[0]))


def _plane(axes: Axes, mean: MeanFlow | JoinedViews, scene: Scene, length: str) -> None:
    """Draw the outlines of the bodies, and name the axes."""
    draw_outlines(axes, scene, names=False)
    axes.set(xlabel=f"x [{length}]", ylabel=f"y [{length}]", aspect="equal")
    axes.set(xlim=(mean.x_mm[0], mean.x_mm[-1]), ylim=(mean.y_mm[0], mean.y_mm[-1]))


LINES = 4  # profiles across the flow
REACH_STEPS = 5.0  # from the rim, of vectors that tell a step
STEP_COLUMNS = (
    "rim around x, y [mm]",
    "pieces",
    "weighted mean u, v [px]",
    "rms u, v [px]",
    "sigma [px]",
    "within 1 sigma",
)


def regions_of_mean(view: SeriesView, mean: MeanFlow) -> Regions:
    """Regions of the vectors of a mean, rows from the lowest y up, by the map of its series."""
    known = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, view.windows)
    seen = regions_of(known, view.correction.corrector.map, view.scene)
    return Regions(seen.region[::-1], seen.radius[::-1])


def flow_chapters(page: Page, view: SeriesView, mean: MeanFlow, regions: Regions) -> None:
    """Add the chapters of the mean of a series."""
    checks_of(page, mean, history(Chunks.of(view.folder), mean), view.scene, regions)


def checks_of(page: Page, mean: MeanFlow, found: History, scene: Scene, regions: Regions) -> None:
    """Add the chapters.

    Parameters
    ----------
    page : Page
        Grows.
    mean : MeanFlow
        The flow.
    found : History
        How it became that.
    scene : Scene
        Whose spheres stand before it.
    regions : Regions
        Of its vectors, rows from the lowest y up.
    """
    field = mean.field
    axis = jet_axis(field)
    if scene.bodies:
        rim_chapter(page, mean, scene, regions)
    page.heading("Streamlines and Reynolds stresses")
    speed = np.linalg.norm(mean.mean_m_s, axis=-1)
    page.figure("streamlines", streamlines_figure(mean, scene, speed), "Streamlines of the mean.", dense=True)
    stresses = mean.stresses_m2_s2
    turning = mean.rate(rates(field)["vorticity"][0])
    maps = [(f"{name} [{mean.unit_squared}]", stresses[..., k]) for k, name in enumerate(("u'u'", "v'v'", "u'v'"))]
    maps.append((f"vorticity of the mean [{mean.rate_unit}]", turning))
    said = "Reynolds stresses without the noise of the correlation, and the vorticity of the mean."
    page.figure("stresses", maps_figure(mean, scene, maps, mean.length), said, dense=True)
    _mass(page, mean, regions, axis, bool(scene.bodies))
    page.heading("Convergence")
    if len(found.pairs):
        said = (
            "Difference between the mean of the first n pairs and that of all, rms over the plane. Above the"
            " broken line successive pairs are alike."
        )
        page.figure("convergence", convergence_figure(found), said)
    said = "Displacements of all pairs by their fraction of a pixel; the broken line is an even spread."
    if np.isfinite(found.locking):
        said += f" Peak locking: {100 * found.locking:+.1f} % more than even within a quarter of whole pixels."
    page.figure("fractions", fractions_figure(found), said)


def profile_chapter(page: Page, mean: MeanFlow, regions: Regions, behind: bool) -> None:
    """Add profiles across the flow, at heights that are spread over what is seen, and the axis of a jet."""
    field = mean.field
    axis = jet_axis(field)
    known = np.isfinite(field.uv).all(axis=-1)
    rows = np.flatnonzero(known.mean(axis=1) > 0.2)
    if not rows.size:
        return
    page.heading("Profiles across the flow")
    chosen = np.unique(rows[(np.linspace(0.1, 0.9, LINES) * (len(rows) - 1)).astype(int)])
    glass = regions.region == Region.GLASS
    lines = []
    for row in chosen[::-1]:
        height = float(field.y[row])
        found = profile(field, (float(field.x[0]), height), (float(field.x[-1]), height))
        lines.append((f"y = {height:.1f} {mean.length}", found, glass[row]))
    said = "Heavy: behind glass; bands: 2 sigma of the mean." if behind else "Bands: 2 sigma of the mean."
    for component, name in ((1, "v, up"), (0, "u, to the right")):
        figure = profiles_figure(lines, component, f"mean {name} [{mean.unit}]")
        figure.axes[0].set_xlabel(f"x [{mean.length}]")
        page.figure(f"profiles_{'uv'[component]}", figure, f"Mean {name}, along lines of constant height. {said}")
    if axis is not None:
        lean = np.degrees(axis.angle_rad)
        page.text(
            f"The jet's axis passes ({axis.point[0]:.2f}, {axis.point[1]:.2f}) {mean.length} at {lean:.2f} degrees"
            " from x."
        )


def rim_chapter(page: Page, mean: MeanFlow, scene: Scene, regions: Regions) -> None:
    """Add steps of the mean between what is seen directly and what is seen through glass."""
    page.heading("Across the rim")
    field, scale = mean.field, mean.px_per_m_s
    outside, inside = regions.region == Region.DIRECT, regions.region == Region.GLASS
    reach = REACH_STEPS * mean.step_px / mean.px_per_mm
    rows: list[tuple[str, ...]] = []
    drawn = 0
    for centre in dict.fromkeys((round(s.centre_mm[0], 1), round(s.centre_mm[1], 1)) for s in scene.spheres):
        found = rim_steps(field, outside, inside, centre, reach)
        if not len(found.place):
            continue
        steps = RimStep(found.place, scale * found.step, scale * found.sigma)
        covered = float(np.mean(np.abs(steps.step) < steps.sigma))
        weight = steps.sigma**-2
        mid, rms = (weight * steps.step).sum(axis=0) / weight.sum(axis=0), np.sqrt(np.mean(steps.step**2, axis=0))
        rows.append(
            (
                f"{centre[0]:.1f}, {centre[1]:.1f}",
                str(len(steps.place)),
                f"{mid[0]:+.4f}, {mid[1]:+.4f}",
                f"{rms[0]:.4f}, {rms[1]:.4f}",
                f"{np.sqrt(np.mean(steps.sigma**2)):.4f}",
                f"{100 * covered:.0f} %",
            )
        )
        if not drawn:
            said = "Step of the mean displacement across the rim, piece by piece, with 1 sigma."
            page.figure("rim", steps_figure(steps, centre), said)
        drawn += 1
    if not rows:
        page.text(
            "Nowhere do vectors seen directly and through glass lie near enough to each other to tell a step: what"
            " is lost at the rim is wider than the reach of a fit."
        )
        return
    title = "A smooth surface through the vectors of both sides, and a step of the inner one"
    page.table(Table(title, STEP_COLUMNS, rows))


def _mass(page: Page, mean: MeanFlow, regions: Regions, axis: Axis | None, behind: bool) -> None:
    """Divergence of the mean against its own sigma, by region."""
    page.heading("Divergence")
    field = mean.field
    value, sigma = (mean.rate(part) for part in divergence(field, axis))
    rows, ratios = [], {}
    for part, where in parts_of(regions).items():
        name = part if behind else ALL  # without glass all is seen directly
        here = where & np.isfinite(value) & (sigma > 0.0)
        if not here.any():
            continue
        ratio = value[here] / sigma[here]
        ratios[name] = ratio
        inside = f"{100 * np.mean(np.abs(ratio) < 1.0):.0f} %"
        spread = [f"{np.sqrt(np.mean(each[here] ** 2)):.3g}" for each in (value, sigma)]
        rows.append((name, str(int(here.sum())), *spread, inside))
    if not rows:
        page.text("No place has vectors on all sides, so there is no divergence.")
        return
    how = "of a flow that is round about its axis" if axis is not None else "in the plane"
    unit = mean.rate_unit
    head = ("region", "vectors", f"divergence rms [{unit}]", f"its sigma rms [{unit}]", "within 1 sigma")
    page.table(Table(f"Divergence of the mean {how}, and its sigma (68 % within 1 sigma by chance)", head, rows))
    what = "a flow that is not round" if axis is not None else "a flow through the sheet"
    at_rim = ", a correction that is wrong at the rim shows there" if behind else ""
    said = f"Divergence over its sigma; {what} shows everywhere{at_rim}."
    page.figure("divergence", divergence_figure(ratios), said)
