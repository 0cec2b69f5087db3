"""Figures, and their axes on the plane: outlines of bodies, colour bars as tall as what they belong to.

All who draw take `Figure` from here; nothing else waits for matplotlib.
"""

import textwrap
from collections.abc import Iterable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure as Figure
from matplotlib.ticker import AutoLocator, MaxNLocator
from numpy.typing import NDArray

from rtpiv.analysis.pictures.saved import short
from tracer.bodies import Body
from tracer.scene.scene import Scene

matplotlib.rcParams["text.parse_math"] = False  # a $ in the name of a file or body begins no formula


INK, SOFT, NOTHING = "#1d2433", "#5c667a", "#d9dee8"
MOST_NAMES = 12
ROUND_STEPS = 72
LETTER_IN, LEAST_LETTERS = 0.085, 12  # of a label of 10 points; what a line holds at least
TICK_IN = 0.28  # apart, so that numbers do not touch
BEYOND_IN = 0.4  # that a label may be taller than its bar
FEW_DECADES = 1000.0  # from the lowest to the highest: with more of them there is no room for labels between

Floats = NDArray[np.float64]


def colour_bar(shown: ScalarMappable, axes: Axes, label: str, extend: str = "neither") -> Colorbar:
    """Add a colour bar exactly as tall as the axes are, its label in lines that are no longer than it is tall."""
    beside = axes.inset_axes((1.03, 0.0, 0.045, 1.0))
    bar = axes.figure.colorbar(shown, cax=beside, extend=extend)
    tall_in = _height_in(axes)
    lines = textwrap.wrap(label, max(LEAST_LETTERS, int((tall_in + BEYOND_IN) / LETTER_IN)))
    bar.set_label("\n".join(lines), fontsize=10.0 if len(lines) < 2 else 8.0, labelpad=4.0 / len(lines))
    if type(bar.locator) is AutoLocator:
        bar.locator = MaxNLocator(min(9, max(2, int(tall_in / TICK_IN))), steps=[1, 2, 2.5, 5, 10])
        bar.update_ticks()
    bar.outline.set_visible(False)
    return bar


def log_scale(axis: Axis, base: float = 10.0) -> None:
    """Make an axis logarithmic, or leave it linear where nothing positive is drawn, which Matplotlib refuses.

    Decades, and 2 and 5 between few, have plain numbers as labels: formulas would take longer than the curves.
    """
    if not 0.0 < axis.get_minpos() < np.inf:
        return
    set_scale = axis.axes.set_xscale if axis is axis.axes.xaxis else axis.axes.set_yscale
    set_scale("log", base=base)
    axis.set_major_formatter("{x:g}")
    low, high = axis.get_view_interval()
    between = "25" if high < FEW_DECADES * low else ""
    axis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in between else "")


def _height_in(axes: Axes) -> float:
    """Return the height of a picture in inches: its panel, or less where it keeps its shape within that."""
    assert isinstance(axes.figure, Figure)  # nothing here has figures within figures
    place, (wide, tall) = axes.get_position(), axes.figure.get_size_inches()
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    of_panel = float(tall * place.height)
    if axes.get_aspect() == "auto" or left == right:
        return of_panel
    return min(of_panel, float(wide * place.width * abs((high - low) / (right - left))))


