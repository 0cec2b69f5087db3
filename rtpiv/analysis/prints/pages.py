"""Sheets on paper, at true size: pages of a PDF, with bars that tell afterwards how large the printer made them.

Printers stretch by some 0.1 to 1 %, differently along and across the feed, and many "fit to page" unasked.  So two
bars stand in the margin, one along each side; their lengths as measured on the paper over those drawn are the
scale of the print, in x and y (`correction.target.board_file`).

A printer sets whole dots, and moves every edge to the nearest one, by up to half of 1/600 inch: 21 um, alike for
all corners of a line, which no frame averages out.  So squares are drawn as wide as whole dots (`whole_dots`) and
the sheet lies on the page so that its lines are edges of dots: what is moved then is moved alike.

Shapes are drawn as vectors.  Particles are grey pictures of a resolution at which their Gaussians are smooth; no
vector has such an edge.  A sheet larger than the paper takes several pages, whose tiles meet at the corner marks.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ground.whole_file import whole_file
from rtpiv.analysis.prints.sheets import Bounds, PrintPage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Paper = Literal["A4", "A3", "A2", "letter"]
PAPERS_MM: dict[str, tuple[float, float]] = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "letter": (215.9, 279.4),
}
MARGIN_MM = 16.0  # free of the sheet: bars, words, and what printers cannot reach
EDGE_MM = 6.0  # most printers leave out 4 to 5
BAR_STEP_MM = 10.0
MM = 1.0 / 25.4  # in inches
DOT_MM = 25.4 / 600.0  # of most printers; of finer ones a whole number
# Dots to a standard deviation of a particle: 5e-4 of its contrast lies beyond what dots can show
SMOOTH = 1.25
LEAST_DPI, MOST_DPI = 600.0, 1200.0  # as printers have
HAIR: Any = {"color": "black", "linewidth": 0.4, "solid_capstyle": "butt"}
REACH_SIGMAS = 4.0  # a Gaussian has 3e-4 of its peak there: below one grey level of 256


@dataclass(frozen=True)
class Printed:
    """Written files.

    Parameters
    ----------
    pages : (int, int)
        Columns and rows of pages.
    bars_mm : (float, float)
        Length of the bars along x and y as drawn.
    """

    pages: tuple[int, int]
    bars_mm: tuple[float, float]


def room_on(paper: Paper) -> tuple[float, float]:
    """Width and height [mm] that a sheet may take on one page."""
    width, height = PAPERS_MM[paper]
    return width - 2.0 * MARGIN_MM, height - 2.0 * MARGIN_MM


def whole_dots(length_mm: float) -> float:
    """Return the nearest length [mm] that a printer draws in whole dots, one at least."""
    return round(max(1, round(length_mm / DOT_MM)) * DOT_MM, 9)


def bars_on(paper: Paper) -> tuple[float, float]:
    """Lengths of the bars along x and y [mm]: tens of millimetres that fit the paper."""
    across, up = (BAR_STEP_MM * int((length - 2.0 * EDGE_MM) / BAR_STEP_MM) for length in PAPERS_MM[paper])
    return across, up


def write_pages(path: Path, sheet: PrintPage, paper: Paper, words: str) -> Printed:
    """Write a sheet as PDF, the same bytes for the same sheet.

    Parameters
    ----------
    path : Path
        The file.
    sheet : PrintPage
        What is printed.
    paper : str
        Size of the pages, upright.
    words : str
        What stands below the sheet on each page, such as how it was made.

    Returns
    -------
    Printed
        Number of pages, and what the bars measure.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    width, height = PAPERS_MM[paper]
    room = room_on(paper)
    left, lower, right, upper = sheet.bounds_mm
    columns, rows = (
        max(1, int(np.ceil(size / free - 1e-9)))
        for size, free in zip((right - left, upper - lower), room, strict=True)
    )
    tile = (right - left) / columns, (upper - lower) / rows
    buffer = BytesIO()
    with PdfPages(buffer, metadata={"CreationDate": None, "Creator": "rtpiv", "Producer": None}) as pdf:
        for row in reversed(range(rows)):  # the upper ones first, as one reads
            for column in range(columns):
                x0, y0 = left + column * tile[0], lower + row * tile[1]
                bounds = (x0, y0, x0 + tile[0], y0 + tile[1])
                figure = Figure(figsize=(width * MM, height * MM))
                axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
                middle = _middle(width, x0, bounds[2]), _middle(height, y0, bounds[3])
                axes.set_xlim(middle[0] - 0.5 * width, middle[0] + 0.5 * width)
                axes.set_ylim(middle[1] - 0.5 * height, middle[1] + 0.5 * height)
                axes.set_axis_off()
                _draw(axes, sheet, bounds)
                _frame(axes, bounds, middle, paper, sheet, words, (column + 1, rows - row, columns, rows))
                pdf.savefig(figure)
    with whole_file(path) as stream:
        stream.write(buffer.getvalue())
    return Printed((columns, rows), bars_on(paper))


