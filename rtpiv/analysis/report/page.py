"""One self-contained HTML page: pictures, figures and tables that go straight into a lab book.

No script or style comes from anywhere else, and everything is embedded, so the page can be mailed and will look
the same in ten years; only links lead to files beside it.  Every text that came from a file or a name is escaped.
Figures are also written beside the page as they stand in it.  Who wants all of them as SVG for papers and PNG for
slides says so: drawing them twice takes longer than measuring what they show.

Every page begins with how much of what the balls hide is seen through them, and what would show more.
"""

import base64
import html
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from ground.printable import utf8
from ground.whole_file import whole_file
from rtpiv.analysis.gaps import Gaps
from rtpiv.analysis.pictures.saved import lay_out, write_png
from rtpiv.analysis.report.table import Table
from rtpiv.analysis.through_glass import ThroughGlass, percent
from rtpiv.analysis.views.arranged import little
from tracer.scene.scene import Scene

if TYPE_CHECKING:
    from rtpiv.analysis.pictures.plane_axes import Figure

Drawn = dict[str, bytes]  # a figure by the kind of its file, "svg" or "png"
PNG_DPI = 170
LONG_TABLE = 12  # rows: balls of a bed, parameters of their fit

_STYLE = Path(__file__).with_name("page.css")


@dataclass(frozen=True)
class Link:
    """Text that leads to a file in the page's folder or below it; `path` is relative to that, with slashes."""

    text: str
    path: str

    def __str__(self) -> str:
        return self.text

    @property
    def html(self) -> str:
        """Return it as it stands in a page."""
        return f'<a href="{html.escape(quote(self.path))}">{html.escape(self.text)}</a>'


class Page:
    """A page that grows chapter by chapter.

    Parameters
    ----------
    title, subtitle : str
        Heading, and what stands under it.
    twice : bool
        Write every figure as SVG and as PNG.
    """

    def __init__(self, title: str, subtitle: str = "", twice: bool = False) -> None:
        self._title, self._subtitle, self.twice = title, subtitle, twice
        self._parts: list[str] = []
        self._files: dict[str, bytes] = {}
        self._sliders = 0

    def heading(self, text: str) -> None:
        """Start a chapter."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def warning(self, text: str) -> None:
        """Add a paragraph that stands out."""
        self._parts.append(f'<p class="warning">{html.escape(text)}</p>')

    def lead(self, value: str, parts: Table) -> None:
        """Add the most important value, with the table of its parts, whose title names the value."""
        self._parts.append(
            f'<div class="lead"><div><b>{html.escape(value)}</b><span>{html.escape(parts.title)}</span></div>'
            f"{_cells(parts)}</div>"
        )

    @contextmanager
    def row(self) -> Iterator[None]:
        """Set what is added within side by side, where the screen is wide enough."""
        self._parts.append('<div class="row">')
        yield
        self._parts.append("</div>")

    def links(self, links: Sequence[Link]) -> None:
        """Add a line of links to files in the page's folder."""
        inner = "".join(f"<li>{link.html}</li>" for link in links)
        self._parts.append(f'<ul class="links">{inner}</ul>')

    def tiles(self, tiles: Sequence[tuple[str, str, str]]) -> None:
        """Add the figures that matter most, large: (value, what it is, what it is measured against)."""
        inner = "".join(
            f"<div><b>{html.escape(value)}</b><span>{html.escape(name)}</span><small>{html.escape(rest)}</small></div>"
            for value, name, rest in tiles
        )
        self._parts.append(f'<div class="tiles">{inner}</div>')

    def table(self, table: Table) -> None:
        """Add a table; a long one opens on a click on its title."""
        if len(table.rows) > LONG_TABLE and table.title:
            title = f"<summary>{html.escape(table.title)} ({len(table.rows)} rows)</summary>"
            self._parts.append(f'<details>{title}<div class="wide" tabindex="0">{_cells(table)}</div></details>')
            return
        title = f"<figcaption>{html.escape(table.title)}</figcaption>" if table.title else ""
        inner = f'<div class="wide" tabindex="0">{_cells(table)}</div>'
        self._parts.append(f'<figure class="table">{title}{inner}</figure>')

    def facts(self, rows: Sequence[tuple[str, str]]) -> None:
        """Add names and what they stand for."""
        inner = "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in rows)
        self._parts.append(f"<dl>{inner}</dl>")

    def details(self, name: str, text: str) -> None:
        """Add a long text, such as a file, that opens on a click."""
        self._parts.append(
            f"<details><summary>{html.escape(name)}</summary><pre>{html.escape(text)}</pre></details>"
        )

    def figure(self, name: str, figure: "Figure | Drawn", caption: str, dense: bool = False) -> None:
        """Add a figure; `write` also puts NAME.svg or NAME.png beside the page, or both.

        Parameters
        ----------
        name : str
            Of the files, once a page.
        figure : Figure or dict
            What was drawn, or its files as `render_figure` makes them.
        caption : str
            Said below.
        dense : bool
            Embed pixels: thousands of arrows as lines would make the page slow.
        """
        kind, mime = ("png", "image/png") if dense else ("svg", "image/svg+xml")
        drawn = figure if isinstance(figure, dict) else render_figure(figure, self.twice, dense)
        self._files |= {f"{name}.{each}": content for each, content in drawn.items()}
        data = base64.b64encode(self._files[f"{name}.{kind}"]).decode()
        self._parts.append(
            _figure_html(f'<img alt="{html.escape(caption)}" src="data:{mime};base64,{data}">', caption)
        )

    def slider(self, layers: Sequence[tuple[str, str]], caption: str) -> None:
        """Lay pictures of one shape over each other: a line to drag uncovers one beside the next.

        Parameters
        ----------
        layers : sequence of (name, data address)
            Two or more, see `rtpiv.analysis.pictures.rasters`; neighbours in the order in which they are
            compared.
        caption : str
            Said below.
        """
        self._sliders += 1
        name = f"slider{self._sliders}"
        pictures = "".join(
            f'<div class="layer"><img alt="{html.escape(title)}" src="{address}"><i>{html.escape(title)}</i></div>'
            for title, address in layers
        )
        choices = "".join(
            f'<label><input type="radio" name="{name}" {"checked" if k == 0 else ""} '
            f"onchange=\"this.closest('.slider').dataset.pair={k}\">"
            f"{html.escape(layers[k][0])} | {html.escape(layers[k + 1][0])}</label>"
            for k in range(len(layers) - 1)
        )
        self._parts.append(
            f'<figure class="slider" data-pair="0">'
            f'<div class="choice">{choices if len(layers) > 2 else ""}</div><div class="stage">{pictures}<hr>'
            '<input type="range" min="0" max="100" value="50" aria-label="uncover" '
            "oninput=\"this.parentNode.style.setProperty('--cut',this.value+'%')\"></div>"
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )

    def swatches(self, rows: Sequence[tuple[str, str, str]]) -> None:
        """Add a legend: (colour as #rrggbb, what it means, a figure)."""
        inner = "".join(
            f'<li><i style="background:{html.escape(colour)}"></i>{html.escape(name)} <b>{html.escape(value)}</b>'
            for colour, name, value in rows
        )
        self._parts.append(f'<ul class="swatches">{inner}</ul>')

    def html(self) -> str:
        """Return the whole page."""
        title, style = html.escape(self._title), _STYLE.read_text(encoding="utf-8")
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>{title}</title><style>{style}</style></head><body>"
            f"<header><h1>{title}</h1><p>{html.escape(self._subtitle)}</p></header>"
            + "".join(self._parts)
            + "</body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Write the page and its figures, each atomically, the page last."""
        for name, content in (*self._files.items(), (path.name, utf8(self.html()))):
            with whole_file(path.with_name(name)) as stream:
                stream.write(content)


