"""The figure of the slant: what views of known slopes have, in the terminal and as a picture."""

import cv2
import numpy as np
import pytest

from correction.grid import grid_of
from correction.maps.correction_map import build_correction_map
from piv.statistics.out_of_plane import OutOfPlane
from rtpiv.analysis.pictures.traced import draw_slant
from rtpiv.analysis.report.page import Page
from rtpiv.analysis.report.pair import slant_figure, slant_lines
from rtpiv.analysis.steepness import ShownSlant, Steepness
from rtpiv.verbs.trace import trace
from tests.correction.evaluate.vectors import uniform_field
from tests.correction.small_scenes import small_scene
from tracer.strategies.ray_map import build_ray_map


def test_figures_are_of_their_regions():
    slopes = np.full((10, 10, 2), np.nan)
    slopes[:5, :, 0], slopes[:5, :, 1] = 0.3, -0.4
    slopes[5:, :, 0], slopes[5:, :, 1] = np.linspace(0.0, 0.09, 10), 0.0
    slopes[0, 0] = np.nan
    behind = np.arange(10)[:, None] < np.full(10, 5)
    found = Steepness.of(slopes, behind, ~behind)
    assert found.behind == pytest.approx((0.5, 0.5))
    assert found.beside == pytest.approx((0.045, 0.081), abs=0.005)
    assert "0.50 m/s behind glass (0.50 at 90 % of the places)" in found.sentence
    assert Steepness.of(slopes, np.zeros_like(behind), behind).behind is None
    assert Steepness(None, None).sentence == ""


@pytest.mark.draws
def test_two_balls_are_as_steep_as_by_another_tracer(tmp_path, capsys):
    """0.31 in the median behind them, 0.03 beside: found when nothing here said it yet, with other optics."""
    scene = small_scene("two_spheres_500", 252)
    found = build_correction_map(scene, build_ray_map(scene))
    shown = ShownSlant.of(found, scene)
    median, most = shown.steepness.behind
    assert median == pytest.approx(0.31, abs=0.03)
    assert most == pytest.approx(0.35, abs=0.03)
    draw_slant(tmp_path / "slant.png", scene, found.grid, shown)
    traced = trace(scene, pictures=False)
    assert traced.steepness.behind == pytest.approx((median, most))
    assert 0.03 < traced.steepness.beside[0] < 0.2
    assert "oblique view" in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / "slant.png"))
    assert picture is not None
    assert picture.std() > 10.0


def test_a_page_says_it_and_shows_what_it_makes_unsure(tmp_path):
    scene = small_scene("two_spheres_500", 252)
    grid, field = grid_of(scene.camera), uniform_field((252, 252), (3.0, 1.0), step_px=16)
    page = Page("a pair", "test")
    slant_lines(page, Steepness((0.31, 0.35), None), OutOfPlane(0.2).sentence)
    slant_figure(page, field, grid, scene, np.full(field.flags.shape, 0.07), "px")
    page.write(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "0.31 m/s behind glass (0.35 at 90 % of the places)" in text
    assert "0.2 m/s (given)" in text
    assert "Uncertainty from oblique viewing" in text
