"""How much of the plane a scene shows, against areas that geometry knows."""

from dataclasses import replace

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from correction.node_status import NodeStatus
from rtpiv.analysis.through_glass import plane_share
from rtpiv.analysis.views.field_of_view import field_of_view
from tracer.bodies import Rod, Sphere
from tracer.camera import Camera, look_at
from tracer.errors import StaleMap
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

GLASS = ConstantMedium(1.53)
SIDE_PX = 400


def scene_of(*bodies, position=(0.0, 0.0, 500.0), px_per_mm=3.0):
    middle = 0.5 * (SIDE_PX - 1)
    pose = look_at(position, (0.0, 0.0, 0.0))
    camera = Camera(px_per_mm * position[2], (middle, middle), (SIDE_PX, SIDE_PX), position, pose)
    return Scene(camera, bodies)


def share_of(scene):
    return plane_share(scene, build_correction_map(scene, build_ray_map(scene)))


def cone_area_mm2(ball, position):
    """Area that the cone touching a ball covers on the plane: a general ellipse, by its quadratic form."""
    to_centre = np.array(ball.centre_mm) - np.array(position)
    distance2 = to_centre @ to_centre
    cosine2 = 1.0 - ball.radius_mm**2 / distance2
    axis = to_centre / np.sqrt(distance2)
    form = np.outer(axis, axis) - cosine2 * np.eye(3)  # w M w = 0 on the cone, w = (x, y, -L) from the pinhole
    a, b, c = form[:2, :2], form[:2, 2] * -position[2], form[2, 2] * position[2] ** 2
    reach = b @ np.linalg.solve(a, b) - c
    return np.pi * abs(reach) / np.sqrt(np.linalg.det(a))


def test_a_ball_on_the_axis_shows_what_the_radial_curve_says():
    scene = scene_of(Sphere("ball", (0.0, 0.0, 50.0), 50.0, GLASS), px_per_mm=2.4)
    share, view = share_of(scene), field_of_view(scene)
    (ball,) = share.bodies
    assert ball.outline_mm2 == pytest.approx(np.pi * view.silhouette_mm**2, rel=2e-3)
    assert ball.shown_mm2 == pytest.approx(np.pi * view.edge_mm**2, rel=0.02)
    assert ball.recovered_mm2 == pytest.approx(ball.shown_mm2, rel=0.02)
    assert share.glass_mm2 == pytest.approx(ball.shown_mm2)
    assert sum(share.areas_mm2.values()) == pytest.approx(share.whole_mm2)
    assert share.recovered_mm2 == pytest.approx(share.areas_mm2[NodeStatus.RECOVERED])
    assert ball.main_loss in (NodeStatus.RIM, NodeStatus.FOLD)


def test_a_triangle_beside_the_axis_is_answered_ball_by_ball_by_a_tilted_camera_too():
    balls = [Sphere(name, (x, y, 22.0), 20.0, GLASS) for name, x, y in
             (("left", -22.0, -12.0), ("right", 22.0, -12.0), ("top", 0.0, 26.0))]  # fmt: skip
    for position in ((0.0, 0.0, 500.0), (60.0, -25.0, 480.0)):
        scene = scene_of(*balls, position=position, px_per_mm=2.0)
        share = share_of(scene)
        assert [body.name for body in share.bodies] == ["left", "right", "top"]
        for body, ball in zip(share.bodies, balls, strict=True):
            assert body.outline_mm2 == pytest.approx(cone_area_mm2(ball, position), rel=4e-3)
            assert 0.0 < body.shown_mm2 < body.outline_mm2
        assert sum(body.shown_mm2 for body in share.bodies) == pytest.approx(share.glass_mm2, rel=1e-9)


def test_a_ball_behind_another_is_counted_for_both_and_opaque_bodies_show_nothing():
    near, far = (Sphere(n, (0.0, 0.0, z), 20.0, GLASS) for n, z in (("near", 20.0), ("far", 60.0)))
    rod = Rod("support", (-60.0, 50.0, 20.0), (60.0, 50.0, 20.0), 3.0)
    share = share_of(scene_of(near, far, rod))
    one, two, support = share.bodies
    assert one.shown_mm2 == pytest.approx(two.shown_mm2)
    assert share.glass_mm2 == pytest.approx(one.shown_mm2)
    assert not support.is_glass
    assert (support.shown_mm2, support.recovered_mm2) == (0.0, 0.0)
    assert support.main_loss == NodeStatus.BLOCKED
    wide = 500.0 / 480.0  # thrown from the pinhole on the plane
    middle, half = np.arctan2(50.0, 480.0), np.arcsin(3.0 / np.hypot(50.0, 480.0))
    height = 500.0 * (np.tan(middle + half) - np.tan(middle - half))
    row = 0.5 * 125.0 / 3.0  # its edges run along rows of nodes: each half a row off at most
    assert support.outline_mm2 == pytest.approx(height * (120.0 + 1.5 * np.pi) * wide, abs=2.0 * row)


def test_a_body_beside_the_view_or_behind_the_plane_has_no_outline():
    beside = Sphere("beside", (400.0, 0.0, 50.0), 20.0, GLASS)
    behind = Sphere("behind", (0.0, 0.0, -50.0), 20.0, GLASS)
    share = share_of(scene_of(beside, behind))
    assert [body.name for body in share.bodies] == ["beside"]
    assert (share.bodies[0].outline_mm2, share.bodies[0].main_loss) == (0.0, None)
    assert share.recovered_mm2 == pytest.approx(share.whole_mm2)


def test_the_map_of_another_scene_is_refused():
    scene = scene_of()
    denser = replace(scene, ambient=ConstantMedium(1.2))
    other = build_correction_map(denser, build_ray_map(denser))
    with pytest.raises(StaleMap):
        plane_share(scene, other)