def _cells(table: Table) -> str:
    top = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _cell(cell: str | Link) -> str:
    return cell.html if isinstance(cell, Link) else html.escape(cell)


def _figure_html(inner: str, caption: str) -> str:
    return f"<figure>{inner}<figcaption>{html.escape(caption)}</figcaption></figure>"


def render_figure(figure: "Figure", twice: bool, dense: bool = False) -> Drawn:
    """Bytes of a figure by kind: PNG if it is `dense`, else SVG, `twice` both."""
    return _render_figure(figure, ("svg", "png") if twice else ("png" if dense else "svg",))


def _render_figure(figure: "Figure", kinds: Sequence[str]) -> Drawn:
    """Bytes of a figure as SVG, as PNG or as both; `savefig` draws an SVG twice as well."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    found = {}
    for kind in kinds:
        buffer = io.BytesIO()
        if kind == "png":
            write_png(figure, buffer, PNG_DPI)
        else:
            FigureCanvasAgg(figure)
            lay_out(figure, PNG_DPI)
            canvas: Any = FigureCanvasSVG(figure)
            canvas.print_svg(buffer, metadata={"Date": None})
        found[kind] = buffer.getvalue()
    return found


def behind_glass(scene: Scene) -> str:
    """Return the part of a title that names the glass; "" where nothing stands before the camera."""
    return " through glass" if scene.bodies else ""


def through_lead(page: Page, through: ThroughGlass | Gaps | None, scene: Scene, recovered: float) -> None:
    """Begin a page with the share seen through glass, or inside a bed that of the gaps which is lit and seen.

    Parameters
    ----------
    page : Page
        Grows.
    through : ThroughGlass, Gaps or None
        The share; without balls before the plane there is nothing to say.
    scene : Scene
        What is asked for what would show more.
    recovered : float
        Share of the whole corrected frame that is recovered.
    """
    if through is None:
        return
    if isinstance(through, Gaps):
        share, name = through.first
        parts = [("gas between the balls", f"{through.gas_mm2:.4g} mm\u00b2")]
        if through.lit is not None:
            parts.append(("lit", percent(through.lit.lit_mm2 / through.gas_mm2)))
        parts += [("seen", percent(through.share)), ("glass, of the whole plane", percent(through.glass))]
        page.lead(percent(share), Table(name, ("inside a bed", ""), parts))
        return
    rows = [
        (f"hidden by {through.what}", f"{through.hidden_mm2:.4g} mm\u00b2"),
        ("recovered of it", f"{through.recovered_mm2:.4g} mm\u00b2"),
        ("recovered of the whole plane", percent(recovered)),
    ]
    name = f"{through.name} is seen through glass"
    page.lead(percent(through.share), Table(name, ("area of the plane", ""), rows))
    if advice := little(scene, through):
        page.warning(advice)
