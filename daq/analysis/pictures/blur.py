"""How sharp a camera with an aperture shows each point of the plane: the depth of field of the real scene."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from correction.aperture import BlurMap
from correction.grid import PlaneGrid
from daq.analysis.pictures.canvas import Figure
from daq.analysis.pictures.saved import save_picture


def draw_blur(path: Path, grid: PlaneGrid, blur: BlurMap) -> None:
    """Draw blur behind glass and how far centroids lie beside their chief rays, side by side, as PNG."""
    figure = Figure(figsize=(12.0, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    height, width = grid.shape
    (x0, y0), pitch = grid.origin_mm, grid.pitch_mm
    extent = (x0, x0 + width * pitch, y0 - height * pitch, y0)
    behind = np.isfinite(blur.width_px)
    aside = np.where(behind, np.hypot(blur.shift_px[..., 0], blur.shift_px[..., 1]), np.nan)
    panels = (
        (blur.width_px, "standard deviation of a point's picture [sensor px]"),
        (aside, "centroid beside the chief ray [sensor px]"),
    )
    for number, (values, label) in enumerate(panels, start=1):
        axes = figure.add_subplot(1, 2, number)
        top = float(np.nanquantile(values, 0.99)) if behind.any() else 1.0
        shown = axes.imshow(values, extent=extent, cmap="viridis", vmin=0.0, vmax=top)
        figure.colorbar(shown, ax=axes, label=label, extend="max")
        axes.set(xlabel="x [mm]", ylabel="y [mm]", title="blur by the aperture" if number == 1 else "")
    save_picture(figure, path, 100)
