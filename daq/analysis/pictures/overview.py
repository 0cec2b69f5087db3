"""Raw | computer-generated | corrected, side by side, with the mask drawn over the last."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray


def draw_overview(
    path: Path,
    raw: NDArray[Any],
    computed: NDArray[np.float32],
    corrected: NDArray[np.float32],
    recovered: NDArray[np.bool_],
) -> None:
    """Draw three images side by side as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    raw : ndarray (H, W)
        Acquired frame.
    computed : ndarray (H, W)
        What the scene's camera should see.
    corrected : ndarray (h, w)
        Corrected frame; what is not recovered is tinted.
    recovered : ndarray (h, w) bool
        The mask.
    """
    figure = Figure(figsize=(18.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    low, high = np.percentile(raw, (0.5, 99.5))
    shown = np.clip((np.nan_to_num(corrected, nan=low) - low) / max(high - low, 1.0), 0.0, 1.0)
    tinted = np.repeat(shown[..., None], 3, axis=-1)
    tinted[~recovered] = (0.22, 0.26, 0.36)
    images = ((raw, "acquired"), (computed, "computer-generated from the scene"), (tinted, "corrected"))
    for axes, (image, title) in zip(panels, images, strict=True):
        limits = {"vmin": low, "vmax": high} if image is raw else {}
        axes.imshow(image, cmap="gray", interpolation="antialiased", **limits)
        axes.set_title(title)
        axes.set_axis_off()
    figure.savefig(path, dpi=100)
