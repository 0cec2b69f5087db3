"""The page of a calibration, and its chapter in the pages of what is measured with it: is the model right."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from correction.fitted.scene_sigma import StoredVerdict, load_verdict
from correction.masked import STATUS, pixels_in
from correction.node_status import MEANING
from ground.errors import MapFileError
from ground.plain_words import quantity
from rtpiv.analysis.calibration import Calibration
from rtpiv.analysis.digits import places
from rtpiv.analysis.report.page import Page, through_lead
from rtpiv.analysis.report.table import Table
from tracer.scene.scene import Scene
from tracer.strategies.branches import text_of

CAPTION = (
    "Smooth part of the residuals of the calibration, a panel for each path through the glass; arrows are scaled"
    " panel by panel. What is smooth is no noise of corners: it is an error of the model, and the sigma of the map"
    " includes it."
)


def calibration_chapter(page: Page, fit_file: Path, scene: Scene) -> None:
    """Say how good the model of the scene is, if the fit file beside it knows; nothing without one."""
    if not fit_file.is_file():
        return
    try:
        found = load_verdict(fit_file)
    except MapFileError as error:
        page.heading("Calibration")
        page.text(f"{error}.")
        return
    if found.scene_hash == scene.content_hash():
        verdict_chapter(page, found)


def write_calibration_page(path: Path, found: Calibration, of: str) -> None:
    """Write the page of a calibration of the frames called `of`."""
    from rtpiv.analysis.pictures.calibration import map_sigma_figure, smooth_figure  # draws

    fit = found.fit
    page = Page(f"{of}: calibration", f"{quantity(len(fit.frames), 'frame')} of the target")
    recovered = np.isfinite(found.sigma.sigma_px[..., 0])
    through_lead(page, found.through, fit.measured_scene, float(recovered.mean()))
    verdict = StoredVerdict.of(fit)
    _say_verdict(page, verdict)
    page.lead(*calibration_lead(found))
    if len(found.layers) > 1:
        page.slider(found.layers, "The board as acquired, and corrected by the fitted scene. Drag to compare.")
    with page.row():
        said = "Standard uncertainty of the map [px of a corrected frame], both axes together."
        page.figure("map_sigma", map_sigma_figure(found.sigma, fit.measured_scene), said, dense=True)
        figure = smooth_figure(verdict, "first")
        if figure is not None:
            said = "Smooth part of the residuals of the largest view; the other views stand below."
            page.figure("smooth_first", figure, said, dense=True)
    _smooth_residuals(page, verdict, "others")
    mask_table(page, fit.measured_scene)
    if found.weak:
        page.heading("Undetermined parameters")
        for weakness in found.weak:
            page.text(f"{sentence_case(found.weakness_sentence(weakness))}.")
    page.heading("Fitted parameters")
    page.table(parameter_table(found))
    page.write(path)


def parameter_table(found: Calibration) -> Table:
    """Fitted parameters, to the second digit of sigma."""
    rows: list[tuple[str, ...]] = [(name, row["unit"], *_numbers(row)) for name, row in found.numbers.items()]
    columns = ("fitted parameter", "unit", "fitted", "sigma", "moved", "prior sigma")
    return Table("Every other number was held fixed", columns, rows)


def calibration_lead(found: Calibration) -> tuple[str, Table]:
    """Sigma of the map behind glass, or without glass beside it, and results of the corners, by region."""
    fit, regions = found.fit, found.percentiles
    region = "behind glass" if "behind glass" in regions else "seen directly"
    known = regions.get(region)
    value = "-" if known is None else f"{known['median']:.2g} px"
    said = f"standard uncertainty of the map {region}: median of its worse axis"
    head = ("region", "map sigma: median, largest [px]", "rms of residuals [px]", "corners used", "rejected")
    rows: list[tuple[str, ...]] = []
    for name, behind in (("behind glass", True), ("seen directly", False)):
        count, sigma = found.account[name], regions.get(name)
        if not count["measured"]:
            continue
        unsure = "-" if sigma is None else f"{sigma['median']:.2g}, {sigma['largest']:.2g}"
        rms = "{:.3f}, {:.3f}".format(*fit.corners.rms_px(behind)) if count["used"] else "-"
        rows.append((name, unsure, rms, f"{count['used']} of {count['measured']}", str(count["rejected"])))
    return value, Table(said, head, rows)


def verdict_chapter(page: Page, found: StoredVerdict) -> None:
    """The verdict in words, and its picture."""
    page.heading("Calibration: test of the model")
    _say_verdict(page, found)
    _smooth_residuals(page, found, "all")


def _say_verdict(page: Page, found: StoredVerdict) -> None:
    for sentence in found.sentences:
        say = page.text if found.right else page.warning
        say(f"{sentence_case(sentence)}.")


def _smooth_residuals(page: Page, found: StoredVerdict, views: Literal["all", "others"]) -> None:
    """Draw the smooth part of residuals, without the view that a page has shown already if it is of others."""
    from rtpiv.analysis.pictures.calibration import smooth_figure  # draws

    figure = smooth_figure(found, views)
    if figure is not None:
        page.figure("smooth_residuals", figure, CAPTION, dense=True)


def mask_table(page: Page, scene: Scene) -> None:
    """Say what parts of the view every map leaves out, and why; nothing where there are none."""
    if not scene.masked:
        return
    page.heading("Masked areas")
    rows: list[tuple[str, ...]] = []
    for part in scene.masked:
        where, size = f"all that is seen through {text_of(part.through)}", "-"
        if part.outline_px:
            (left, top), (right, bottom) = np.min(part.outline_px, axis=0), np.max(part.outline_px, axis=0)
            where = f"around pixel ({(left + right) / 2:.0f}, {(top + bottom) / 2:.0f})"
            share = pixels_in(part, scene.camera.shape).mean()
            size = f"{right - left:.0f} x {bottom - top:.0f} px, {100.0 * share:.2g} % of the frame"
        rows.append((MEANING[STATUS[part.why]], where, size))
    said = "`masked` in the fitted scene file holds these; take out what you know to be right"
    page.table(Table(said, ("reason", "where", "size"), rows))


def sentence_case(text: str) -> str:
    """A text as a sentence begins; names of parameters, with a dot in their first word, stay as they are."""
    first = text.split(" ", 1)[0]
    return text if "." in first else f"{text[:1].upper()}{text[1:]}"


def _numbers(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Value, sigma, movement and sigma before, to the second digit of sigma."""
    digits = places(float(row["sigma"]))
    value, known, moved = (f"{row[key]:z.{digits}f}" for key in ("value", "sigma", "moved"))
    return value, known, moved, f"{row['prior_sigma']:.3g}"
