"""The chapters of one evaluated pair: pictures, vectors, errors, uncertainty, images."""

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import Region, shift_errors
from correction.grid import PlaneGrid
from daq.runs.run_views import length_unit, tells_a_scale_alone, where_lit
from piv.correlation.vector_field import VectorField
from rtpiv.analysis.digits import with_sigma
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pairs.pair_vectors import per_px
from rtpiv.analysis.pictures.before_after import CORRECTED, PLAIN, BeforeAfter
from rtpiv.analysis.pictures.drawing import CAPTION, scene_figure
from rtpiv.analysis.pictures.traced import CAPTION as BLUR_CAPTION
from rtpiv.analysis.pictures.traced import blur_figure, blur_of
from rtpiv.analysis.report import tables
from rtpiv.analysis.report.figures import (
    colour_limit,
    error_histogram,
    grey_histogram,
    radius_figure,
    track_figure,
    vector_figure,
)
from rtpiv.analysis.report.high_place import high_place
from rtpiv.analysis.report.page import Drawn, Page, render_figure, through_lead
from rtpiv.analysis.report.sigma_verdict import sigma_verdict
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.report.tables import (
    Total,
    coverage_of,
    is_plain,
    lead_of,
    mask_swatches,
    offset_said,
    region_masks,
    totals_of,
)
from rtpiv.analysis.steepness import Steepness
from tracer.scene.scene import Scene

NO_SCALE_SIGMA = "The uncertainty of the image scale is not included"
PLAIN_CAPTION = "To scale; thick line: the plane."
_drawn: list[tuple[Scene, bool, Drawn]] = []  # the scene drawn last, and whether both kinds are made


def pair_summary(page: Page, evaluation: Evaluation) -> None:
    """Begin a page: what is seen through glass, how well it is measured there, and the pictures of it.

    All figures are of the vectors behind glass; of those seen directly where there are none behind it.
    """
    seen, field = _frame_of(evaluation), evaluation.field
    through_lead(page, seen.through, evaluation.task.scene, seen.recovered)
    if field.warning:
        page.warning(field.warning + ".")
    for warning in evaluation.scale_warnings:
        page.warning(warning)
    if totals := totals_of(evaluation):
        if evaluation.shift is None:
            page.lead(*speed_lead(evaluation, totals[0]))
        page.lead(*lead_of(totals[0]))
        if said := offset_said(evaluation):
            page.text(said)
        page.tiles(_region_tiles(evaluation, totals[0]))
    with page.row():
        _vector_figure(page, evaluation)
        used = PLAIN if PLAIN in seen.figures else CORRECTED
        page.slider(seen.layers, f"Frame A, as acquired and {used}. Drag to compare.")
    if any(name == "mask" for name, _ in seen.layers):
        page.swatches(mask_swatches(seen.shares))


def speed_lead(evaluation: Evaluation, total: Total) -> tuple[str, Table]:
    """Return a high speed of a region, or displacement where the time between the frames is not known.

    It is exceeded by 1 % of the vectors, with its standard uncertainty along itself.
    """
    field, (factor, unit) = evaluation.field, _scale_of(evaluation)
    uv = np.stack((field.u_px, -field.v_px), axis=-1) * factor
    speed, sigma = np.hypot(uv[..., 0], uv[..., 1]), evaluation.total_sigma_px * factor
    known = total.where(evaluation) & np.isfinite(sigma).all(axis=-1)
    what = "displacement" if evaluation.task.dt_s is None else "speed"
    said = f"{what}{total.where_said} that 1 % of {int(known.sum())} vectors exceed, and its standard uncertainty"
    if not known.any():
        return "-", Table(f"{what}{total.where_said}", (), [])
    top = high_place(speed, known)
    along = float(np.linalg.norm(uv[top] / max(float(speed[top]), 1e-300) * sigma[top]))
    quantiles = np.quantile(speed[known], (0.5, 0.9))
    rows = [(name, f"{value:.3g}") for name, value in zip(("median", "90 % are below"), quantiles, strict=True)]
    return f"{with_sigma(float(speed[top]), along)} {unit}", Table(said, (f"{what} [{unit}]", ""), rows)


