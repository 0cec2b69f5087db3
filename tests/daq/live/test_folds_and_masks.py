"""Folds and masks drawn over frames, against what is known of them by other ways."""

from dataclasses import replace

import numpy as np

from correction.maps.correction_map import build_correction_map
from correction.node_status import NodeStatus
from daq.live import scene_lines as lines_module
from daq.live.scene_lines import LIT, folds_and_masks, scene_lines
from rtpiv.analysis.views.field_of_view import field_of_view
from sim.demo.scenes import at_size, demo_scene
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet
from tracer.strategies.ray_map import build_ray_map


def test_the_fold_of_a_ball_on_the_axis_is_a_circle_of_the_radius_that_the_curve_has():
    """`field_of_view` finds it on one ray's curve, where the determinant's radial part is zero."""
    scene = at_size(demo_scene("one_sphere_500"), 1008)
    seen, camera = field_of_view(scene), scene.camera
    assert seen.folds
    expected_px = camera.focal_px * seen.fold_mm / seen.distance_mm
    folds = folds_and_masks(scene)["raw"]["folds"]
    points = np.array([point for line in folds for point in line])
    away = np.hypot(*(points - camera.principal_px).T)
    assert np.abs(away - expected_px).max() < 4.0
    angle = np.sort(np.arctan2(*(points - camera.principal_px).T))
    assert np.diff(angle).max() < 0.5  # all around


def test_masks_are_around_what_is_not_recovered_and_nothing_else():
    scene = at_size(demo_scene("pyramid_500"), 504)  # its own coarse pixels
    status = build_correction_map(scene, build_ray_map(scene)).status
    lost = ~np.isin(status, (NodeStatus.RECOVERED, NodeStatus.OUT_OF_FRAME))
    masks = folds_and_masks(scene)["corrected"]["masks"]
    assert masks
    at = np.rint(np.concatenate([np.array(line) for line in masks])).astype(int)
    assert lost[at[:, 1], at[:, 0]].mean() > 0.95
    ends = [np.array(line)[[0, -1]] for line in masks]
    assert all((first == last).all() for first, last in ends)


def test_without_glass_there_is_no_line():
    bare = at_size(demo_scene("two_spheres_500"), 504).bare()
    assert all(not lines for kinds in folds_and_masks(bare).values() for lines in kinds.values())


def test_views_have_lines_of_their_own_and_what_cannot_be_traced_keeps_its_outlines(monkeypatch):
    scene = at_size(demo_scene("two_spheres_500"), 252)
    lines = scene_lines(scene, whole=True)
    assert lines["glass"]["raw"]["folds"]
    assert lines[LIT] == lines["glass"]
    assert not lines["clear"]["raw"]["folds"]
    lit = scene_lines(replace(scene, sheet=LightSheet(z_mm=-3.0)), whole=True)
    assert lit[LIT]["raw"]["folds"] != lit["glass"]["raw"]["folds"]
    assert lit["glass"]["raw"] == lines["glass"]["raw"]
    assert "folds" not in scene_lines(scene, whole=False)["glass"]["raw"]

    def refuse(scene):
        raise SceneError("too much")

    monkeypatch.setattr("daq.live.scene_lines.folds_and_masks", refuse)
    assert lines_module.scene_lines(scene, whole=True)["glass"]["raw"]["lines"]
