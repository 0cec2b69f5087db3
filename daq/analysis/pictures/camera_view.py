"""What the camera sees of a board with markers through the glass, with the axes of the sensor."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from daq.analysis.pictures.canvas import Figure
from daq.analysis.pictures.names import short
from daq.analysis.pictures.plane_axes import bare
from daq.analysis.pictures.saved import save_picture


def draw_camera_view(path: Path, image: NDArray[np.float32], square_mm: float, title: str) -> None:
    """Draw an image (H, W, 3) in 0..1 of a board with squares of `square_mm` as PNG."""
    height, width = image.shape[:2]
    figure = Figure(figsize=(8.6, 0.9 + 7.9 * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    bare(axes)
    axes.imshow(np.clip(image, 0.0, 1.0), interpolation="antialiased")
    said = f"{short(title, 40)}: squares of {square_mm:g} mm on the plane; black: no light arrives"
    axes.set_title(said, fontsize=10, parse_math=False)
    axes.set(xlabel="u [px]", ylabel="v [px]")
    save_picture(figure, path, 130)