def _scale_of(evaluation: Evaluation) -> tuple[float, str]:
    """Value of 1 px, and its unit: a velocity, or a length where the time is not known."""
    dt_s = evaluation.task.dt_s
    return per_px(evaluation.grid.pitch_mm, dt_s), length_unit(evaluation.task.scene) if dt_s is None else "m/s"


def _region_tiles(evaluation: Evaluation, total: Total) -> list[tuple[str, str, str]]:
    """Figures of the vectors of the region that the page is about: value, name, what it is measured against."""
    where = total.where(evaluation)
    asked = total.nodes(evaluation)
    tiles = [
        (
            str(total.count),
            f"valid vectors{total.where_said}",
            f"of {asked} nodes{'' if total.is_plain else ' there'}",
        )
    ]
    found = coverage_of(evaluation, where)
    if found is not None:
        inside = "{:.0f}, {:.0f} %".format(*(100 * share for share in found.within_1))
        tiles.append(
            (
                inside,
                "of their errors u, v within 1 total sigma, after removing the common offset",
                f"68 % claimed: {sigma_verdict(evaluation)}",
            )
        )
        tiles.append(
            ("{:.2f}, {:.2f}".format(*found.ratio), "rms of error u, v over sigma", "1 if sigma is right")
        )
    return tiles


def _frame_of(evaluation: Evaluation) -> BeforeAfter:
    """Return frame A, which every page needs."""
    assert evaluation.seen is not None
    return evaluation.seen


def slider_chapter(page: Page, seen: BeforeAfter, what: str) -> None:
    """Acquired | corrected | mask, and what the mask says."""
    page.heading("Acquired, corrected, recovered")
    page.slider(seen.layers, f"{what} Drag to compare; the colours of the mask, and their share of the nodes:")
    page.swatches(mask_swatches(seen.shares))


def pair_chapters(page: Page, evaluation: Evaluation) -> None:
    """Add the chapters of a pair."""
    if evaluation.task.note:
        page.text(evaluation.task.note)
    _vectors(page, evaluation)
    if evaluation.shift is not None:
        _errors(page, evaluation)
    _uncertainty(page, evaluation)
    if evaluation.tracks is not None or evaluation.no_tracks:
        _tracks(page, evaluation)
    _images(page, evaluation)
    scene_chapter(page, evaluation.task.scene)


def scene_chapter(page: Page, scene: Scene) -> None:
    """Add the scene; nothing for frames with a scale alone."""
    if tells_a_scale_alone(scene):
        return
    page.heading("Scene")
    page.figure("scene", draw_scene_of_page(scene, page.twice), CAPTION if scene.bodies else PLAIN_CAPTION)
    rows = [
        (
            s.name,
            ", ".join(f"{c:.4f}" for c in s.centre_mm),
            f"{s.radius_mm:.4f}",
            "opaque"
            if s.medium is None
            else ", ".join(
                [f"{s.medium.n(scene.wavelength_nm):.5f}"]
                + [f"{c.medium.n(scene.wavelength_nm):.5f} within {c.radius_mm:.4f} mm" for c in s.cores]
            ),
        )
        for s in scene.spheres
    ]
    if rows:
        columns = ("sphere", "centre x, y, z [mm]", "radius [mm]", f"n at {scene.wavelength_nm:g} nm")
        radii = sorted({f"{s.radius_mm:.4g}" for s in scene.spheres}, key=float)
        page.table(Table(f"Spheres, of radius {', '.join(radii)} mm", columns, rows))
    if scene.camera.pupil is not None and rows:
        page.figure("blur", blur_figure(*blur_of(scene)), BLUR_CAPTION, dense=True)


def draw_scene_of_page(scene: Scene, twice: bool) -> Drawn:
    """Draw the figure of a scene, once: a process that draws does it before there is anything else to draw."""
    if [(known, both) for known, both, _ in _drawn] != [(scene, twice)]:  # its hash knows no names
        _drawn[:] = [(scene, twice, render_figure(scene_figure(scene), twice))]
    return _drawn[0][2]


