"""What the camera sees of a board with markers through the glass, with the axes of the sensor."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from rtpiv.analysis.pictures.canvas import Figure
from rtpiv.analysis.pictures.names import short
from rtpiv.analysis.pictures.plane_axes import bare
from rtpiv.analysis.pictures.saved import save_picture


def draw_camera_view(
    path: Path, image: NDArray[np.float32], sensor_px: tuple[int, int], square_mm: float, title: str
) -> None:
    """Draw what a sensor sees, an image (h, w, 3) in 0..1, of a board with squares of `square_mm` as PNG."""
    width, height = sensor_px
    figure = Figure(figsize=(8.6, 0.9 + 7.9 * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    bare(axes)
    shown = np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    axes.imshow(shown, extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="antialiased")
    said = f"{short(title, 40)}: squares of {square_mm:g} mm on the plane; black: no light arrives"
    axes.set_title(said, fontsize=10, parse_math=False)
    axes.set(xlabel="u [px]", ylabel="v [px]")
    save_picture(figure, path, 130)
