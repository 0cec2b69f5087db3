"""Picture of a light sheet that was found: where it was seen, how high, and what is left over."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from correction.light_sheet.self_calibration import SheetFound
from rtpiv.analysis.pictures.plane_axes import colour_bar, plane_panels
from rtpiv.analysis.pictures.saved import save_picture
from tracer.strategies.branches import Branch

MARKERS = "osD^vP*X"


def by_words(kinds: Sequence[tuple[Branch, Branch]]) -> dict[str, list[int]]:
    """Numbers of the kinds of double views by their words, which both sides of a fold share."""
    found: dict[str, list[int]] = {}
    for number, ways in enumerate(kinds):
        found.setdefault(" and ".join(", ".join(way) or "direct" for way in ways), []).append(number)
    return found


def draw_light_sheet(path: Path, found: SheetFound, size_mm: tuple[float, float]) -> None:
    """Draw heights of cells over the target's plane and what the plane found leaves of them, as PNG.

    `size_mm` is width and height of the view.
    """
    width, height = size_mm
    figure, panels = plane_panels(height / width, 2, 2, 6.0)
    FigureCanvasAgg(figure)
    cells, fit, sheet = found.cells, found.fit, found.sheet
    for axes, title in zip(panels, ("height over the target's plane", "left over"), strict=True):
        axes.plot(*found.views.place_mm[:: max(1, len(found.views.kind) // 5000)].T, ",", color="#c9ced6")
        if cells is not None and fit is not None:
            on_sheet = sheet.height_mm(*cells.place_mm.T)
            values = fit.residual_mm if title == "left over" else on_sheet + fit.residual_mm
            reach = max(float(np.quantile(np.abs(fit.residual_mm), 0.9)), 1e-3)
            limits = (-reach, reach) if title == "left over" else (on_sheet.min() - reach, on_sheet.max() + reach)
            for number, (ways, kinds) in enumerate(by_words(found.views.kinds).items()):
                here = np.isin(cells.kind, kinds)
                if not here.any():
                    continue
                shown = axes.scatter(
                    cells.place_mm[here, 0],
                    cells.place_mm[here, 1], c=values[here], vmin=limits[0], vmax=limits[1], cmap="coolwarm", s=60,
                    marker=MARKERS[number % len(MARKERS)], edgecolors="#444c5c", linewidths=0.5, label=ways,
                )  # fmt: skip
            colour_bar(shown, axes, "mm")
            axes.legend(fontsize=7, loc="upper left")
        axes.set(xlim=(-width / 2, width / 2), ylim=(-height / 2, height / 2), aspect="equal", xlabel="x' [mm]")
        axes.set(ylabel="y' [mm]", title=title)
    save_picture(figure, path, 100)
