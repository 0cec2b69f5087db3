"""Raw | computer-generated | corrected, side by side, with the mask drawn over the last and its colours below."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from correction.node_status import NodeStatus
from rtpiv.analysis.pictures.plane_axes import Figure
from rtpiv.analysis.pictures.rasters import covered, grey, reduced, swatch, tinted
from rtpiv.analysis.pictures.saved import save_picture


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
    figure = Figure(figsize=(18.0, 0.9 + 6.0 * raw.shape[0] / raw.shape[1]), layout="constrained")
    FigureCanvasAgg(figure)
    low, high = np.percentile(raw, (0.5, 99.5))
    limits = (float(low), float(high))
    images = (
        (grey(raw, limits), "acquired"),
        (grey(computed, (0.0, max(float(computed.max()), 1e-6))), "computer-generated from the scene"),
        (tinted(grey(corrected, limits), covered(status)), "corrected"),
    )
    for axes, (image, title) in zip(figure.subplots(1, 3), images, strict=True):
        axes.imshow(reduced(image), cmap="gray", interpolation="antialiased", vmin=0, vmax=255)
        axes.set_title(title)
        axes.set_axis_off()
    lost = [each for each in NodeStatus if each != NodeStatus.RECOVERED and (status == each).any()]
    if lost:
        figure.legend(handles=[swatch(each) for each in lost], loc="outside lower right", ncols=5, frameon=False)
    save_picture(figure, path, 100)
