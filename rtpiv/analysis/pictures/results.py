"""Pictures of what verbs have found: corrected frames, a light sheet, arrangements of glass and camera."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm
from numpy.typing import NDArray

from correction.node_status import NodeStatus
from rtpiv.analysis.pictures.plane_axes import Figure, add_axes_in, colour_bar, plane_panels
from rtpiv.analysis.pictures.rasters import grey, shrink, swatch, tint
from rtpiv.analysis.pictures.saved import save_picture

if TYPE_CHECKING:  # names alone: who draws one of them does not wait for what makes the others
    from correction.light_sheet.self_calibration import SheetFound
    from rtpiv.analysis.views.figures import ViewFigures
    from tracer.strategies.branches import Branch


def draw_overview(
    path: Path,
    raw: NDArray[Any],
    computed: NDArray[np.float32],
    corrected: NDArray[np.float32],
    status: NDArray[np.uint8],
) -> None:
    """Draw three images side by side as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    raw : ndarray (H, W)
        Acquired frame.
    computed : ndarray (H, W)
        What the scene's camera should see of a print like that of the frame, 0 to 1.
    corrected : ndarray (h, w)
        Corrected frame.
    status : ndarray (h, w) uint8
        NodeStatus; what is not recovered takes the colour of its reason.
    """
    lost = [each for each in NodeStatus if each != NodeStatus.RECOVERED and (status == each).any()]
    tall, below = 5.9 * raw.shape[0] / raw.shape[1], 0.1 + 0.22 * -(-len(lost) // 5)
    figure = Figure(figsize=(18.0, tall + below + 0.35))
    low, high = np.percentile(raw, (0.5, 99.5))
    limits = (float(low), float(high))
    images = (
        (grey(raw, limits), "acquired"),
        (grey(computed, (0.0, max(float(computed.max()), 1e-6))), "computer-generated from the scene"),
        (tint(grey(corrected, limits), status), "corrected"),
    )
    for number, (image, title) in enumerate(images):
        axes = add_axes_in(figure, 0.05 + 6.0 * number, below, 5.9, tall)
        axes.imshow(shrink(image), cmap="gray", interpolation="antialiased", vmin=0, vmax=255)
        axes.set_title(title)
        axes.set_axis_off()
    if lost:
        figure.legend(handles=[swatch(each) for each in lost], loc="lower right", ncols=5, frameon=False)
    save_picture(figure, path, 100)


MARKERS = "osD^vP*X"


def by_words(kinds: "Sequence[tuple[Branch, Branch]]") -> dict[str, list[int]]:
    """Numbers of the kinds of double views by their words, which both sides of a fold share."""
    found: dict[str, list[int]] = {}
    for number, ways in enumerate(kinds):
        found.setdefault(" and ".join(", ".join(way) or "direct" for way in ways), []).append(number)
    return found


def draw_light_sheet(path: Path, found: "SheetFound", size_mm: tuple[float, float]) -> None:
    """Draw heights of cells over the target's plane and what the plane found leaves of them, as PNG.

    `size_mm` is width and height of the view.
    """
    width, height = size_mm
    figure, panels = plane_panels(height / width, 2, 2, 6.0)
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
                    cells.place_mm[here, 1],
                    c=values[here],
                    vmin=limits[0],
                    vmax=limits[1],
                    cmap="coolwarm",
                    s=60,
                    marker=MARKERS[number % len(MARKERS)],
                    edgecolors="#444c5c",
                    linewidths=0.5,
                    label=ways,
                )
            colour_bar(shown, axes, "mm")
            axes.legend(fontsize=7, loc="upper left")
        axes.set(xlim=(-width / 2, width / 2), ylim=(-height / 2, height / 2), aspect="equal", xlabel="x' [mm]")
        axes.set(ylabel="y' [mm]", title=title)
    save_picture(figure, path, 100)


MAX_VIEWS_LABELLED = 12  # of the Pareto front, by their number in the table


def draw_views(path: Path, views: "Sequence[ViewFigures]", best: "Sequence[ViewFigures]", error_px: float) -> None:
    """Draw the picture as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    views, best : sequence of ViewFigures
        All that show something, and the Pareto front in the order of their numbers.
    error_px : float
        What was asked for; drawn as a line.
    """
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    axes = figure.add_subplot()
    shown = [view for view in views if np.isfinite(view.noise_px)]
    light = np.array([view.light for view in shown])
    scale = LogNorm(light.min() / light.max(), 1.0) if light.min() < light.max() else LogNorm(0.1, 1.0)
    for some, size, edge in ((shown, 22, "none"), (best, 70, "black")):
        points = axes.scatter(
            [view.noise_px for view in some],
            [100.0 * view.usable for view in some],
            c=[view.light / light.max() for view in some],
            s=size,
            norm=scale,
            cmap="viridis",
            edgecolors=edge,
        )
    for number, view in enumerate(best[:MAX_VIEWS_LABELLED], start=1):
        place = (view.noise_px, 100.0 * view.usable)
        axes.annotate(str(number), place, textcoords="offset points", xytext=(7, 4), fontsize=9)
    axes.axvline(error_px, linestyle="--", color="0.5", linewidth=1)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set(
        xlabel="noise of a displacement behind glass, median [corrected px]",
        ylabel="usable share of what the balls hide [%]",
        title=f"{len(shown)} arrangements; numbered: no other beats them",
    )
    figure.colorbar(points, ax=axes, format="{x:g}", label="light of a particle's picture, the brightest = 1")
    save_picture(figure, path, 110)
