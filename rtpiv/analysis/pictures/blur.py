"""How sharp a camera with an aperture shows each point of the plane: the depth of field of the real scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from correction.grid import PlaneGrid
from correction.maps.aperture import BlurMap, blur_map
from correction.maps.correction_map import build_correction_map
from rtpiv.analysis.pictures.canvas import Figure
from rtpiv.analysis.pictures.plane_axes import colour_bar, plane_panels
from rtpiv.analysis.pictures.saved import save_picture
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

CAPTION = (
    "How sharp the camera's aperture shows each point behind the glass, and how far the centroid of a particle's"
    " picture lies beside its chief ray: that is taken off, and what is too wide or too far off is left out."
)


def blur_of(scene: Scene) -> tuple[PlaneGrid, BlurMap]:
    """Blur behind the glass of a scene whose camera has a pupil, and the nodes that it belongs to."""
    pinhole = scene.with_camera(replace(scene.camera, pupil=None))
    found = build_correction_map(pinhole, build_ray_map(pinhole))
    return found.grid, blur_map(found, scene)


def draw_blur(path: Path, grid: PlaneGrid, blur: BlurMap) -> None:
    """Draw `blur_figure` as PNG."""
    save_picture(blur_figure(grid, blur), path, 100)


def blur_figure(grid: PlaneGrid, blur: BlurMap) -> Figure:
    """Draw blur behind glass and how far centroids lie beside their chief rays, side by side."""
    height, width = grid.shape
    figure, axes = plane_panels(height / width, count=2, columns=2)
    FigureCanvasAgg(figure)
    (x0, y0), pitch = grid.origin_mm, grid.pitch_mm
    extent = (x0, x0 + width * pitch, y0 - height * pitch, y0)
    behind = np.isfinite(blur.width_px)
    aside = np.where(behind, np.hypot(blur.shift_px[..., 0], blur.shift_px[..., 1]), np.nan)
    panels = (
        ("blur by the aperture", blur.width_px, "standard deviation of a point's picture [sensor px]"),
        ("its centroid", aside, "beside the chief ray [sensor px]"),
    )
    for panel, (title, values, label) in zip(axes, panels, strict=True):
        top = float(np.nanquantile(values, 0.99)) if behind.any() else 1.0
        shown = panel.imshow(values, extent=extent, cmap="viridis", vmin=0.0, vmax=top)
        colour_bar(shown, panel, label, "max")
        panel.set(xlabel="x [mm]", ylabel="y [mm]", title=title)
    return figure
