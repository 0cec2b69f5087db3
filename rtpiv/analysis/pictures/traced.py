"""The pictures of a traced scene: its plane, what the camera sees, the radial curve, the blur.

plane          recovered or not and why, and at which magnification
camera view    a board with markers through the glass, with the axes of the sensor
slant          how steeply the rays meet the plane, and which way they lean
radial curve   the radial distortion r_i/R against r_o/R: Fig. 5 of Martins et al. (2018)
blur           how sharp a camera with an aperture shows each point of the plane: its depth of field
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.patches import Patch
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.aperture import BlurMap, blur_map
from correction.maps.correction_map import build_correction_map, nodes_in_glass
from correction.maps.lit import PlaneLight
from correction.node_status import MEANING, NodeStatus
from rtpiv.analysis.pictures.plane_axes import (
    NOTHING,
    Figure,
    bare_figure,
    colour_bar,
    draw_outlines,
    plane_panels,
)
from rtpiv.analysis.pictures.rasters import COLOURS, THROUGH, Colour, ShownPlane, mask_picture, web
from rtpiv.analysis.pictures.saved import save_picture, short
from rtpiv.analysis.steepness import ShownSlant
from rtpiv.analysis.through_glass import PlaneShare
from rtpiv.analysis.views.field_of_view import FieldOfView, radial_curve
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

SIZES = LinearSegmentedColormap.from_list(  # small is warm: there resolution is lost
    "sizes", ("#a8323e", "#f0b27a", "#f7f5f0", "#5b93c2", "#173f6b")
).with_extremes(bad="#9aa2b1")
SHINE = LinearSegmentedColormap.from_list("light", ("#0b0d1f", "#1f6f54", "#7fd06b", "#f4f7c5")).with_extremes(
    bad="#9aa2b1"
)
HEIGHTS = SIZES.with_extremes(bad="#9aa2b1")
LEAST, MOST = 0.25, 4.0  # of the magnification's colours


def draw_plane(path: Path, scene: Scene, found: ShownPlane, share: PlaneShare, title: str) -> None:
    """Draw the mask with its reasons, and the magnification of the best view, side by side as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    scene : Scene
        Whose bodies are outlined.
    found : ShownPlane
        Of its map.
    share : PlaneShare
        Areas, said in the legend.
    title : str
        Said on top.
    """
    colours = mask_picture(found.status)
    colours[found.through_glass] = THROUGH
    swatches = _swatches(share)
    below = 0.2 + 0.22 * -(-len(swatches) // 3)
    figure, (mask, scale) = plane_panels(share.size_mm[1] / share.size_mm[0], 2, 2, 4.4, (below, 0.45))
    x0, y0 = found.grid.origin_mm
    (width, height), half = share.size_mm, 0.5 * found.grid.pitch_mm
    extent = (x0 - half, x0 - half + width, y0 + half - height, y0 + half)
    mask.imshow(colours, extent=extent, interpolation="nearest")
    figure.legend(handles=swatches, loc="lower center", ncols=3, frameon=False)
    mask.set_title(
        f"recovered of the whole plane: {area_text(share.recovered_mm2)} of {area_text(share.whole_mm2)} mm\u00b2"
    )
    shown = scale.imshow(
        found.magnification, extent=extent, interpolation="nearest", cmap=SIZES, norm=LogNorm(LEAST, MOST)
    )
    bar = colour_bar(shown, scale, "magnification [sensor px per corrected px]", "both")
    bar.set_ticks([0.25, 0.5, 1.0, 2.0, 4.0], labels=["1/4", "1/2", "1", "2", "4"])
    bar.minorticks_off()
    scale.set_title(f"magnification: 1 is {found.grid.px_per_mm:.4g} px/mm")
    for axes in (mask, scale):
        draw_outlines(axes, scene, names=axes is mask)
        axes.set(xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    through = (
        "" if share.through is None else f": {share.through.percent} {share.through.name} is seen through glass"
    )
    figure.suptitle(f"{short(title, 60)}{through}", parse_math=False)
    save_picture(figure, path, 110)


def area_text(area_mm2: float) -> str:
    """Area with four digits, never as a power of ten."""
    return f"{area_mm2:.0f}" if area_mm2 >= 1000.0 else f"{area_mm2:.4g}"


def _swatches(share: PlaneShare) -> list[Patch]:
    """A swatch for each colour that occurs, with the area it stands for."""

    def swatch(colour: Colour, text: str, area: float) -> Patch:
        said = f"{text}: {area_text(area)} mm\u00b2, {100.0 * area / share.whole_mm2:.2g} %"
        return Patch(facecolor=web(colour), edgecolor=NOTHING, label=said)

    found = [swatch(COLOURS[NodeStatus.RECOVERED], "recovered, seen directly", share.direct_mm2)]
    if share.glass_mm2:
        found.append(swatch(THROUGH, "recovered, through glass", share.glass_mm2))
    return found + [
        swatch(COLOURS[status], MEANING[status], area)
        for status, area in share.areas_mm2.items()
        if status != NodeStatus.RECOVERED and area
    ]


def draw_camera_view(
    path: Path, image: NDArray[np.float32], sensor_px: tuple[int, int], square_mm: float, title: str
) -> None:
    """Draw what a sensor sees, an image (h, w, 3) in 0..1, of a board with squares of `square_mm` as PNG."""
    width, height = sensor_px
    figure, axes = bare_figure(8.6, 0.85 + 7.6 * height / width, 0.35)
    shown = np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    axes.imshow(shown, extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="antialiased")
    said = f"{short(title, 40)}: squares of {square_mm:g} mm on the plane; black: no light arrives"
    axes.set_title(said, fontsize=10, parse_math=False)
    axes.set(xlabel="u [px]", ylabel="v [px]")
    save_picture(figure, path, 130)


DARKEST, BRIGHTEST = 1.0 / 16.0, 16.0  # of the colours of light


def draw_light(path: Path, scene: Scene, lit: PlaneLight) -> None:
    """Draw how bright the sheet is on the plane, and how high its light lies, side by side as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    scene : Scene
        Whose bodies are outlined.
    lit : PlaneLight
        The light.
    """
    grid, (height, width) = lit.grid, lit.grid.shape
    (x0, y0), pitch = grid.origin_mm, grid.pitch_mm
    figure, (left, right) = plane_panels(height / width, 2, 2)
    extent = (x0 - 0.5 * pitch, x0 + (width - 0.5) * pitch, y0 - (height - 0.5) * pitch, y0 + 0.5 * pitch)
    inside = nodes_in_glass(scene, grid)
    glass = np.zeros(grid.shape, np.bool_) if inside is None else inside
    bright = np.where(glass, np.nan, np.maximum(lit.light.brightness, 0.5 * DARKEST))
    high = np.where(glass | (lit.light.brightness < DARKEST), np.nan, lit.light.height_mm)
    most = float(np.nanquantile(np.abs(high), 0.99)) if np.isfinite(high).any() else 0.0
    norm = LogNorm(DARKEST, BRIGHTEST)
    shown = left.imshow(bright, extent=extent, cmap=SHINE, norm=norm, interpolation="nearest")
    bar = colour_bar(shown, left, "brightness relative to the undisturbed sheet", "both")
    bar.set_ticks([1 / 16, 0.25, 1.0, 4.0, 16.0], labels=["1/16", "1/4", "1", "4", "16"])
    bar.minorticks_off()
    limit = max(most, 1e-3)
    shown = right.imshow(high, extent=extent, cmap=HEIGHTS, vmin=-limit, vmax=limit, interpolation="nearest")
    colour_bar(shown, right, "mean height of the light over the plane [mm]", "both")
    for axes in (left, right):
        axes.set(xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    save_picture(figure, path, 110)


LEANS = 24  # arrows along the longer side


def draw_slant(path: Path, scene: Scene, grid: PlaneGrid, found: ShownSlant) -> None:
    """Draw the size of the slopes, and by arrows where a particle that rises is seen to go, as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    scene : Scene
        Whose bodies are outlined.
    grid : PlaneGrid
        Of the whole map.
    found : ShownSlant
        Slopes of some of its nodes.
    """
    height, width = (side * found.every for side in found.slopes.shape[:2])
    figure, (axes,) = plane_panels(height / width)
    (x0, y0), pitch = grid.origin_mm, grid.pitch_mm
    extent = (x0, x0 + width * pitch, y0 - height * pitch, y0)
    size = np.hypot(found.slopes[..., 0], found.slopes[..., 1])
    known = size[np.isfinite(size)]
    top = float(np.quantile(known, 0.99)) if known.size else 1.0
    shown = axes.imshow(size, extent=extent, cmap="viridis", vmin=0.0, vmax=top, interpolation="nearest")
    every = max(1, max(size.shape) // LEANS)
    some = (slice(every // 2, None, every),) * 2
    lean = -found.slopes[some]  # it is found before its own place
    rows, columns = (np.arange(side)[every // 2 :: every] for side in size.shape)
    at = x0 + (columns + 0.5) * found.every * pitch, y0 - (rows + 0.5) * found.every * pitch
    axes.quiver(*at, lean[..., 0], lean[..., 1], color="white", width=0.002, pivot="mid", angles="xy")
    draw_outlines(axes, scene, names=False)
    colour_bar(shown, axes, "slope of the rays: seen within the plane for 1 through it", "max")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    save_picture(figure, path, 110)


def draw_curve(path: Path, scene: Scene, view: FieldOfView, title: str) -> None:
    """Draw the curve of a coaxial scene as PNG.

    Parameters
    ----------
    path : Path
        Where to.
    scene : Scene
        The scene.
    view : FieldOfView
        Its figures, marked in the picture.
    title : str
        Said on top.
    """
    radius = view.radius_mm
    image = np.linspace(0.0, view.silhouette_mm, 1500)[:-1]
    plane, _ = radial_curve(scene, image)
    before = image <= view.fold_mm
    figure, axes = bare_figure(6.4, 4.8, 0.35)
    limit = 1.05 * max(view.silhouette_mm, view.edge_mm) / radius
    axes.plot([0, limit], [0, limit], "--", color="0.6", label="no glass")
    axes.plot(image[before] / radius, abs(plane[before]) / radius, color="C0", label="through the glass")
    shown = ~before & (abs(plane) < limit * radius)
    axes.plot(image[shown] / radius, abs(plane[shown]) / radius, ":", color="C0", label="beyond the fold")
    axes.axvline(view.silhouette_mm / radius, color="C3", linewidth=1, label="silhouette")
    axes.plot(view.fold_mm / radius, view.edge_mm / radius, "o", color="C1", label="edge of the recovered region")
    axes.set(xlim=(0, limit), ylim=(0, limit), xlabel="image radius rᵢ / R", ylabel="plane radius |rₒ| / R")
    axes.set_title(title)
    axes.legend()
    save_picture(figure, path, 110)


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
