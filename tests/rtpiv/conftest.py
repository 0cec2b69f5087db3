"""What tests of verbs and of the analysis share.

**Pictures** took half of the time of every test that writes a page. Where a test looks at them, or is the one that
draws some, it is marked ``draws``; in all others a figure is made with its data and words, and one pixel stands
for it. The marked tests together draw every picture of every page.
"""

import base64
from contextlib import contextmanager

import pytest

from rtpiv.analysis.pictures import saved
from rtpiv.analysis.report import page, pair
from tests.watched_benches import witnesses  # noqa: F401 - a fixture

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)
EMPTY = {"png": PIXEL, "svg": b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'}


def _not_drawn(figure, kinds):
    return {kind: EMPTY[kind] for kind in kinds}


def _not_written(figure, stream, dpi):
    stream.write(PIXEL)


DRAWING = {
    (page, "_render_figure"): (page._render_figure, _not_drawn),
    (saved, "write_png"): (saved.write_png, _not_written),
}


def _draw(here):
    for (module, name), (drawn, not_drawn) in DRAWING.items():
        setattr(module, name, drawn if here else not_drawn)
    pair._drawn.clear()


@pytest.hookimpl(tryfirst=True)  # before fixtures, which draw as well
def pytest_runtest_setup(item):
    _draw(item.get_closest_marker("draws") is not None)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item):
    _draw(True)


@contextmanager
def undrawn():
    """Draw no picture within a test that draws, where the same kinds of pictures are drawn once more."""
    _draw(False)
    try:
        yield
    finally:
        _draw(True)


@pytest.fixture
def no_mean_page(monkeypatch):
    """No page with its pictures, two thirds of what a small mean takes, where a test looks at numbers alone."""
    monkeypatch.setattr("rtpiv.analysis.report.mean.write_mean_page", lambda *given: None)