def light_sheet_line(page: Page, scene: Scene) -> None:
    """Say where particles were taken to lie; `scene` still has its light sheet."""
    say = page.warning if scene.sheet is None and scene.bodies else page.text
    say(where_lit(scene))


def slant_lines(page: Page, steepness: Steepness, said: str) -> None:
    """Add the viewing slope of the sheet, and what is known of the out-of-plane velocity."""
    if steepness.sentence:
        page.text(f"{steepness.sentence[0].upper()}{steepness.sentence[1:]}. Assumed: {said}.")


def slant_figure(
    page: Page, field: VectorField, grid: PlaneGrid, scene: Scene, sigma: NDArray[np.float64], unit: str
) -> None:
    """Add the uncertainty by out-of-plane motion, (ny, nx) in the order of the field, behind its vectors."""
    figure = vector_figure(field, grid, scene, sigma, f"sigma by the flow through the sheet [{unit}]")
    page.figure("slant", figure, "Uncertainty from oblique viewing.", dense=True)


def _vector_figure(page: Page, evaluation: Evaluation) -> None:
    """The vectors: before their error where it is known, else in the colour of their length."""
    field = evaluation.field
    if evaluation.shift is None:
        factor, unit = scale = _scale_of(evaluation)
        colour = np.hypot(field.u_px, field.v_px) * factor
        label = f"{'displacement' if evaluation.task.dt_s is None else 'speed'} [{unit}]"
        said = "Vectors, their length in colour"
        said += "." if is_plain(evaluation) else "; lines: outlines of the bodies on the plane."
    else:
        colour, label = (
            np.linalg.norm(shift_errors(field, evaluation.shift.shift_px), axis=-1),
            "difference from the known shift [px]",
        )
        said, scale = "Vectors; the background is their difference from the known shift.", (1.0, "px")
    figure = vector_figure(
        field, evaluation.grid, evaluation.task.scene, colour, label, _limit(evaluation, colour), scale
    )
    page.figure("vectors", figure, said, dense=True)


def _limit(evaluation: Evaluation, error: NDArray[np.float64]) -> float | None:
    """One scale for errors and their sigma; None where no error is known."""
    return None if evaluation.shift is None else max(colour_limit(error), colour_limit(_sigma(evaluation)))


def _sigma(evaluation: Evaluation) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(evaluation.total_sigma_px, axis=-1))


def _vectors(page: Page, evaluation: Evaluation) -> None:
    field, grid, scene = evaluation.field, evaluation.grid, evaluation.task.scene
    page.heading("Displacement")
    sigma = _sigma(evaluation)
    if np.isfinite(sigma).any():
        limit = None
        if evaluation.shift is not None:
            error = np.linalg.norm(shift_errors(field, evaluation.shift.shift_px), axis=-1)
            limit = _limit(evaluation, error)
        page.figure(
            "uncertainty",
            vector_figure(field, grid, scene, sigma, "total sigma [px]", limit),
            "The vectors before their total uncertainty; its parts stand in the table of uncertainties.",
            dense=True,
        )
    if evaluation.task.dt_s is not None:
        per_px = 1e-3 * grid.pitch_mm / evaluation.task.dt_s
        page.facts(
            [
                ("time between the frames", f"{evaluation.task.dt_s * 1e6:.3f} us"),
                ("1 px of displacement is", f"{per_px:.6g} m/s"),
            ]
        )
        page.table(tables.displacement_table(evaluation))
    page.table(tables.count_table(field))
    use = "may be used" if is_plain(evaluation) else "are recovered"
    rule = (
        f"Windows of {evaluation.settings.windows_text}; {field.step_px} px apart. A window is masked if less "
        f"than 30 % of its pixels {use} in both frames; replaced vectors are interpolated, or hardly "
        "known, and count nowhere as measured."
    )
    page.text(rule + (f" NaN pixels inside the mask, left out: {field.nan_pixels}." if field.nan_pixels else ""))