def _middle(side_mm: float, low_mm: float, high_mm: float) -> float:
    """Return the middle of a page: beside a tile's, so that the origin is whole dots from the edge."""
    origin_mm = 0.5 * (side_mm - low_mm - high_mm)
    return 0.5 * side_mm - DOT_MM * round(origin_mm / DOT_MM)


def _draw(axes: "Axes", sheet: PrintPage, bounds: Bounds) -> None:
    """Draw the part of a sheet within some bounds, as artists without limits of the axes, which take long."""
    from matplotlib.patches import PathPatch, Rectangle
    from matplotlib.path import Path as Outline

    x0, y0, x1, y1 = bounds
    clip = Rectangle((x0, y0), x1 - x0, y1 - y0, transform=axes.transData)
    if len(sheet.particles_mm):
        _draw_particles(axes, sheet, bounds)
        return
    flat = [shape for shape in sheet.polygons if _meets(shape.min(axis=0), shape.max(axis=0), bounds)]
    if flat:
        outline = Outline.make_compound_path(
            *(Outline(np.vstack((shape, shape[:1])), closed=True) for shape in flat)
        )
        axes.add_artist(PathPatch(outline, facecolor="black", linewidth=0.0, clip_path=clip))
    for dark in (True, False):
        discs = [
            Outline.circle((x, y), 0.5 * wide)
            for x, y, wide in sheet.discs[sheet.disc_dark == dark]
            if _meets(np.array([x, y]) - 0.5 * wide, np.array([x, y]) + 0.5 * wide, bounds)
        ]
        if discs:
            ring = Outline.make_compound_path(*discs)
            axes.add_artist(PathPatch(ring, facecolor="black" if dark else "white", linewidth=0.0, clip_path=clip))


def _meets(low: NDArray[np.float64], high: NDArray[np.float64], bounds: Bounds) -> bool:
    x0, y0, x1, y1 = bounds
    return bool(low[0] < x1 and high[0] > x0 and low[1] < y1 and high[1] > y0)


