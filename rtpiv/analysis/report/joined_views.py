"""The page of several views: what any camera sees, and the velocity through the sheet."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rtpiv.analysis.digits import two_digits
from rtpiv.analysis.report.figures import vector_figure
from rtpiv.analysis.report.flow import maps_figure
from rtpiv.analysis.report.page import Link, Page
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.series.joined_views import JoinedViews
from rtpiv.analysis.series.mean_flow import image_field
from rtpiv.analysis.series.series_folder import MEAN
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.analysis.through_glass import percent


def write_views_page(path: Path, series: Sequence[SeriesView], joined: JoinedViews) -> None:
    """Write the page of joined views.

    Parameters
    ----------
    path : Path
        Of the page.
    series : sequence of SeriesView
        The views.
    joined : JoinedViews
        Their field.
    """
    runs, first = [each.about["run"] for each in series], series[0]
    page = Page(f"{len(runs)} views of one flow", ", ".join(runs))
    if joined.warning:
        page.warning(joined.warning[0].upper() + joined.warning[1:] + ".")
    page.tiles(_tiles(joined))
    speed = np.linalg.norm(joined.uvw_m_s[..., :2], axis=-1)
    field = image_field(joined.uvw_m_s[..., :2], joined.sigma_m_s[..., :2], joined.px_per_m_s, first.windows)
    unit = joined.unit
    with page.row():
        drawn = vector_figure(field, first.grid, first.scene, speed[::-1], f"mean speed in the plane [{unit}]")
        page.figure("mean", drawn, "Mean velocity in the plane, from all views.", dense=True)
        if np.isfinite(joined.uvw_m_s[..., 2]).any():
            w = maps_figure(joined, first.scene, [(f"w [{unit}]", joined.uvw_m_s[..., 2])])
            page.figure(
                "mean_w", w, "Mean velocity through the sheet, towards the cameras; grey: not known.", dense=True
            )
    with page.row():
        views = maps_figure(joined, first.scene, [("views", joined.views.astype(np.float64))])
        page.figure("views", views, "Number of views that have a mean.", dense=True)
        sigma = vector_figure(
            field,
            first.grid,
            first.scene,
            np.linalg.norm(joined.total_sigma_m_s[..., :2], axis=-1)[::-1],
            f"sigma of u, v [{unit}]",
        )
        page.figure("sigma", sigma, "All that is known of the uncertainty of u and v.", dense=True)
    page.table(_table(series, joined))
    for line in joined.sentences:
        page.text(line[0].upper() + line[1:] + ".")
    page.heading("Files")
    page.links([Link(MEAN, MEAN)])
    page.write(path)


def _tiles(joined: JoinedViews) -> list[tuple[str, str, str]]:
    tiles = []
    if joined.shares:
        tiles.append(
            (percent(joined.shares[-1]), "recovered by all views", f"by the first {percent(joined.shares[0])}")
        )
    known = np.isfinite(joined.uvw_m_s[..., 2])
    tiles.append((str(int(known.sum())), "places with w", f"of {known.size}"))
    for k, name in ((0, "u"), (2, "w")):
        sizes = joined.total_sigma_m_s[..., k][np.isfinite(joined.total_sigma_m_s[..., k])]
        if sizes.size:
            median = float(np.median(sizes))
            in_px = f"{two_digits(median * joined.px_per_m_s)} px"
            tiles.append((f"{two_digits(median)} {joined.unit}", f"sigma of {name}, median", in_px))
    return tiles


def _table(series: Sequence[SeriesView], joined: JoinedViews) -> Table:
    rows = []
    alone = joined.residuals[1:]
    for number, view in enumerate(series):
        x, y, z = view.scene.camera.position_mm
        seen = int((joined.seen_by >> number & 1).sum())
        share = percent(joined.shares[number]) if joined.shares else "-"
        without = two_digits(alone[number]) if alone else "-"
        rows.append((str(number + 1), view.about["run"], f"{x:.0f}, {y:.0f}, {z:.0f}", str(seen), share, without))
    head = ("view", "run", "camera at [mm]", "places", "recovered", "residual without it [sigma]")
    return Table("The views; recovered is the share of what the glass hides from the first", head, rows)
