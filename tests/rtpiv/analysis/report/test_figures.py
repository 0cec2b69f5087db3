"""Pictures of vectors: an outlier does not cross them, arrows stand out from their ground, u and v apart."""

import matplotlib.quiver
import numpy as np
import pytest

from correction.evaluate.regions import Scatter
from correction.grid import PlaneGrid
from rtpiv.analysis.report.figures import GROUND, INK, MAX_ARROW, error_histogram, radius_figure, vector_figure
from tests.correction.evaluate.vectors import uniform_field
from tests.rtpiv.analysis.test_plane_share import scene_of


def luminance(rgb):
    """Relative luminance of sRGB colours (..., 3), as WCAG 2 has it."""
    rgb = np.asarray(rgb)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear @ (0.2126, 0.7152, 0.0722)


def arrows(figure):
    (quiver,) = [item for item in figure.axes[0].collections if isinstance(item, matplotlib.quiver.Quiver)]
    return quiver, np.hypot(quiver.U, quiver.V) / quiver.scale


def drawn(outliers):
    field = uniform_field((400, 400), (3.0, -2.0))
    for row, column in outliers:
        field.u_px[row, column] += 50.0
    grid = PlaneGrid((-40.0, 40.0), 0.2, (400, 400))
    return vector_figure(field, grid, scene_of(), np.hypot(field.u_px, field.v_px), "displacement [px]")


def test_a_vector_is_drawn_where_it_was_measured():
    """Column 100 and row 260 of this image are x = -40 + 20 mm and y = 40 - 52 mm."""
    field = uniform_field((400, 400), (3.0, -2.0))
    grid = PlaneGrid((-40.0, 40.0), 0.2, (400, 400))
    row, column = int(np.argmin(np.abs(field.y_px - 260.0))), int(np.argmin(np.abs(field.x_px - 100.0)))
    x_mm, y_mm = -40.0 + 0.2 * field.x_px[column], 40.0 - 0.2 * field.y_px[row]
    colour = np.zeros(field.flags.shape)
    colour[row, column] = 1.0
    figure = vector_figure(field, grid, scene_of(), colour, "displacement [px]")
    axes = figure.axes[0]
    left, right, low, high = axes.images[0].get_extent()
    shown = np.asarray(axes.images[0].get_array())
    (seen_row,), (seen_column,) = np.nonzero(shown.max(axis=1)), np.nonzero(shown.max(axis=0))
    assert left + (seen_column + 0.5) * (right - left) / shown.shape[1] == pytest.approx(x_mm, abs=1e-9)
    assert high - (seen_row + 0.5) * (high - low) / shown.shape[0] == pytest.approx(y_mm, abs=1e-9)
    assert axes.get_xlim() == pytest.approx((left, right))
    assert axes.get_ylim() == pytest.approx((low, high))
    places = np.asarray(arrows(figure)[0].XY)
    lone = np.hypot(*(places - (x_mm, y_mm)).T)
    assert lone.min() <= 0.2 * field.step_px


def test_an_outlier_of_50_px_does_not_cross_the_picture():
    _, usual = arrows(drawn([]))
    shape = usual.shape
    some = [(row, column) for row in range(49) for column in range(49) if (row * 49 + column) % 300 == 151]
    figure = drawn(some)
    _, lengths = arrows(figure)
    assert lengths.shape == shape
    assert lengths.max() <= 1.001 * MAX_ARROW * np.median(lengths)
    assert np.median(lengths) == pytest.approx(np.median(usual), rel=0.01)
    if (lengths > 1.5 * np.median(lengths)).any():
        assert "clipped" in figure.axes[0].get_title(loc="right")


def test_an_outlier_among_the_drawn_arrows_is_named():
    figure = drawn([(1, 1)])
    _, lengths = arrows(figure)
    assert lengths.max() == pytest.approx(MAX_ARROW * np.median(lengths), rel=1e-6)
    assert figure.axes[0].get_title(loc="right").startswith("1 vector clipped")


def test_arrows_are_dark_on_a_ground_that_never_is():
    ink = luminance([int(INK[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    ground = luminance(GROUND(np.linspace(0.0, 1.0, 64))[:, :3])
    assert ((ground + 0.05) / (ink + 0.05)).min() > 4.0


@pytest.mark.parametrize("size", [(400, 400), (160, 600), (600, 160)])
def test_labels_of_a_picture_are_not_cut_off(size):
    field = uniform_field(size, (3.0, -2.0))
    grid = PlaneGrid((-40.0, 40.0), 0.2, size)
    figure = vector_figure(field, grid, scene_of(), 0.012 * np.ones(field.flags.shape), "true error [px]")
    figure.draw_without_rendering()
    whole, (picture, bar) = (
        figure.bbox,
        (axes.get_tightbbox() for axes in (figure.axes[0], figure.axes[0].child_axes[0])),
    )
    for box in (picture, bar):
        assert box.x0 >= 0.0
        assert box.y0 >= 0.0
        assert box.x1 <= whole.x1
        assert box.y1 <= whole.y1


def test_nothing_measured_is_drawn_all_the_same():
    field = uniform_field((400, 400), (3.0, -2.0))
    field.flags[:] = 1
    grid = PlaneGrid((-40.0, 40.0), 0.2, (400, 400))
    vector_figure(field, grid, scene_of(), np.full(field.flags.shape, np.nan), "x").draw_without_rendering()


def test_u_and_v_have_a_panel_each():
    errors = {"behind glass": np.random.default_rng(0).normal((0.01, -0.02), 0.005, (300, 2))}
    one, other = error_histogram(errors).axes
    assert (one.get_title(), other.get_title()) == ("u, to the right", "v, down")
    rings = {(0.0, 0.1): Scatter(9, (0.01, 0.0), (0.0, 0.03), (0.02, 0.02))}
    one, other = radius_figure(rings).axes[:2]
    assert [float(axes.lines[0].get_ydata()[0]) for axes in (one, other)] == pytest.approx([0.01, 0.03])
