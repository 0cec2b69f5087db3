"""The page: self-contained, escaped, and as wide as the screen that a real browser shows it on."""

import io
import re

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from correction.node_status import NodeStatus
from rtpiv.analysis.pictures.rasters import data_address, grey, mask_picture, tint
from rtpiv.analysis.pictures.saved import lay_out
from rtpiv.analysis.report.page import PNG_DPI, Link, Page, _render_figure
from rtpiv.analysis.report.table import Table
from tests.rtpiv.analysis.report.browser import browse, measured

pytestmark = pytest.mark.draws


def page(twice=True):
    made = Page("run <script>alert(1)</script> & more", "sub <b>", twice)
    picture = grey(np.arange(4800).reshape(60, 80), (0.0, 4800.0))
    made.tiles([("0.01 px", "scatter <i>", "of & from")])
    made.heading("Pictures")
    status = np.where(picture > 40, NodeStatus.RIM, NodeStatus.RECOVERED).astype(np.uint8)
    layers = {"raw": picture, "corrected": tint(picture, status), "mask": mask_picture(status)}
    made.slider([(name, data_address(image)) for name, image in layers.items()], "drag <me>")
    figure = Figure(figsize=(2.0, 1.0))
    figure.add_subplot().plot([0, 1])
    made.figure("line", figure, "a line")
    made.figure("dots", figure, "dots", dense=True)
    columns = ("name", *[f"a rather long heading {k}" for k in range(6)])
    made.table(Table("caption", columns, [("a<b", *"123456")]))
    made.lead("0.01, 0.02 px", Table("total <b>", ("[px]", "u", "v"), [("bias <", "+0.01", "-0.02")]))
    regions = ("behind glass", "0.0011, 0.004", "0.021, 0.021", "3261 of 3263", "2")
    columns = ("region", "map sigma: median, largest [px]", "rms [px]", "corners used", "rejected")
    made.lead("0.0011 px", Table("sigma", columns, [regions]))
    with made.row():
        made.figure("left", figure, "left", dense=True)
        made.figure("right", figure, "right", dense=True)
    made.swatches([("#aabbcc", "hidden <by>", "3 %")])
    made.table(Table("", ("pair", "n"), [(Link("pair <a", "pair <a/report.html"), "1")]))
    made.links([Link("vectors.nc", "vectors.nc")])
    made.facts([("key <", "value >" + 200 * "x")])
    made.details("file", "a: <1>\n" + 300 * "y")
    made.text("plain & simple")
    return made


def test_nothing_is_fetched_and_everything_is_escaped():
    text = page().html()
    assert "<script" not in text
    assert "<b>sub" not in text
    for words in (
        "a&lt;b",
        "drag &lt;me&gt;",
        "scatter &lt;i&gt;",
        "key &lt;",
        "a: &lt;1&gt;",
        "plain &amp; simple",
        "total &lt;b&gt;",
        "bias &lt;",
        "hidden &lt;by&gt;",
        ">pair &lt;a</a>",
    ):
        assert words in text
    assert not re.findall(r"""src\s*=\s*["'](?!data:)""", text)
    assert re.findall(r"""href\s*=\s*["']([^"']*)""", text) == ["pair%20%3Ca/report.html", "vectors.nc"]
    assert "url(" not in text
    assert "@import" not in text
    assert "viewport" in text


def test_figures_are_drawn_as_they_stand_in_the_page_unless_somebody_wants_both(tmp_path):
    page(twice=False).write(tmp_path / "report.html")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"report.html", "line.svg", "dots.png", "left.png", "right.png"}


def test_pages_and_figures_are_written_whole_or_not_at_all(tmp_path, mocker):
    page().write(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().endswith("</html>\n")
    names = {path.name for path in tmp_path.iterdir()}
    figures = {f"{name}.{kind}" for name in ("line", "dots", "left", "right") for kind in ("svg", "png")}
    assert names == {"report.html"} | figures
    assert (tmp_path / "line.png").read_bytes().startswith(b"\x89PNG")
    mocker.patch("os.fsync", side_effect=OSError(28, "No space left on device"))
    with pytest.raises(OSError, match="No space"):
        page().write(tmp_path / "other.html")
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.parametrize("width", [390, 1400])
def test_a_browser_shows_it(tmp_path, width):
    """No sideways scrolling, every picture loads, the line moves, and the mask comes up when asked for."""
    seen = measured(page().html(), tmp_path, width)
    assert seen["inside"] == width
    assert seen["needed"] <= width
    assert seen["loaded"]
    assert "20%" in seen["clip"]
    assert seen["mask"] == "block"


def test_it_prints(tmp_path):
    page().write(tmp_path / "report.html")
    browse(tmp_path / "report.html", tmp_path, f"--print-to-pdf={tmp_path / 'p.pdf'}", "--no-pdf-header-footer")
    assert (tmp_path / "p.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("kinds", [("svg",), ("svg", "png")])
def test_a_figure_of_lines_is_drawn_once_each_kind_and_as_matplotlib_saves_it(kinds, monkeypatch):
    def made():
        figure = Figure(figsize=(3.0, 2.0), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([0.0, 2.0, 1.0], label="a line")
        axes.set(title="a title", xlabel="x", ylabel="y")
        axes.legend()
        return figure

    with matplotlib.rc_context({"svg.hashsalt": "the same"}):
        plain, stream = made(), io.BytesIO()
        FigureCanvasAgg(plain)
        lay_out(plain, PNG_DPI)
        plain.savefig(stream, format="svg", dpi=PNG_DPI, metadata={"Date": None})
        drawn, draw = [], Figure.draw
        monkeypatch.setattr(Figure, "draw", lambda *arguments: (drawn.append(1), draw(*arguments))[1])
        ours = _render_figure(made(), kinds)["svg"]
    assert ours == stream.getvalue()
    assert len(drawn) == len(kinds)
