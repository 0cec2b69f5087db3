"""The page of a mean flow: the field, its uncertainty, its fluctuations, and every pair that is not in it.

One chapter asks the particles of the run that are seen twice whether the spheres stand where they were calibrated.
"""

from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import Region, Regions
from correction.self_check.moved_sphere import MOVE_FALSE_ALARMS, SelfCheck
from daq.runs.names import is_run
from daq.runs.run_folder import RunFolder
from daq.runs.run_views import tells_a_scale_alone
from rtpiv.analysis.digits import two_digits, with_sigma
from rtpiv.analysis.fit_beside import FIT_FILE
from rtpiv.analysis.gaps import gaps_of_scene
from rtpiv.analysis.report.calibration import calibration_chapter
from rtpiv.analysis.report.figures import vector_figure
from rtpiv.analysis.report.flow import flow_chapters, profile_chapter, regions_of_mean
from rtpiv.analysis.report.high_place import high_place
from rtpiv.analysis.report.page import Link, Page, behind_glass, through_lead
from rtpiv.analysis.report.pair import NO_SCALE_SIGMA, light_sheet_line, scene_chapter, slant_figure, slant_lines
from rtpiv.analysis.report.run import account_chapter, notes_chapter, readings_chapter
from rtpiv.analysis.report.series import choose_pair, exclusion_table, frames_chapter, pair_chapter
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.series.ensemble_series import EnsembleFlow
from rtpiv.analysis.series.mean_flow import MeanFlow, image_field
from rtpiv.analysis.series.run_series import Evaluated
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.analysis.steepness import Steepness
from rtpiv.analysis.through_glass import through_glass

NOT_KNOWN = {"timing error of dt": "not stated"}  # in the plan


def write_mean_page(
    path: Path,
    view: SeriesView,
    mean: MeanFlow,
    figures: bool = False,
    ensemble: EnsembleFlow | None = None,
    series: tuple[SeriesInput, Evaluated] | None = None,
    check: SelfCheck | None = None,
) -> None:
    """Write the page of a mean flow.

    Parameters
    ----------
    path : Path
        Of the page.
    view : SeriesView
        Of the series.
    mean : MeanFlow
        Its statistics.
    figures : bool
        Write every figure as SVG and as PNG.
    ensemble : EnsembleFlow, optional
        The same by ensemble correlation.
    series : (SeriesInput, Evaluated), optional
        What it was evaluated from, if that is at hand: frames and one pair are shown, and the run's frame account.
    check : SelfCheck, optional
        Whether the spheres stand where they were calibrated.
    """
    about, folder, scene = view.about, view.folder, view.scene
    page = Page(f"{about['run']}: mean flow{behind_glass(scene)}", f"{mean.used} pairs", twice=figures)
    for warning in mean.warnings:
        page.warning(warning + ".")
    corrector, regions = view.correction.corrector, regions_of_mean(view, mean)
    through = gaps_of_scene(scene) or through_glass(scene, corrector.map.grid, corrector.recovered)
    through_lead(page, through, scene, float(corrector.recovered.mean()))
    page.lead(*mean_lead(mean, regions, bool(scene.bodies)))
    _velocity_figures(page, view, mean)
    page.tiles(mean_tiles(mean))
    profile_chapter(page, mean, regions, bool(scene.bodies))
    mean_chapters(page, view, mean)
    if mean.slope is not None:
        behind, beside = regions.region == Region.GLASS, regions.region == Region.DIRECT
        steepness = Steepness.of(mean.slope, behind, beside)
        slant_lines(page, steepness, mean.out_of_plane.sentence)
        if steepness.behind is not None and mean.slant_sigma_m_s is not None:
            field = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, view.windows)
            sigma = np.linalg.norm(mean.slant_sigma_m_s, axis=-1)[::-1]
            slant_figure(page, field, view.grid, scene, sigma, mean.unit)
    if series is not None and (shown := choose_pair(*series)) is not None:
        frames_chapter(page, shown)
        pair_chapter(page, series[0], shown)
    flow_chapters(page, view, mean, regions)
    if ensemble is not None:
        ensemble_chapter(page, view, ensemble)
    exclusion_chapter(page, mean)
    if check is not None:
        show_self_check(page, check)
    if series is not None and is_run(series[0].run):  # external frames have no account
        account_chapter(page, RunFolder.open(series[0].run))
        notes_chapter(page, RunFolder.open(series[0].run))
        readings_chapter(page, RunFolder.open(series[0].run))
    scene_chapter(page, scene)
    light_sheet_line(page, view.standing)
    calibration_chapter(page, folder / FIT_FILE, scene)
    page.heading("Files")
    names = (
        "mean.nc",
        "mean_ensemble.nc",
        *(() if tells_a_scale_alone(scene) else ("scene.yaml",)),
        "series.json",
    )
    page.links([Link(name, name) for name in names if (folder / name).is_file()])
    page.heading("Provenance")
    content = about["content"]
    page.facts(
        [
            ("run", about["run"]),
            ("frames", ", ".join(content["preparation"]) or "as acquired"),
            ("correlation", ", ".join(f"{name} {value}" for name, value in content["settings"].items())),
            *([] if tells_a_scale_alone(scene) else [("scene", scene.content_hash())]),
            ("rtpiv", version("rtpiv")),
        ]
    )
    page.write(path)


