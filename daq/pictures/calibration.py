"""Pictures of a calibration: residuals as arrows, and the sigma of the map."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from correction.fit.map_sigma import MapSigma

Panel = tuple[str, NDArray[np.float64], NDArray[np.float64]]


def draw_residuals(path: Path, panels: list[Panel], shape: tuple[int, int]) -> None:
    """Draw errors at their pixels as arrows, one panel a scene, as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    panels : list of (title, pixel (N, 2), error_px (N, 2))
        What to draw; each panel scales its arrows so that the 95th percentile is 1/25 of the frame.
    shape : (int, int)
        Rows and columns of the frame.
    """
    figure = Figure(figsize=(8.0 * len(panels), 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (title, pixel, error) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        length = np.hypot(error[:, 0], error[:, 1])
        typical = max(float(np.percentile(length, 95)), 1e-6)
        shown = axes.quiver(
            *pixel.T,
            *error.T,
            length,
            angles="xy",
            scale_units="xy",
            scale=25.0 * typical / shape[1],
            width=0.0015,
            clim=(0.0, typical),
        )
        figure.colorbar(shown, ax=axes, label="distance [px]", shrink=0.8)
        axes.set(xlim=(0, shape[1]), ylim=(shape[0], 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        axes.set_title(f"{title}: 95 % within {typical:.2f} px")
    figure.savefig(path, dpi=100)


def draw_map_sigma(path: Path, sigma: MapSigma) -> None:
    """Draw the standard deviation of the correction, both axes together, as PNG on a logarithmic scale."""
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    total = np.hypot(sigma.sigma_px[..., 0], sigma.sigma_px[..., 1])
    floor = max(float(np.nanmin(total)), 1e-5) if np.isfinite(total).any() else 1e-5
    height, width = total.shape
    x0, y0, pitch = *sigma.grid.origin_mm, sigma.grid.pitch_mm
    extent = (x0, x0 + width * pitch, y0 - height * pitch, y0)
    shown = axes.imshow(np.log10(np.maximum(total, floor)), extent=extent, cmap="viridis")
    figure.colorbar(shown, ax=axes, label="log10 of sigma [corrected px]")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title="standard deviation of the correction")
    figure.savefig(path, dpi=100)
