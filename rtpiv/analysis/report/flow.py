"""The chapters of a mean flow that ask whether it can be true: across the rim, along lines, mass, convergence."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import MIDDLE, Region, Regions, regions_of
from correction.fitted.prepared import prepare
from correction.maps.corrector import Corrector
from piv.statistics.derived import Axis, PlaneField, divergence, jet_axis, profile, rim_steps, vorticity
from rtpiv.analysis.report.flow_figures import (
    convergence_figure,
    divergence_figure,
    fractions_figure,
    maps_figure,
    profiles_figure,
    steps_figure,
    streamlines_figure,
)
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.series.history import History, history
from rtpiv.analysis.series.image_field import image_field
from rtpiv.analysis.series.mean_flow import MeanFlow
from rtpiv.analysis.series.series_folder import Chunks
from rtpiv.analysis.series.series_mean import grid_of_series, scene_of, windows_of
from tracer.scene.scene import Scene

LINES = 4  # profiles across the flow
REACH_STEPS = 5.0  # from the rim, of vectors that tell a step
REGIONS_HEAD = ("region", "vectors", "divergence rms [1/s]", "its sigma rms [1/s]", "within 1 sigma")
STEPS_HEAD = (
    "rim around x, y [mm]",
    "pieces",
    "weighted mean u, v [px]",
    "rms u, v [px]",
    "sigma [px]",
    "within 1 sigma",
)

Floats = NDArray[np.float64]


def corrector_of_mean(folder: Path) -> Corrector:
    """How the frames of the series in a folder were corrected."""
    return prepare(scene_of(folder), maps=folder / "maps", grid=grid_of_series(folder)).corrector


def regions_of_mean(folder: Path, mean: MeanFlow, corrector: Corrector) -> Regions:
    """Regions of the vectors of a mean, rows from the lowest y up, by the map of the series in a folder."""
    known = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, windows_of(folder))
    seen = regions_of(known, corrector.map, scene_of(folder))
    return Regions(seen.region[::-1], seen.radius[::-1])


def flow_chapters(page: Page, folder: Path, mean: MeanFlow, regions: Regions) -> None:
    """Add the chapters of the mean of the series in a folder."""
    checks_of(page, mean, history(Chunks.of(folder), mean), scene_of(folder), regions)


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
    field = PlaneField(
        mean.x_mm, mean.y_mm, mean.mean_m_s, mean.local_sigma_m_s, 0.5 * mean.window_px / mean.px_per_mm
    )
    axis = jet_axis(field)
    _along_lines(page, field, regions, axis)
    rim_chapter(page, mean, scene, regions)
    page.heading("Where it flows")
    speed = np.linalg.norm(mean.mean_m_s, axis=-1)
    page.figure("streamlines", streamlines_figure(mean, scene, speed), "Streamlines of the mean.", dense=True)
    stresses = mean.stresses_m2_s2
    turning = 1e3 * vorticity(field)[0]
    maps = [(f"{name} [m²/s²]", stresses[..., k]) for k, name in enumerate(("u'u'", "v'v'", "u'v'"))]
    maps.append(("vorticity of the mean [1/s]", turning))
    said = "Reynolds stresses without the noise of the correlation, and the vorticity of the mean."
    page.figure("stresses", maps_figure(mean, scene, maps), said, dense=True)
    _mass(page, field, regions, axis)
    page.heading("Are these enough pairs?")
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


def _along_lines(page: Page, field: PlaneField, regions: Regions, axis: Axis | None) -> None:
    """Profiles across the flow, at heights that are spread over what is seen."""
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
        lines.append((f"y = {height:.1f} mm", found, glass[row]))
    said = "Heavy: behind glass; bands: 2 sigma of the mean."
    for component, name in ((1, "v, up"), (0, "u, to the right")):
        figure = profiles_figure(lines, component, f"mean {name} [m/s]")
        page.figure(f"profiles_{'uv'[component]}", figure, f"Mean {name}, along lines of constant height. {said}")
    if axis is not None:
        lean = np.degrees(axis.angle_rad)
        page.text(
            f"The jet's axis passes ({axis.point[0]:.2f}, {axis.point[1]:.2f}) mm at {lean:.2f} degrees from x."
        )


def rim_chapter(page: Page, mean: MeanFlow, scene: Scene, regions: Regions) -> None:
    """Add steps of the mean between what is seen directly and what is seen through glass."""
    page.heading("Across the rim")
    scale = mean.px_per_m_s
    in_px = PlaneField(mean.x_mm, mean.y_mm, scale * mean.mean_m_s, scale * mean.local_sigma_m_s, 0.0)
    outside, inside = regions.region == Region.DIRECT, regions.region == Region.GLASS
    reach = REACH_STEPS * mean.step_px / mean.px_per_mm
    rows: list[tuple[str, ...]] = []
    drawn = 0
    for centre in dict.fromkeys((round(s.centre_mm[0], 1), round(s.centre_mm[1], 1)) for s in scene.spheres):
        steps = rim_steps(in_px, outside, inside, centre, reach)
        if not len(steps.place):
            continue
        covered = float(np.mean(np.abs(steps.step) < steps.sigma))
        weight = steps.sigma**-2
        mid, rms = (weight * steps.step).sum(axis=0) / weight.sum(axis=0), np.sqrt(np.mean(steps.step**2, axis=0))
        rows.append((
            f"{centre[0]:.1f}, {centre[1]:.1f}", str(len(steps.place)), f"{mid[0]:+.4f}, {mid[1]:+.4f}",
            f"{rms[0]:.4f}, {rms[1]:.4f}", f"{np.sqrt(np.mean(steps.sigma**2)):.4f}", f"{100 * covered:.0f} %",
        ))  # fmt: skip
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
    page.table(STEPS_HEAD, rows, "A smooth surface through the vectors of both sides, and a step of the inner one")


def _mass(page: Page, field: PlaneField, regions: Regions, axis: Axis | None) -> None:
    """Divergence of the mean against its own sigma, by region."""
    page.heading("Is mass conserved?")
    value, sigma = (1e3 * part for part in divergence(field, axis))
    glass = regions.region == Region.GLASS
    wheres = {
        "seen directly": regions.region == Region.DIRECT,
        f"behind glass, r < {MIDDLE} R": regions.middle,
        f"behind glass, r > {MIDDLE} R": glass & ~regions.middle,
        "across a rim": regions.region == Region.RIM,
    }
    rows, ratios = [], {}
    for name, where in wheres.items():
        here = where & np.isfinite(value) & (sigma > 0.0)
        if not here.any():
            continue
        ratio = value[here] / sigma[here]
        ratios[name] = ratio
        inside = f"{100 * np.mean(np.abs(ratio) < 1.0):.0f} %"
        spread = [f"{np.sqrt(np.mean(part[here] ** 2)):.3g}" for part in (value, sigma)]
        rows.append((name, str(int(here.sum())), *spread, inside))
    if not rows:
        page.text("No place has vectors on all sides, so there is no divergence.")
        return
    how = "of a flow that is round about its axis" if axis is not None else "in the plane"
    page.table(REGIONS_HEAD, rows, f"Divergence of the mean {how}, and what its sigma expects (chance: 68 %)")
    said = (
        "Divergence over its sigma. A correction that is wrong at the rim shows there; a flow that is not round"
        " shows everywhere."
        if axis is not None
        else "Divergence over its sigma; a flow through the sheet shows everywhere, a wrong correction at the rim."
    )
    page.figure("divergence", divergence_figure(ratios), said)