def mean_lead(mean: MeanFlow, regions: Regions, behind_any: bool = True) -> tuple[str, Table]:
    """Return a high mean speed, behind glass if anything is, and the parts of its uncertainty, along itself.

    It is the speed that 1 % of the places exceed, of those with valid neighbours: the largest of all is often one
    vector at the border of the view.
    """
    known = (mean.count > 0) & np.isfinite(mean.total_sigma_m_s).all(axis=-1)
    behind = known & (regions.region == Region.GLASS)
    where, name = (behind, " behind glass") if behind.any() else (known, " seen directly" if behind_any else "")
    head = ("parts of its uncertainty", mean.unit, "px")
    if not where.any():
        return "-", Table(f"high mean speed{name}", head, [])
    speed = np.linalg.norm(mean.mean_m_s, axis=-1)
    top = high_place(speed, where)
    along = mean.mean_m_s[top] / max(float(speed[top]), 1e-300)

    def of_it(part: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(along * part[top]))

    unresolved = np.repeat(mean.resolution_m_s[..., None], 2, axis=-1)
    asked = (
        ("scatter of the pairs", mean.sigma_m_s),
        ("not resolved by the windows", unresolved),
        ("timing error of dt", mean.dt_sigma_m_s),
        ("correction map" if behind_any else "scale", mean.map_sigma_m_s),
        ("flow through the sheet", mean.slant_sigma_m_s),
    )
    rows: list[tuple[str, ...]] = []
    for what, part in (*asked, ("total", mean.total_sigma_m_s)):
        sizes = () if part is None else (of_it(part), of_it(part) * mean.px_per_m_s)
        numbers = [two_digits(size) for size in sizes if np.isfinite(size)] or [
            NOT_KNOWN.get(what, "not known"),
            "",
        ]
        rows.append((what, *numbers))
    there = " there" if name else ""
    said = f"mean speed{name} that 1 % of {int(where.sum())} places{there} exceed, and its standard uncertainty"
    return f"{with_sigma(float(speed[top]), of_it(mean.total_sigma_m_s))} {mean.unit}", Table(said, head, rows)


def mean_tiles(mean: MeanFlow) -> list[tuple[str, str, str]]:
    """The figures that matter next: value, name, what it is measured against."""
    known = mean.count > 0
    samples = mean.effective.samples[known]
    worth = f"{np.nanmedian(samples):.0f}" if np.isfinite(samples).any() else "-"
    return [
        (f"{mean.used}", "pairs in the mean", f"{len(mean.left_out)} are left out"),
        (f"{int(known.sum())}", "places with a mean", f"of {known.size}"),
        (worth, "effective samples, median of all places", mean.effective.way),
    ]


