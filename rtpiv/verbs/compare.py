"""`rtpiv compare`: compare lenses, distances and balls before a bench is built."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from daq.atomic_write import write_text
from daq.errors import RunUsageError
from ground.terminal import console
from piv.statistics.three_components import MAX_SIGMA_W_PX
from rtpiv.analysis.pictures.drawing_process import drawing
from rtpiv.analysis.report.table import Table as ReportTable
from rtpiv.analysis.through_glass import percent
from rtpiv.analysis.views.candidates import ViewQuestion, candidates_of
from rtpiv.analysis.views.figures import ViewFigures
from rtpiv.analysis.views.two_cameras import RUN_PAIRS, at_degrees, best_places
from rtpiv.options.numbers import Positive
from rtpiv.templates.files import scene_of, scene_text
from rtpiv.verbs.paths import Named
from rtpiv.verbs.results import results_in
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene

SHOWN_VIEWS = 15  # rows of the table
SHOWN_PAIRS = 5  # of places of two cameras
WRITTEN = 50  # scene files
SAID = 3  # reasons why something cannot be


@dataclass(frozen=True)
class Compared:
    """Comparison of arrangements.

    Parameters
    ----------
    views : list of ViewFigures
        All that can be built, best first.
    best : list of ViewFigures
        The Pareto front.
    scenes : tuple of Path
        A scene file of each of `best`, in the same order; of the first 50.
    picture : Path or None
        The figure.
    """

    views: list[ViewFigures] = field(repr=False)
    best: list[ViewFigures]
    scenes: tuple[Path, ...] = field(repr=False)
    picture: Path | None


def compare(
    question: ViewQuestion,
    out: Named | None = None,
    f_number: Positive = 22.0,
    error_px: Positive = 0.1,
    pictures: bool = True,
    cameras: Literal[1, 2] = 1,
) -> Compared:
    """Compute the view of every combination; print the Pareto front, and write its scene files.

    Parameters
    ----------
    question : ViewQuestion
        The camera, and the available lenses, distances and balls.
    out : path, optional
        Folder, default ``compare`` (or ``compare-2`` ...), for ``compare.csv`` (all figures of all arrangements),
        ``compare.png`` and ``scenes``.
    f_number : float
        f-number of the lens, for light, blur and depth of field.
    error_px : float
        Largest acceptable noise of a displacement [corrected px].
    pictures : bool
        Draw ``compare.png``.
    cameras : {1, 2}
        Number of cameras; for two also search the best pair of places on an arc about the y axis, by the first
        arrangement of the front, and write their scenes ``scenes/pair-1.yaml``, ``scenes/pair-2.yaml``.

    Returns
    -------
    Compared
        The figures.

    Raises
    ------
    RunUsageError
        More combinations than 5000, or none that can be built.
    DiskError
        The folder cannot hold results.
    """
    screen = console()
    with results_in(out, "compare") as out:
        labs, refused = question.labs()
        found = candidates_of(labs, f_number, error_px, SHOWN_VIEWS)
        views, best = found.views, found.best
        refused += found.refused
        if not views:
            raise RunUsageError("; ".join(refused[:SAID]) or "no arrangement has such a number of balls")
        if best:
            screen.print(_table(best, error_px, f_number, len(views)))
            screen.print(LEGEND)
            screen.print(_unsaid(best))
        else:
            screen.print(
                f"none of {len(views)} arrangements shows anything behind glass with noise below {error_px:g} px;"
                " see compare.csv, and ask for a larger --error-px, a larger --f-number or other distances"
            )
        for reason in refused[:SAID]:
            screen.print(f"left out: {reason}", soft_wrap=True)
        if len(refused) > SAID:
            screen.print(f"left out for {len(refused) - SAID} more reasons of this kind")
        (out / "scenes").mkdir(exist_ok=True)
        write_text(out / "compare.csv", _csv(views))
        scenes = []
        for number, view in enumerate(best[:WRITTEN], start=1):
            scenes.append(out / "scenes" / f"{number:02d}.yaml")
            write_text(scenes[-1], scene_text(replace(view.lab, name=f"view{number:02d}")))
        if cameras > 1 and best:
            _search_places(screen, scene_of(best[0].lab), out / "scenes")
        picture = None
        if pictures and best:
            picture = out / "compare.png"
            with drawing() as draw:
                draw("rtpiv.analysis.pictures.results:draw_views", picture, views, best, error_px)
        screen.print(f"compare.csv{', compare.png' if picture else ''} and {len(scenes)} scene files are in {out}")
        return Compared(views, best, tuple(scenes), picture)


def _search_places(screen: Console, scene: Scene, folder: Path) -> None:
    """Print the best pairs of places of two cameras, and write the scenes of the first."""
    found = best_places(scene)
    rows = [
        (f"{one:+d}, {two:+d}", percent(pair.union), percent(pair.with_w), f"{pair.sigma_w_px:.3f}",
         f"{max(pair.least_um.values(), default=math.nan):.0f}")
        for pair in found[:SHOWN_PAIRS] for one, two in [pair.degrees]
    ]  # fmt: skip
    title = f"two cameras, arrangement 1 (w to {MAX_SIGMA_W_PX:g} px a pair, knock within {RUN_PAIRS} pairs)"
    columns = ("degrees about y", "recovered", "with w", "sigma of w [px]", "smallest knock [um]")
    screen.print(ReportTable(title, columns, rows))
    for number, degrees in enumerate(found[0].degrees, start=1):
        write_text(folder / f"pair-{number}.yaml", dump_scene(at_degrees(scene, degrees)))


def _table(best: Sequence[ViewFigures], error_px: float, f_number: float, count: int) -> Table:
    brightest = max((view.light for view in best), default=1.0)
    more = f"; the first {SHOWN_VIEWS} of {len(best)} on the Pareto front" if len(best) > SHOWN_VIEWS else ""
    title = f"{count} arrangements, f/{f_number:g}, wanted {error_px:g} px{more}"
    table = Table(title=title, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    for name in (
        "",
        "balls",
        "f, L",
        "usable\n%",
        "FOV_in\n%",
        "noise\npx",
        "sigma\npx",
        "10 um\npx",
        "blur\npx",
        "depth\nmm",
        "light",
    ):
        table.add_column(name, justify="left" if name == "balls" else "right", no_wrap=True)
    for number, view in enumerate(best[:SHOWN_VIEWS], start=1):
        lab = view.lab
        shape = "" if lab.arrangement == "behind" else f" {lab.arrangement}"
        gap = f" +{lab.gap_mm:g}" if lab.gap_mm else ""
        table.add_row(
            str(number),
            f"{lab.balls} x {lab.ball_mm:g} {lab.glass}{shape}{gap}",
            f"{lab.lens_mm:g}, {lab.distance_mm:g}",
            f"{100.0 * view.usable:.0f}",
            "-" if view.inside is None else f"{100.0 * view.inside:.1f}",
            f"{view.noise_px:.3f}",
            f"{view.sigma_px:.4f}",
            f"{view.sensitivity_px:.2f}",
            f"{view.blur_px:.1f}",
            f"{view.depth_mm:.0f}",
            f"{math.log2(view.light / brightest):.1f}",
        )
    return table


def _unsaid(best: Sequence[ViewFigures]) -> str:
    """Return the uncertainty that an unspecified light source adds."""
    worst = [view.unsaid_px for view in best[:SHOWN_VIEWS]]
    return (
        f"sigma requires fit.light, the light of the target frames; without it sigma is"
        f" {min(worst):.2f} to {max(worst):.2f} px"
    )


LEGEND = (
    "balls: number x diameter, +gap to the plane [mm]; usable: of what the balls hide, with less noise than"
    " wanted; noise: of a displacement behind glass; sigma: of the map after a fit to a target run; 10 um: what it"
    " moves the picture if a ball is off by so much; blur: width of a particle's picture by the aperture; depth:"
    " of field; light: of a particle's picture, in stops below the brightest"
)


def _csv(views: Sequence[ViewFigures]) -> str:
    """Return all figures of all arrangements, a row each."""
    stream = io.StringIO()
    rows = [_flat(view) for view in views]
    writer = csv.DictWriter(stream, rows[0])
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _flat(view: ViewFigures) -> dict[str, str | int | float]:
    figures = asdict(view)
    lab = figures.pop("lab")
    width, height = lab.pop("sensor_px")
    lab.pop("name")
    said = {"width_px": width, "height_px": height, **lab, **figures}
    return {
        key: "" if value is None else f"{value:.6g}" if isinstance(value, float) else value
        for key, value in said.items()
    }
