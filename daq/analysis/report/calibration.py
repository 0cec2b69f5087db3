"""The page of a calibration, and its chapter in the pages of what is measured with it: is the model right."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from correction.fit.fit_file import StoredVerdict, load_verdict
from daq.analysis.calibration import Calibration
from daq.analysis.pictures.smooth import smooth_figure
from daq.analysis.report.page import Page
from ground.errors import MapFileError
from tracer.scene import Scene

MOST_PLACES = 9  # of a number that is known to more than anybody can make
CAPTION = (
    "Smooth part of the residuals of the calibration, one panel for each way through the glass, arrows scaled"
    " panel by panel. What bends is not noise; its size is counted in the sigma of the map."
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
    page = Page(f"{of}: calibration", f"{len(found.fit.frames)} frames of the target")
    verdict_chapter(page, StoredVerdict.of(found.fit))
    if found.weak:
        page.heading("What the frames leave open")
        for weakness in found.weak:
            page.text(f"{weakness.sentence[:1].upper()}{weakness.sentence[1:]}.")
    page.heading("What was found")
    rows: list[tuple[str, ...]] = [
        (region, f"{v['median']:.4f}", f"{v['largest']:.3f}") for region, v in found.percentiles.items()
    ]
    page.table(("sigma of the map [px]", "median", "largest"), rows)
    rows = [(name, row["unit"], *_numbers(row)) for name, row in found.numbers.items()]
    page.table(("free number", "unit", "fitted", "sigma", "moved", "sigma before"), rows, "The rest was held.")
    rows = []
    for name, count in found.account.items():
        rows.append((name, *(str(count[key]) for key in ("measured", "used", "put aside"))))
    page.table(("corners", "measured", "used", "put aside beyond 5 sigma"), rows)
    page.write(path)


def verdict_chapter(page: Page, found: StoredVerdict) -> None:
    """The verdict in words and its picture."""
    page.heading("Calibration: is the model right?")
    for sentence in found.sentences:
        say = page.text if found.right else page.warning
        say(f"{sentence[:1].upper()}{sentence[1:]}.")
    figure = smooth_figure(found)
    if figure is not None:
        page.figure("smooth_residuals", figure, CAPTION, dense=True)


def _numbers(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Value, sigma, movement and sigma before, to the second digit of sigma: what stands behind it is noise."""
    sigma = float(row["sigma"])
    places = min(max(1 - math.floor(math.log10(sigma)), 0), MOST_PLACES) if sigma > 0.0 else MOST_PLACES
    value, known, moved = (f"{row[key]:.{places}f}" for key in ("value", "sigma", "moved"))
    return value, known, moved, f"{row['prior_sigma']:.3g}"
