"""Bells of layers against particles that the simulator draws at their heights."""

import numpy as np
import pytest

from correction.light_sheet.double_views import ACROSS, double_views
from correction.light_sheet.layers import ROOM, layers
from sim.flow.view import ParticleView
from tests.correction.light_sheet.particle_frames import camera
from tests.slow_cases import slow
from tracer.strategies.sensitivity import TargetPose, landings

SHARP_PX2 = 1e-8
TRIED = 40


@pytest.fixture(scope="module")
def seen():
    scene = camera("three_spheres_500", 252).scene
    views = double_views(scene, step=2)
    chosen = np.random.default_rng(2).choice(len(views.kind), TRIED, replace=False)
    return scene, views.at(chosen)


@pytest.mark.parametrize("number", [slow(0), 17, slow(40)])
def test_middles_lie_where_the_simulator_draws_them(seen, number):
    scene, views = seen
    bells = layers(scene, views, 0.5, SHARP_PX2)
    height = float(bells.height_mm[number])
    view = ParticleView(scene, (-0.6, 0.6), step_px=0.5)
    places = landings(scene, views.chief_px[:, 0], TargetPose((0.0, 0.0, height))).point_mm
    shown = np.nonzero(bells.light[:, number] > 0.0)[0]
    off = []
    for one in shown:
        drawn = view.images(np.array([[*places[one], height]]), np.ones(1))[:, :2]
        at = views.chief_px[one, 1] + bells.offset_px[one, number]
        off.append(np.hypot(*(drawn - at).T).min())
    assert len(shown) > 0.8 * TRIED
    assert np.quantile(off, 0.9) < 0.02
    moved = np.hypot(*bells.offset_px[shown, number].T)
    assert np.median(moved) > 0.2 * abs(height)


def test_bells_are_as_bright_as_drawn_in_the_second_view(seen):
    scene, views = seen
    bells = layers(scene, views, 0.5, SHARP_PX2)
    view = ParticleView(scene, (-0.6, 0.6), step_px=0.5)
    middle = len(bells.height_mm) // 2
    both = []
    for one in range(TRIED):
        drawn = view.images(np.array([[*views.place_mm[one], 0.0]]), np.ones(1))
        first, second = (drawn[np.argmin(np.hypot(*(drawn[:, :2] - views.chief_px[one, k]).T)), 2] for k in (0, 1))
        both.append((bells.light[one, middle], first, second))
    light, first, second = np.array(both).T
    rate = landings(scene, views.chief_px[:, 0]).pixel_rate
    expected = second * first * np.abs(np.linalg.det(rate))  # light through the first view, whatever its size
    share = light / expected
    assert np.quantile(np.abs(share / np.median(share) - 1.0), 0.9) < 0.05


def test_a_plane_of_lags_has_its_peak_where_the_height_moves_it(seen):
    scene, views = seen
    one = views.at(np.array([0]))
    bells = layers(scene, one, 0.5, 0.7)
    plane = bells.planes(one, one.units(), np.zeros(1, np.int64), 8)[0]
    middle = len(bells.height_mm) // 2
    for number in (middle - 10, middle, middle + 10):
        row, column = np.unravel_index(plane[number].argmax(), plane[number].shape)
        wanted = bells.height_mm[number] * one.parallax[0] / one.pitch_mm / one.units()[0, 0]
        assert abs(row - 8 - wanted) < 0.8
        assert abs(column - ACROSS - ROOM) <= 1