def _draw_particles(axes: "Axes", sheet: PrintPage, bounds: Bounds) -> None:
    """Bright Gaussians on black, where they overlap no brighter than white."""
    x0, y0, x1, y1 = bounds
    sigma_mm = 0.25 * sheet.particle_mm
    dpi = float(np.clip(SMOOTH / (sigma_mm * MM), LEAST_DPI, MOST_DPI))
    per_mm = dpi * MM
    shape = round((y1 - y0) * per_mm), round((x1 - x0) * per_mm)
    reach = int(np.ceil(REACH_SIGMAS * sigma_mm * per_mm))
    around = np.arange(-reach, reach + 1)
    place = (sheet.particles_mm - (x0, y1)) * (per_mm, -per_mm) - 0.5
    near = np.rint(place).astype(np.int64)
    seen = ((near >= -reach) & (near < np.array(shape[::-1]) + reach)).all(axis=1)
    off = (near - place)[seen][:, :, None] + around
    across, down = np.exp(-0.5 * (off / (sigma_mm * per_mm)) ** 2).astype(np.float32).transpose(1, 2, 0)
    picture = np.zeros((shape[0] + 4 * reach, shape[1] + 4 * reach), np.float32)  # room for what lies beyond
    first = (near[seen] + reach) @ (1, picture.shape[1])
    for row, high in enumerate(down):  # all particles at once, a pixel of each at a time
        for column, wide in enumerate(across):
            np.add.at(picture.ravel(), first + (row * picture.shape[1] + column), high * wide)
    within = picture[2 * reach : shape[0] + 2 * reach, 2 * reach : shape[1] + 2 * reach]
    grey = np.rint(255.0 * np.minimum(within, 1.0)).astype(np.uint8)
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=(x0, x1, y0, y1), interpolation="none", aspect="auto")


def _frame(
    axes: "Axes",
    bounds: Bounds,
    middle: tuple[float, float],
    paper: Paper,
    sheet: PrintPage,
    words: str,
    page: tuple[int, int, int, int],
) -> None:
    """Marks at the corners of the tile, the bars, and the words."""
    x0, y0, x1, y1 = bounds
    for x, out_x in ((x0, -1.0), (x1, 1.0)):
        for y, out_y in ((y0, -1.0), (y1, 1.0)):
            axes.plot([x + out_x, x + 4.0 * out_x], [y, y], **HAIR)
            axes.plot([x, x], [y + out_y, y + 4.0 * out_y], **HAIR)
    if x0 <= 0.0 <= x1 and y0 <= 0.0 <= y1:  # where the origin is
        for y, out in ((y0, -1.0), (y1, 1.0)):
            axes.plot([0.0, 0.0], [y + out, y + 3.0 * out], **HAIR)
        for x, out in ((x0, -1.0), (x1, 1.0)):
            axes.plot([x + out, x + 3.0 * out], [0.0, 0.0], **HAIR)
    across, up = bars_on(paper)
    width, height = PAPERS_MM[paper]
    low, left = middle[1] - 0.5 * height + EDGE_MM, middle[0] - 0.5 * width + EDGE_MM
    _bar(axes, (middle[0] - 0.5 * across, low), (across, 0.0), f"x: {across:g} mm")
    _bar(axes, (left, middle[1] - 0.5 * up), (0.0, up), f"y: {up:g} mm")
    where = "" if page[2:] == (1, 1) else f"column {page[0]} of {page[2]}, row {page[1]} of {page[3]}.  "
    text = f"{where}{words}  Print at 100 %, not fitted to the page; measure both bars."
    axes.text(middle[0], y0 - 0.3 * MARGIN_MM, text, ha="center", va="center", fontsize=6.0)
    axes.text(middle[0], y1 + 0.4 * MARGIN_MM, "up", ha="center", va="center", fontsize=7.0)


def _bar(axes: "Axes", start: tuple[float, float], way: tuple[float, float], text: str) -> None:
    """A bar with a cross line at either end; its length is from the middle of one to the middle of the other."""
    (x, y), (dx, dy) = start, way
    axes.plot([x, x + dx], [y, y + dy], **HAIR)
    for end in (0.0, 1.0):
        cx, cy = x + end * dx, y + end * dy
        tick = (1.5, 0.0) if dx == 0.0 else (0.0, 1.5)
        axes.plot([cx - tick[0], cx + tick[0]], [cy - tick[1], cy + tick[1]], **HAIR)
    turned = 90.0 if dx == 0.0 else 0.0
    axes.text(
        x + 0.25 * dx,
        y + 0.25 * dy,
        text,
        ha="center",
        va="center",
        rotation=turned,
        fontsize=6.0,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