def outline_mm(body: Body, pinhole_mm: Iterable[float]) -> Floats | None:
    """Outline (N, 2) [mm] that a body throws on the plane from the pinhole; None if it reaches beyond any frame.

    Rays that touch a sphere of radius R at distance d open a cone of half angle asin(R / d); the outline of a
    body is the hull of those of the points around which it lies.
    """
    import cv2

    pinhole, (ends, radius) = np.array(list(pinhole_mm)), body.outline_mm
    to_ends = np.asarray(ends) - pinhole
    distances = np.linalg.norm(to_ends, axis=1)
    if (distances <= radius).any():  # the camera is in it
        return None
    axes = to_ends / distances[:, None]
    ways = axes[:, None]
    if radius > 0.0:
        side = np.cross(axes, np.where(np.abs(axes[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        angle, sine = np.linspace(0.0, 2.0 * np.pi, ROUND_STEPS, endpoint=False)[:, None], radius / distances
        around = np.cos(angle) * side[:, None] + np.sin(angle) * np.cross(axes, side)[:, None]
        ways = np.sqrt(1.0 - sine * sine)[:, None, None] * axes[:, None] + sine[:, None, None] * around
    ways = ways.reshape(-1, 3)
    if (ways[:, 2] > -1e-3).any():
        return None
    found = (pinhole - pinhole[2] / ways[:, 2:] * ways)[:, :2]
    hull = cv2.convexHull(found.astype(np.float32))
    return np.asarray(hull[:, 0], dtype=np.float64)


def draw_outlines(axes: Axes, scene: Scene, names: bool = True) -> None:
    """Draw what each body throws on the plane as one artist; opaque ones with a broken line."""
    outlines = [(body, outline_mm(body, scene.camera.position_mm)) for body in scene.seen]
    known = [(body, outline) for body, outline in outlines if outline is not None]
    if not known:
        return
    styles = ["-" if body.media else "--" for body, _ in known]
    edges = PolyCollection(
        [outline for _, outline in known], facecolors="none", edgecolors=INK, linewidths=0.8, linestyles=styles
    )
    axes.add_collection(edges, autolim=False)
    for body, outline in known[:MOST_NAMES] if names else ():
        x, y = 0.5 * (outline[:, 0].min() + outline[:, 0].max()), outline[:, 1].max()
        name = axes.annotate(
            short(body.name),
            (x, y),
            (0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=INK,
            parse_math=False,
            annotation_clip=True,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.75, "linewidth": 0},
        )
        name.set_in_layout(False)


def plane_panels(
    ratio: float,
    count: int = 1,
    columns: int = 1,
    width_in: float = 4.2,
    beyond_in: tuple[float, float] = (0.0, 0.0),
) -> tuple[Figure, list[Axes]]:
    """A figure of panels of one fixed shape with room for labels and a colour bar at each.

    A layout engine does not know how wide a picture of fixed aspect will be, and cuts the label of its bar off.
    It also takes as long as the drawing itself.

    Parameters
    ----------
    ratio : float
        Height of a panel over its width.
    count, columns : int
        Panels, and how many stand beside each other.
    width_in : float
        Width of a panel in inches; a tall one is narrower.
    beyond_in : (float, float)
        Room below and above all panels in inches, for a legend and a title.
    """
    wide = width_in / max(1.0, ratio)
    tall = max(wide * ratio, 0.3 * wide)
    left, right, below, above = 0.8, 1.4, 0.6, 0.3
    rows = -(-count // columns)
    width, height = columns * (left + wide + right), rows * (below + tall + above) + sum(beyond_in)
    figure = Figure(figsize=(width, height))
    panels = []
    for number in range(count):
        row, column = divmod(number, columns)
        x, y = (
            column * (left + wide + right) + left,
            height - (row + 1) * (below + tall + above) + below - beyond_in[1],
        )
        panels.append(add_axes_in(figure, x, y, wide, tall))
        bare(panels[-1])
    return figure, panels


def bare_figure(width_in: float, height_in: float, above_in: float = 0.25) -> tuple[Figure, Axes]:
    """A figure with one pair of axes, without frame, with room for labels and, `above_in`, for a title."""
    figure = Figure(figsize=(width_in, height_in))
    axes = add_axes_in(figure, 0.85, 0.5, width_in - 1.0, height_in - 0.5 - above_in)
    bare(axes)
    return figure, axes


def add_axes_in(figure: Figure, x: float, y: float, wide: float, tall: float) -> Axes:
    """Add axes to a figure: their lower left corner and size in inches."""
    width, height = figure.get_size_inches()
    return figure.add_axes((x / width, y / height, wide / width, tall / height))


def bare(axes: Axes) -> None:
    """Take the frame of axes away but for two quiet sides."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(SOFT)
    axes.tick_params(color=SOFT, labelcolor=INK)
