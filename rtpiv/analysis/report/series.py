"""The page of a series: what was done to its frames, one pair of it, and every pair that has no vectors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from daq.runs.acquired import full_scale
from daq.runs.run_views import length_unit, tells_a_scale_alone
from ground.printable import readable_name
from piv.correlation.common_light import LEAST_COMMON
from piv.correlation.vector_field import VectorField
from piv.preprocessing import preparation
from piv.preprocessing.preparation import RAW, Preparation
from rtpiv.analysis.fit_beside import SCENE_FILE
from rtpiv.analysis.pairs.evaluation import correlate_pair
from rtpiv.analysis.pairs.pair_vectors import per_px
from rtpiv.analysis.pictures.before_after import CORRECTED, PLAIN, BeforeAfter, before_after
from rtpiv.analysis.pictures.rasters import data_address, grey
from rtpiv.analysis.report.figures import vector_figure
from rtpiv.analysis.report.page import Page, behind_glass, through_lead
from rtpiv.analysis.report.pair import light_sheet_line, scene_chapter
from rtpiv.analysis.report.table import MAX_ROWS, Table
from rtpiv.analysis.report.tables import count_table, image_table, mask_swatches
from rtpiv.analysis.series.chunk import correction_of, windows_of
from rtpiv.analysis.series.clean_frames import clean_frames
from rtpiv.analysis.series.mean_flow import image_field
from rtpiv.analysis.series.run_series import Evaluated
from rtpiv.analysis.series.series_input import SeriesInput
from rtpiv.analysis.series.series_plan import ChunkJob
from rtpiv.analysis.series.still_frames import still_in
from tracer.scene.scene_file import load_scene

DARKEST, BRIGHTEST = 1.0, 99.7  # percentiles of a frame that are shown black and white


@dataclass(frozen=True)
class Preview:
    """A pair of a series.

    Parameters
    ----------
    tag : str
        Names it.
    dt_s : float or None
        Time between its frames, if it is known.
    seen : BeforeAfter
        Frame A as acquired, after each step, and the mask.
    steps : tuple of (str, str)
        What each step is called, and what it does.
    field : VectorField
        Its vectors.
    grid : PlaneGrid
        Scale of the corrected image.
    length : str
        Unit of lengths.
    files : (str, str)
        Names of its frames.
    """

    tag: str
    dt_s: float | None
    seen: BeforeAfter
    steps: tuple[tuple[str, str], ...]
    field: VectorField
    grid: PlaneGrid
    length: str = "mm"
    files: tuple[str, str] = ("", "")


def write_series_page(path: Path, given: SeriesInput, result: Evaluated, figures: bool = False) -> None:
    """Write the page of a series that was evaluated."""
    page = Page(
        f"{readable_name(given.run)}: a flow{behind_glass(given.method.scene)}",
        f"{result.pairs} pairs",
        twice=figures,
    )
    shown = choose_pair(given, result)
    if shown is not None:
        through_lead(page, shown.seen.through, given.method.scene, shown.seen.recovered)
        page.lead(*series_lead(shown))
    for warning in result.warnings:
        page.warning(warning)
    page.tiles(series_tiles(given, result, shown))
    series_chapters(page, given, result, shown)
    page.write(path)


def choose_pair(given: SeriesInput, result: Evaluated) -> Preview | None:
    """The pair nearest to the middle of the series that has vectors."""
    jobs = given.jobs(1)
    middle = len(jobs) // 2
    known = {one.task.name: one.field for one in result.details}
    for job in sorted(jobs, key=lambda job: abs(job.number - middle)):
        if (tag := job.pairs[0].tag) not in result.failed:
            return preview(job, known.get(tag) or _vectors_in_file(given, result, job))
    return None


def _vectors_in_file(given: SeriesInput, result: Evaluated, job: ChunkJob) -> VectorField | None:
    """Vectors of the pair of a job, in single precision, from their file; None if that leaves out a warning."""
    if result.series is None:
        return None
    chunk_pairs = result.series.about["chunk_pairs"]
    number, place = divmod(job.number, chunk_pairs)
    kept = result.series.chunk(number, result.series.about["keys"][number]).fields[place]
    if kept.static_share > LEAST_COMMON:  # it may have been taken off, which the file does not say
        return None
    beside = given.given.pairs[number * chunk_pairs : (number + 1) * chunk_pairs]
    dt_s = job.pairs[0].dt_s if all(pair.dt_s is not None for pair in beside) else None
    prepared = correction_of(job.maps, job.method)
    sigma_px = kept.sigma_m_s / per_px(prepared.corrector.map.grid.pitch_mm, dt_s)
    field = image_field(kept.displacement_px, sigma_px, 1.0, windows_of(prepared, job.method))
    return replace(field, flags=kept.flags[::-1], static_share=kept.static_share)


def preview(job: ChunkJob, field: VectorField | None = None) -> Preview | None:
    """Look at the one pair of a job, whose vectors may be known; None if its frames cannot be read any more."""
    method = job.method
    prepared = correction_of(job.maps, method)
    corrector = prepared.corrector
    (pair,), (a,), (b,) = job.pairs, clean_frames(job, 0), clean_frames(job, 1)
    bare = replace(job, method=replace(method, preparation=Preparation()), light=None)
    (raw,) = clean_frames(bare, 0)
    if isinstance(raw, str) or isinstance(a, str) or isinstance(b, str):
        return None
    both = corrector(a), corrector(b)
    field = (
        field or correlate_pair((a, b), both, prepared, method.settings, method.preparation, still_in(job)).field
    )
    corrected = both[0]
    seen = before_after(raw, corrected, corrector, method.scene, full_scale(pair.frames[0], raw))
    pictures: list[tuple[str, NDArray[Any]]] = [("as acquired", raw)]
    background = method.preparation.background
    if background is not None:
        pictures.append(("without background", a))
    if raw.shape != corrected.shape:
        pictures = []
    pictures.append((PLAIN if tells_a_scale_alone(method.scene) else CORRECTED, corrected))
    for name in method.preparation.steps:
        if name in preparation.CORRECTED:
            corrected = Preparation((name,)).apply(corrected, corrector.recovered)
            pictures.append((name, corrected))
    layers = [(name, data_address(grey(picture, _limits(picture)))) for name, picture in pictures]
    named = {**RAW, **preparation.CORRECTED}
    steps = tuple((name, named[name]) for name in method.preparation.steps)
    mask = [layer for layer in seen.layers if layer[0] == "mask"]
    layers_of = replace(seen, layers=(*layers, *mask))
    unit = length_unit(method.scene)
    files = pair.frames[0].name, pair.frames[1].name
    return Preview(pair.tag, pair.dt_s, layers_of, steps, field, corrector.map.grid, unit, files)


def _limits(frame: NDArray[Any]) -> tuple[float, float]:
    known = frame[np.isfinite(frame)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, (DARKEST, BRIGHTEST))
    return float(low), float(max(high, low + 1e-6))


def series_lead(shown: Preview) -> tuple[str, Table]:
    """Random uncertainty of a vector of one pair, u and v apart; that of the map stands with the mean."""
    field = shown.field
    both = [
        np.median(sigma[field.valid]) if field.valid.any() else np.nan
        for sigma in (field.sigma_u_px, field.sigma_v_px)
    ]
    scale, unit = per_px(shown.grid.pitch_mm, shown.dt_s), shown.length if shown.dt_s is None else "m/s"
    said = (
        f"random standard uncertainty u, v of one vector: median of {int(field.valid.sum())} of pair {shown.tag}"
    )
    rows = [(f"the same in {unit}", *(f"{scale * sigma:.4g}" for sigma in both))]
    return "{:.4f}, {:.4f} px".format(*both), Table(said, ("", "u", "v"), rows)


def series_tiles(given: SeriesInput, result: Evaluated, shown: Preview | None) -> list[tuple[str, str, str]]:
    """The figures that matter most: value, name, what it is measured against."""
    tiles = [(f"{result.pairs - len(result.failed)}", "pairs with vectors", f"of {result.pairs} pairs")]
    if given.given.is_timed:
        times_us = 1e6 * np.array([pair.dt_s for pair in given.given.pairs], np.float64)
        spread = f"{times_us.min():.4g} to {times_us.max():.4g} us"
        tiles.append((f"{np.median(times_us):.4g} us", "between the frames of a pair", spread))
    if shown is not None:
        counts, asked = shown.field.counts, int(shown.field.asked.sum())
        of_them = f"of {asked} {'that the glass shows' if given.method.scene.bodies else 'windows'}"
        tiles.append((f"{counts['valid']}", "valid vectors in one pair", of_them))
    return tiles


def series_chapters(page: Page, given: SeriesInput, result: Evaluated, shown: Preview | None) -> None:
    """Add what was done to the frames, one pair, the pairs left out, the scene and where all this comes from."""
    if shown is not None:
        pair_chapter(page, given, shown)
        frames_chapter(page, shown)
    _exclusions(page, given, result)
    scene_chapter(page, given.method.scene)
    light_sheet_line(page, replace(given.method.scene, sheet=load_scene(given.out / SCENE_FILE).sheet))
    _provenance(page, given)


def frames_chapter(page: Page, shown: Preview) -> None:
    """Frame A of a pair after every step."""
    page.heading("Frames, step by step")
    named = any(name == "mask" for name, _ in shown.seen.layers)
    colours = "; the colours of the mask, and their share of the nodes:" if named else "."
    page.slider(shown.seen.layers, f"Frame A of {shown.tag}, {shown.files[0]}. Drag to compare{colours}")
    if named:
        page.swatches(mask_swatches(shown.seen.shares))
    if shown.steps:
        page.table(Table("Preprocessing, in order", ("step", "effect"), shown.steps))
    else:
        page.text("No other preprocessing.")
    page.table(image_table(shown.seen.figures, shown.seen.full_scale))


def pair_chapter(page: Page, given: SeriesInput, shown: Preview) -> None:
    """The vectors of one pair."""
    field, grid = shown.field, shown.grid
    page.heading("One pair")
    if field.warning:
        page.warning(field.warning + ".")
    what, unit = ("displacement", shown.length) if shown.dt_s is None else ("speed", "m/s")
    scale = per_px(grid.pitch_mm, shown.dt_s)
    speed = np.hypot(field.u_px, field.v_px) * scale
    sigma = np.linalg.norm(field.total_sigma_px, axis=-1) * scale
    with page.row():
        figure = vector_figure(field, grid, given.method.scene, speed, f"{what} [{unit}]", scale=(scale, unit))
        page.figure("pair", figure, f"Pair {shown.tag}: vectors, their {what} in colour.", dense=True)
        if np.isfinite(sigma).any():
            figure = vector_figure(
                field, grid, given.method.scene, sigma, f"random sigma, and not resolved [{unit}]"
            )
            said = "Same vectors, coloured by what is uncertain in a single pair."
            page.figure("pair_sigma", figure, said, dense=True)
    facts = [] if shown.dt_s is None else [("time between the frames", f"{shown.dt_s * 1e6:.3f} us")]
    files = ("files of the pair", ", ".join(shown.files))
    page.facts([files, *facts, ("1 px of displacement is", f"{scale:.6g} {unit}")])
    page.table(count_table(field))


def _exclusions(page: Page, given: SeriesInput, result: Evaluated) -> None:
    page.heading("Excluded pairs")
    said = f"{result.pairs} pairs, {len(result.failed)} without vectors"
    page.text(f"{said}; {given.given.alone} frames of the run lost their partner and are in no pair.")
    if result.failed:
        page.table(exclusion_table(result.reasons, "the markers of the chunks"))


def exclusion_table(pairs: Sequence[tuple[str, str]], rest: str) -> Table:
    """Pairs that are left out, with their reasons; `rest` names the file of those that do not fit."""
    more = f"; {len(pairs) - MAX_ROWS} more are in {rest}" if len(pairs) > MAX_ROWS else ""
    return Table(f"Pairs that are left out{more}", ("pair", "reason"), pairs[:MAX_ROWS])


def _provenance(page: Page, given: SeriesInput) -> None:
    page.heading("Provenance")
    content, scene = given.method.content, given.method.scene
    of_scene = [] if tells_a_scale_alone(scene) else [("scene", scene.content_hash())]
    settings = ", ".join(f"{name} {value}" for name, value in content["settings"].items())
    page.facts(
        [("run", readable_name(given.run)), *of_scene, ("correlation", settings), ("rtpiv", version("rtpiv"))]
    )