def _velocity_figures(page: Page, view: SeriesView, mean: MeanFlow) -> None:
    """The mean and its total uncertainty, side by side."""
    scene, grid = view.scene, view.grid
    field = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, view.windows)
    speed = np.linalg.norm(mean.mean_m_s, axis=-1)[::-1]
    sigma = np.linalg.norm(mean.total_sigma_m_s, axis=-1)[::-1]
    scale = 1.0 / mean.px_per_m_s, mean.unit
    with page.row():
        said = "Mean velocity; its magnitude in colour."
        page.figure(
            "mean",
            vector_figure(field, grid, scene, speed, f"mean speed [{mean.unit}]", scale=scale),
            said,
            dense=True,
        )
        said = f"Total standard uncertainty of the mean behind it; effective samples by {mean.effective.way}."
        figure = vector_figure(field, grid, scene, sigma, f"total sigma of the mean [{mean.unit}]", scale=scale)
        page.figure("mean_sigma", figure, said, dense=True)


def mean_chapters(page: Page, view: SeriesView, mean: MeanFlow) -> None:
    """Add what the uncertainty of the mean leaves out, and the fluctuations."""
    scene, grid = view.scene, view.grid
    field = image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, view.windows)
    if doubt := mean.effective.warning(mean.used):
        page.text(doubt[0].upper() + doubt[1:] + ".")
    if np.isnan(mean.dt_sigma_share):
        page.text("Timing error of dt: not stated (dt_sigma_us in the plan).")
    if mean.no_map_sigma:
        what = "The uncertainty of the correction map is not known"
        page.text(f"{what if scene.bodies else NO_SCALE_SIGMA}: {mean.no_map_sigma}.")
    page.heading("Fluctuations")
    energy = np.maximum(mean.stresses_m2_s2[..., :2].sum(axis=-1), 0.0)[::-1]
    page.figure(
        "fluctuation",
        vector_figure(field, grid, scene, np.sqrt(energy), f"sqrt(R_uu + R_vv) [{mean.unit}]"),
        "Fluctuating velocity without the noise of the correlation; mean.nc has every stress with and without it.",
        dense=True,
    )


def ensemble_chapter(page: Page, view: SeriesView, flow: EnsembleFlow) -> None:
    """The mean by ensemble correlation."""
    page.heading("Ensemble correlation")
    page.text(
        f"Correlation planes of {flow.pairs} pairs added up, windows of {flow.windows.size_px} px: for rims, "
        "walls and thin seeding, where a window of one pair sees too few particles. Stresses: mean_ensemble.nc."
    )
    field = image_field(flow.mean_m_s, flow.sigma_m_s, flow.px_per_m_s, flow.windows)
    speed = np.linalg.norm(flow.mean_m_s, axis=-1)[::-1]
    figure = vector_figure(
        field, view.grid, view.scene, speed, f"mean speed [{'m/s' if flow.is_timed else flow.length}]"
    )
    page.figure("mean_ensemble", figure, "Mean velocity by ensemble correlation.", dense=True)


def exclusion_chapter(page: Page, mean: MeanFlow) -> None:
    """Every pair that is not in the mean, and why."""
    page.heading("Excluded pairs")
    page.text(f"{mean.used} pairs are in the mean, {len(mean.left_out)} are not.")
    if mean.gaps:
        page.text(mean.gaps.capitalize() + ".")
    if mean.left_out:
        page.table(exclusion_table(mean.left_out, "mean.nc"))


def show_self_check(page: Page, found: SelfCheck) -> None:
    """Show what was found."""
    page.heading("Check of the sphere positions")
    if found.likely_moves:
        page.warning(found.sentence + ".")
    else:
        page.text(found.sentence + ".")
    rows = [
        (
            one.name,
            ", ".join(f"{1e3 * mm:+.0f}" for mm in one.move_mm) if one.is_told else "not determined",
            ", ".join(f"{1e3 * mm:.0f}" for mm in one.sigma_mm),
            f"{one.probability:.1g}",
            f"{one.explains:.0f}",
        )
        for one in found.moves
    ]
    if rows:
        said = (
            "Each sphere by itself as the one that moved; the one that explains most of what is apart is named."
            f" Spheres that stand still raise an alarm in fewer than {MOVE_FALSE_ALARMS:g} of all checks"
        )
        page.table(Table(said, ("sphere", "move x, y, z [um]", "sigma [um]", "by chance", "explains"), rows))
