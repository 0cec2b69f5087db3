"""Colour bars of pictures of any shape: an oblong sensor leaves little room, and nothing may be cut off there."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from rtpiv.analysis.pictures.plane_axes import colour_bar, plane_panels
from tests.loops import loop_over

LABELS = ("speed [m/s]", "difference from the known shift [px]", "sigma by the flow through the sheet [m/s]")
RATIOS, HIGHEST = (0.15, 0.375, 1.0, 3.0), (0.0035, 0.9, 120.0)
CASES = [  # every shape with every label, and with every range
    (ratio, label, HIGHEST[(row + column) % 3])
    for row, ratio in enumerate(RATIOS)
    for column, label in enumerate(LABELS)
]


@pytest.mark.slow
@loop_over("ratio, label, highest", CASES)
def test_no_label_is_cut_off_and_no_number_touches_another(ratio, label, highest):
    figure, (axes,) = plane_panels(ratio)
    FigureCanvasAgg(figure)
    extent = (0.0, 40.0, 0.0, 40.0 * ratio)
    shown = axes.imshow(np.linspace(0.0, highest, 90).reshape(9, 10), extent=extent)
    axes.set(aspect="equal", xlim=extent[:2], ylim=extent[2:])
    bar = colour_bar(shown, axes, label, "max")
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    box = bar.ax.yaxis.label.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= width
    assert 0 <= box.y0 < box.y1 <= height
    low, high = bar.ax.get_ylim()
    numbers = [
        text.get_window_extent()
        for text, value in zip(bar.ax.get_yticklabels(), bar.get_ticks(), strict=True)
        if low <= value <= high
    ]
    assert len(numbers) >= 2
    assert all(one.y1 < other.y0 for one, other in pairwise(numbers))
    assert max(number.x1 for number in numbers) <= box.x0 + 1.0
