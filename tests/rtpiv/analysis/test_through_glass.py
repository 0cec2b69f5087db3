"""The share of what balls hide that is recovered, against cones that geometry knows and nodes asked one by one."""

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from rtpiv.analysis.kernels.behind import mark_behind
from rtpiv.analysis.through_glass import (
    ThroughGlass,
    behind,
    coarse_map,
    coarse_share,
    hiding,
    percent,
    through_glass,
    through_scene,
)
from rtpiv.analysis.views.field_of_view import field_of_view
from tests.rtpiv.analysis.test_plane_share import GLASS, cone_area_mm2, scene_of
from tracer.bodies import Rod, Sphere, Window
from tracer.strategies.ray_map import build_ray_map


def shown(scene):
    found = build_correction_map(scene, build_ray_map(scene))
    return through_glass(scene, found.grid, found.recovered), found


def stopped(scene, points_mm):
    """Whether a ball stands before points (N, 2) of the plane: the quadratic along each line, ball by ball."""
    pinhole = np.array(scene.camera.position_mm)
    line = pinhole - np.column_stack((points_mm, np.zeros(len(points_mm))))
    found = np.zeros(len(points_mm), bool)
    for ball in scene.spheres:
        away = np.column_stack((points_mm, np.zeros(len(points_mm)))) - ball.centre_mm
        a, b, c = (line**2).sum(1), 2.0 * (line * away).sum(1), (away**2).sum(1) - ball.radius_mm**2
        found |= b * b - 4.0 * a * c > 0.0
    return found


@pytest.mark.parametrize("centre_mm", [(0.0, 0.0, 50.0), (20.0, -11.0, 56.0)])
def test_one_ball_hides_the_cone_that_touches_it(centre_mm):
    ball = Sphere("ball", centre_mm, 50.0, GLASS)
    scene = scene_of(ball, px_per_mm=2.0)
    found, _ = shown(scene)
    assert found.hidden_mm2 == pytest.approx(cone_area_mm2(ball, scene.camera.position_mm), rel=3e-3)
    if centre_mm[0] == 0.0:
        view = field_of_view(scene)
        assert found.share == pytest.approx((view.edge_mm / view.silhouette_mm) ** 2, rel=0.03)


def test_what_two_balls_hide_together_counts_once_and_rods_and_windows_hide_nothing_of_it():
    near, far = Sphere("far", (6.0, 0.0, 60.0), 20.0, GLASS), Sphere("near", (-4.0, 3.0, 19.0), 15.0, GLASS)
    rod = Rod("support", (-60.0, 50.0, 20.0), (60.0, 50.0, 20.0), 3.0)
    scene = scene_of(near, far, rod, position=(40.0, -20.0, 480.0))
    window = Window("window", (0.0, 0.0, 120.0), (0.0, 0.0, 1.0), 5.0, 150.0, GLASS)
    assert hiding(scene.with_bodies([*scene.bodies, window])) == [near, far]
    found, map_ = shown(scene)
    hidden = stopped(scene, map_.grid.nodes_mm().reshape(-1, 2)).reshape(map_.grid.shape)
    area = map_.grid.pitch_mm**2
    assert found.hidden_mm2 == pytest.approx(hidden.sum() * area, rel=2e-3)
    assert found.recovered_mm2 == pytest.approx((hidden & map_.recovered).sum() * area, rel=2e-3)
    assert found.what == "the balls"
    assert 0.0 < found.share < 1.0


def test_nothing_hidden_is_no_share_and_a_limit_of_sigma_takes_from_it():
    assert shown(scene_of(Rod("support", (-60.0, 0.0, 20.0), (60.0, 0.0, 20.0), 3.0)))[0] is None
    assert shown(scene_of(Sphere("beside", (400.0, 0.0, 50.0), 20.0, GLASS)))[0] is None
    scene = scene_of(Sphere("ball", (0.0, 0.0, 50.0), 50.0, GLASS), px_per_mm=2.0)
    whole, map_ = shown(scene)
    half = through_glass(scene, map_.grid, map_.recovered & (map_.grid.nodes_mm()[..., 0] <= 0.0))
    assert half.recovered_mm2 == pytest.approx(0.5 * whole.recovered_mm2, rel=0.02)
    assert half.hidden_mm2 == whole.hidden_mm2


def test_few_pixels_say_the_same():
    for centre in ((0.0, 0.0, 70.0), (12.0, 0.0, 33.0)):
        scene = scene_of(Sphere("ball", centre, 30.0, GLASS), px_per_mm=2.0)
        assert coarse_share(scene) == pytest.approx(shown(scene)[0].share, abs=0.01)
    assert coarse_share(scene_of()) == 1.0


def test_what_verbs_say_is_what_the_map_of_frames_gives_to_the_last_digit():
    scene = scene_of(Sphere("ball", (3.0, 0.0, 33.0), 30.0, GLASS), px_per_mm=4.0)
    found = through_scene(scene)
    assert found == shown(scene)[0]
    assert found.areas != coarse_said(scene)
    assert through_scene(scene_of()) is None


def coarse_said(scene):
    found = coarse_map(scene)
    return through_glass(scene, found.grid, found.recovered).areas


def test_the_sentence_has_the_digits_that_matter():
    assert ThroughGlass(4172.0, 39.9).sentence == "through glass: 1.0 % of what the balls hide (39.9 of 4172 mm²)"
    assert ThroughGlass(100.0, 100.0).sentence == "through glass: 100 % of what the balls hide (100 of 100 mm²)"
    assert ThroughGlass(100.0, 50.0, "the glass").name == "of what the glass hides"
    assert [percent(share) for share in (0.0, 0.094, 0.0996, 0.425)] == ["0.0 %", "9.4 %", "10 %", "42 %"]
    assert [percent(share) for share in (0.97, 0.996, 0.99999, 1.0)] == ["97 %", "99.6 %", "99.9 %", "100 %"]


def test_windows_beyond_the_grid_are_marked_too():
    scene = scene_of(Sphere("ball", (60.0, 0.0, 50.0), 50.0, GLASS))
    grid = shown(scene)[1].grid
    rows, columns = grid.shape
    inside = behind(scene.spheres, scene, grid, ((0, rows), (0, columns)))
    whole = behind(scene.spheres, scene, grid, ((-50, rows + 20), (-30, columns + 400)))
    assert np.array_equal(whole[50 : 50 + rows, 30 : 30 + columns], inside)
    area = cone_area_mm2(scene.spheres[0], scene.camera.position_mm)
    assert whole.sum() * grid.pitch_mm**2 == pytest.approx(area, rel=2e-3)


def test_the_kernel_marks_the_same_as_python():
    places = np.array([-1, 2]), np.array([-6.0, 6.0, 1.0]), np.array([1.0, -2.0, 50.0])
    for capsule in ([0, 0, 8, 0, 0, 8, 4.03], [-9, 3, 6, 4, 0, 6, 1.51], [0, 0, 5, 0, 0, 40, 1.02]):
        marks = np.zeros((2, 13, 10), np.bool_)
        mark_behind(*places, np.array(capsule, float), marks[0])
        mark_behind.py_func(*places, np.array(capsule, float), marks[1])
        assert (marks[0] == marks[1]).all()
        assert marks[0].sum() > 5
