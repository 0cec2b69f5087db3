"""What a scene shows of the plane: recovered or not and why, and at which magnification."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.patches import Patch

from correction.node_status import MEANING, NodeStatus
from rtpiv.analysis.pictures.canvas import Figure
from rtpiv.analysis.pictures.mask_colours import COLOURS, THROUGH, Colour, mask_picture, web
from rtpiv.analysis.pictures.names import short
from rtpiv.analysis.pictures.plane_axes import NOTHING, bare, colour_bar, draw_outlines
from rtpiv.analysis.pictures.saved import save_picture
from rtpiv.analysis.pictures.shown_plane import ShownPlane
from rtpiv.analysis.plane_share import PlaneShare
from tracer.scene.scene import Scene

SIZES = LinearSegmentedColormap.from_list(  # small is warm: there resolution is lost
    "sizes", ("#a8323e", "#f0b27a", "#f7f5f0", "#5b93c2", "#173f6b")
).with_extremes(bad="#9aa2b1")
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
    figure = Figure(figsize=(12.4, 2.0 + 5.0 * share.size_mm[1] / share.size_mm[0]), layout="constrained")
    FigureCanvasAgg(figure)
    mask, scale = figure.subplots(1, 2)
    x0, y0 = found.grid.origin_mm
    (width, height), half = share.size_mm, 0.5 * found.grid.pitch_mm
    extent = (x0 - half, x0 - half + width, y0 + half - height, y0 + half)
    mask.imshow(colours, extent=extent, interpolation="nearest")
    figure.legend(handles=_swatches(share), loc="outside lower center", ncols=3, frameon=False)
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
        bare(axes)
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
