"""What the test of the model looks at: the smooth part of the residuals, way by way through the glass.

Corners scatter; a model that is wrong bends.  Every panel shows one way, a ball or a chain of them, its arrows
scaled by themselves: a field that turns or points outwards is a ball that is not the sphere of the file, or a
board that is not flat; arrows that point anywhere are noise.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from correction.fit.fit_file import StoredVerdict
from correction.fit.result import SceneFit
from daq.analysis.pictures.canvas import Figure
from daq.analysis.pictures.names import short
from daq.analysis.pictures.plane_axes import colour_bar, plane_panels
from daq.analysis.pictures.saved import save_picture

MOST_WAYS = 6  # with the most corners
FEWEST = 12  # corners of a way that is drawn
ARROW = 0.12  # length of an arrow of typical size, of the panel


def draw_smooth(path: Path, fit: SceneFit) -> None:
    """Draw it for a fit, as PNG; nothing where no way shows enough corners."""
    figure = smooth_figure(StoredVerdict.of(fit))
    if figure is not None:
        FigureCanvasAgg(figure)
        save_picture(figure, path, 100)


def smooth_figure(found: StoredVerdict) -> Figure | None:
    """Draw the smooth part of the residuals, a panel for each way with many corners; None if there is none."""
    count = np.bincount(found.way, minlength=len(found.ways))
    drawn = [int(way) for way in np.argsort(-count, kind="stable")[:MOST_WAYS] if count[way] >= FEWEST]
    if not drawn:
        return None
    drawn.sort(key=lambda way: (len(found.ways[way]), found.ways[way]))
    columns = min(len(drawn), 3)
    figure, panels = plane_panels(1.0, len(drawn), columns, 3.4)
    for axes, way in zip(panels, drawn, strict=True):
        here = found.way == way
        pixel, smooth = found.pixel[here], found.smooth_px[here]
        length = np.hypot(*smooth.T)
        typical = max(float(np.percentile(length, 95)), 1e-6)
        low, high = pixel.min(axis=0), pixel.max(axis=0)
        middle, reach = 0.5 * (low + high), 0.55 * max(float((high - low).max()), 1.0)
        shown = axes.quiver(
            *pixel.T,
            *(smooth * np.minimum(1.0, typical / np.maximum(length, 1e-300))[:, None]).T,
            length,
            angles="xy",
            scale_units="xy",
            scale=typical / (2.0 * ARROW * reach),
            width=0.004,
            clim=(0.0, typical),
        )
        colour_bar(shown, axes, "smooth part [px]", "max")
        u, v = middle.tolist()
        axes.set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach), xlabel="u [px]", ylabel="v [px]")
        rms = float(np.sqrt(np.mean(smooth**2)))
        name = short(found.ways[way], 30) or "beside the glass"
        axes.set_title(f"{name}: {rms:.2g} px rms", fontsize=9, parse_math=False)
    return figure
