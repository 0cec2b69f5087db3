"""Pictures are drawn once, to the pixels that matplotlib itself would save."""

import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import AxesImage
from PIL import Image

from rtpiv.analysis.pictures.plane_axes import Figure
from rtpiv.analysis.pictures.saved import lay_out, save_picture


def figure_with_picture():
    figure = Figure(figsize=(3.0, 2.0), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(np.arange(600.0).reshape(20, 30))
    axes.set_title("a title")
    return figure


@pytest.mark.draws
def test_the_same_pixels_drawn_once(tmp_path, monkeypatch):
    plain, stream = figure_with_picture(), io.BytesIO()
    FigureCanvasAgg(plain)
    lay_out(plain, 90)
    plain.savefig(stream, format="png", dpi=90)
    drawn, draw = [], AxesImage.draw
    monkeypatch.setattr(AxesImage, "draw", lambda *arguments: (drawn.append(1), draw(*arguments))[1])
    save_picture(figure_with_picture(), tmp_path / "picture.png", 90)
    assert len(drawn) == 1
    ours, theirs = Image.open(tmp_path / "picture.png"), Image.open(stream)
    assert np.array_equal(np.asarray(ours), np.asarray(theirs))
    assert ours.info["dpi"] == theirs.info["dpi"]
