"""The page of a mean flow: the field, how sure it is, its fluctuations, and every pair that is not in it."""

from importlib.metadata import version
from pathlib import Path

import numpy as np

from daq.acquisition.runs.run_folder import RunFolder
from daq.analysis.report.figures import vector_figure
from daq.analysis.report.flow import flow_chapters
from daq.analysis.report.page import Page
from daq.analysis.report.pair import scene_chapter
from daq.analysis.report.run import books_chapter
from daq.analysis.report.series import frames_chapter, pair_chapter, shown_pair
from daq.analysis.series.ensemble_series import EnsembleFlow
from daq.analysis.series.image_field import image_field
from daq.analysis.series.mean_flow import MeanFlow
from daq.analysis.series.run_series import SeriesBooks
from daq.analysis.series.series_folder import SeriesFolder
from daq.analysis.series.series_input import SeriesInput
from daq.analysis.series.series_mean import grid_of_series, scene_of, windows_of

SHOWN_PAIRS = 60


def write_mean_page(
    path: Path,
    folder: Path,
    mean: MeanFlow,
    figures: bool = False,
    ensemble: EnsembleFlow | None = None,
    series: tuple[SeriesInput, SeriesBooks] | None = None,
) -> None:
    """Write the page of a mean flow.

    Parameters
    ----------
    path : Path
        Of the page.
    folder : Path
        Of the series.
    mean : MeanFlow
        Its statistics.
    figures : bool
        Write every figure as SVG and as PNG.
    ensemble : EnsembleFlow, optional
        The same by ensemble correlation.
    series : (SeriesInput, SeriesBooks), optional
        What it was evaluated from, if that is at hand: frames and one pair are shown, and the run's books.
    """
    about = SeriesFolder(folder).about
    page = Page(f"{about['run']}: mean flow through glass", f"{mean.used} pairs", twice=figures)
    if mean.doubt:
        page.warning(mean.doubt + ".")
    page.tiles(mean_tiles(mean))
    if series is not None and (shown := shown_pair(*series)) is not None:
        frames_chapter(page, shown)
        pair_chapter(page, series[0], shown)
    mean_chapters(page, folder, mean)
    flow_chapters(page, folder, mean)
    if ensemble is not None:
        ensemble_chapter(page, folder, ensemble)
    left_out_chapter(page, mean)
    if series is not None:
        books_chapter(page, RunFolder.open(series[0].run))
    scene_chapter(page, scene_of(folder))
    page.heading("Provenance")
    content = about["content"]
    page.facts([
        ("run", about["run"]), ("frames", ", ".join(content["preparation"]) or "as acquired"),
        ("correlation", ", ".join(f"{name} {value}" for name, value in content["settings"].items())),
        ("scene", scene_of(folder).content_hash()), ("rtpiv", version("rtpiv")),
    ])  # fmt: skip
    page.write(path)


def mean_tiles(mean: MeanFlow) -> list[tuple[str, str, str]]:
    """The figures that matter most: value, name, what it is measured against."""
    known = mean.count > 0
    sigma_px = float(np.nanmedian(mean.sigma_m_s[known])) * mean.px_per_m_s if known.any() else float("nan")
    speed = np.linalg.norm(mean.mean_m_s[known], axis=-1)
    worth = float(np.nanmedian(mean.effective.samples[known])) if known.any() else float("nan")
    tiles = [
        (f"{mean.used}", "pairs in the mean", f"{len(mean.left_out)} are left out"),
        (f"{speed.max():.4g} m/s", "highest mean speed", f"{int(known.sum())} places"),
        (f"{sigma_px:.4f} px", "random sigma of the mean", "median over the plane, one component"),
        (f"{worth:.0f}", "effective samples", mean.effective.way),
    ]
    if known.any() and np.isfinite(mean.resolution_m_s[known]).any():
        missed_px = float(np.nanmedian(mean.resolution_m_s[known])) * mean.px_per_m_s
        tiles.append((f"{missed_px:.4f} px", "not resolved by the windows", "of the mean; the same in every pair"))
    if np.isfinite(mean.dt_sigma_share):
        tiles.append((f"{100.0 * mean.dt_sigma_share:.2g} %", "sigma of dt", "one factor for all vectors"))
    if mean.map_sigma_m_s is not None:
        map_px = float(np.nanmedian(mean.map_sigma_m_s)) * mean.px_per_m_s
        tiles.append((f"{map_px:.4f} px", "sigma by the fitted map", "the same in every pair"))
    return tiles


def mean_chapters(page: Page, folder: Path, mean: MeanFlow) -> None:
    """Add the mean, its uncertainty and the fluctuations."""
    scene = scene_of(folder)
    grid, field = (
        grid_of_series(folder),
        image_field(mean.mean_m_s, mean.sigma_m_s, mean.px_per_m_s, windows_of(folder)),
    )
    page.heading("Mean velocity")
    speed = np.linalg.norm(mean.mean_m_s, axis=-1)[::-1]
    said = "Every second vector of the mean, its speed in colour."
    page.figure("mean", vector_figure(field, grid, scene, speed, "mean speed [m/s]"), said, dense=True)
    sigma = np.linalg.norm(mean.sigma_m_s, axis=-1)[::-1]
    said = f"Random standard uncertainty of the mean behind it; effective samples by {mean.effective.way}."
    page.figure(
        "mean_sigma", vector_figure(field, grid, scene, sigma, "sigma of the mean [m/s]"), said, dense=True
    )
    if not mean.effective.converged:
        page.warning("The series is too short for its slowest motion: the sigma of the mean is a lower limit.")
    if np.isnan(mean.dt_sigma_share):
        page.text("What dt is unsure of is not known: nobody measured it (dt_sigma_us in the plan).")
    if mean.no_map_sigma:
        page.text(f"What the map itself is unsure of is not known: {mean.no_map_sigma}.")
    page.heading("Fluctuations")
    energy = np.maximum(mean.stresses_m2_s2[..., :2].sum(axis=-1), 0.0)[::-1]
    page.figure(
        "fluctuation",
        vector_figure(field, grid, scene, np.sqrt(energy), "sqrt(R_uu + R_vv) [m/s]"),
        "Fluctuating velocity without the noise of the correlation; mean.nc has every stress with and without it.",
        dense=True,
    )


def ensemble_chapter(page: Page, folder: Path, flow: EnsembleFlow) -> None:
    """The mean by ensemble correlation."""
    page.heading("By ensemble correlation")
    page.text(
        f"Correlation planes of {flow.pairs} pairs added up, windows of {flow.windows.size_px} px: for rims, "
        "walls and thin seeding, where a window of one pair sees too few particles. Stresses: mean_ensemble.nc."
    )
    field = image_field(flow.mean_m_s, flow.sigma_m_s, flow.px_per_m_s, flow.windows)
    speed = np.linalg.norm(flow.mean_m_s, axis=-1)[::-1]
    figure = vector_figure(field, grid_of_series(folder), scene_of(folder), speed, "mean speed [m/s]")
    page.figure("mean_ensemble", figure, "Mean velocity by ensemble correlation.", dense=True)


def left_out_chapter(page: Page, mean: MeanFlow) -> None:
    """Every pair that is not in the mean, and why."""
    page.heading("Every pair accounted for")
    page.text(f"{mean.used} pairs are in the mean, {len(mean.left_out)} are not.")
    if mean.left_out:
        unseen = len(mean.left_out) - SHOWN_PAIRS
        more = f"; {unseen} more are in mean.nc" if unseen > 0 else ""
        page.table(("pair", "why"), mean.left_out[:SHOWN_PAIRS], f"Pairs that are left out{more}")