def _errors(page: Page, evaluation: Evaluation) -> None:
    result = evaluation.shift
    assert result is not None
    page.heading("Errors against the known shift")
    page.table(tables.shift_table(evaluation))
    scale = evaluation.grid.px_per_mm
    shift_mm = (result.shift_px[0] / scale, -result.shift_px[1] / scale)
    facts = [("known shift x, y", f"{shift_mm[0]:+.4f}, {shift_mm[1]:+.4f} mm")]
    facts.append(("in pixels", f"{np.hypot(*result.shift_px):.4f} px"))
    if evaluation.task.commanded_mm is not None:
        facts.insert(0, ("commanded x, y", "{:+.4f}, {:+.4f} mm".format(*evaluation.task.commanded_mm)))
    direct = result.regions.get("seen directly")
    if direct is not None:
        found = [(b + s) / scale for b, s in zip(direct.bias_px, result.shift_px, strict=True)]
        where = "found" if is_plain(evaluation) else "found beside the glass"
        facts.append((where, f"{found[0]:+.4f}, {-found[1]:+.4f} mm"))
    page.facts(facts)
    page.table(tables.budget_table(evaluation))
    field = evaluation.field
    errors = shift_errors(field, result.shift_px)
    spread = {name: errors[where] for name, where in region_masks(evaluation).items()}
    page.figure("errors", error_histogram(spread), "Errors by region, with the number of vectors.")
    if result.rings:
        page.figure("radius", radius_figure(result.rings), "Behind the glass, by radius on the plane.")


def _uncertainty(page: Page, evaluation: Evaluation) -> None:
    page.heading("Uncertainty")
    page.table(tables.sigma_table(evaluation))
    if (claims := tables.claim_table(evaluation)).rows:
        page.table(claims)
        page.text(
            "The common error of the stage is subtracted. As claimed: within the 95 % interval of chance for"
            " vectors whose windows do not overlap, or within 10 %."
        )
    else:
        verdict = sigma_verdict(evaluation)
        page.text(f"{verdict[0].upper()}{verdict[1:]}.")
    page.table(tables.response_table(evaluation.settings))
    if evaluation.slant is not None:
        region, slope = evaluation.regions.region, evaluation.slant.through.slope
        steepness = Steepness.of(slope, region == Region.GLASS, region == Region.DIRECT)
        slant_lines(page, steepness, evaluation.slant.said)
        if steepness.behind is not None:
            sigma = np.linalg.norm(evaluation.slant.sigma_px, axis=-1)
            slant_figure(page, evaluation.field, evaluation.grid, evaluation.task.scene, sigma, "px")
    if evaluation.map_sigma is None:
        page.text(
            f"{NO_SCALE_SIGMA}: {evaluation.no_map_sigma}."
            if is_plain(evaluation)
            else f"The uncertainty of the correction map is not known: {evaluation.no_map_sigma}."
        )
        return
    page.text(
        "Random: from the correlation statistics of each vector. Map: the covariance of the scene fit, carried "
        "through the traced rays. A position can be off by more than a displacement, because what both ends of a "
        "vector share cancels; the map's share is the same in every pair and does not average out."
    )


def _tracks(page: Page, evaluation: Evaluation) -> None:
    page.heading("Single particles")
    if evaluation.tracks is None:
        page.text(f"No tracks: {evaluation.no_tracks}.")
        return
    page.text(
        "Particles found in the raw frames, both ends traced through the glass, each seen the same way in both. "
        "A track has no window: its error is the same in every gradient. Where particles are many, vectors of "
        "windows are better."
    )
    page.table(tables.track_table(evaluation))
    said = "Tracks; blue: seen directly, red: through glass."
    page.figure("tracks", track_figure(evaluation.tracks.vectors, evaluation.task.scene), said, dense=True)


def _images(page: Page, evaluation: Evaluation) -> None:
    seen = _frame_of(evaluation)
    page.heading("Images")
    page.table(tables.image_table(seen.figures, seen.full_scale))
    counts = {name: (f.edges, f.histogram.astype(np.float64)) for name, f in seen.figures.items()}
    page.figure("intensity", grey_histogram(counts), "Intensity of frame A.")
