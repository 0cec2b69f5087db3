"""Lines over the frames: where rays begin and cease to meet a ball."""

from dataclasses import replace

import numpy as np
import pytest

from correction.grid import grid_of
from daq.live.scene_lines import MAX_BALLS, outlines
from sim.demo.scenes import demo_scene
from tracer.strategies.trace import trace


@pytest.mark.parametrize("name", ["two_spheres_500", "pyramid_500", "tilted"])
def test_rays_inside_an_outline_meet_the_ball_and_those_outside_do_not(name):
    scene = demo_scene(name)
    for ball, (called, points) in zip(scene.spheres, outlines(scene)["raw"]["lines"], strict=True):
        assert called == ball.name
        line, alone = np.array(points), scene.with_bodies((ball,))
        middle = line.mean(axis=0)
        inside, outside = (trace(alone, middle + share * (line - middle)) for share in (0.995, 1.005))
        assert all(inside.rays["events"] > 0)
        assert all(outside.rays["events"] == 0)


def test_on_the_plane_an_outline_is_what_the_ball_hides():
    scene = demo_scene("two_spheres_500")
    grid, (x, y, z) = grid_of(scene.camera), scene.camera.position_mm
    for ball, (_, points) in zip(scene.spheres, outlines(scene)["corrected"]["lines"], strict=True):
        plane = grid.to_mm(np.array(points))
        towards = np.column_stack((plane, np.zeros(len(plane)))) - (x, y, z)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        centre = np.array(ball.centre_mm) - (x, y, z)
        passes = np.sqrt(centre @ centre - (towards @ centre) ** 2)
        assert passes == pytest.approx(ball.radius_mm, abs=0.01)


def test_what_has_no_outline_is_left_out_and_a_bed_is_not_drawn_whole():
    scene = demo_scene("one_sphere_500")
    (ball,) = scene.spheres
    many = [
        replace(ball, name=f"b{i}", radius_mm=1.0, centre_mm=(3.0 * i, 0.0, 2.0)) for i in range(2 * MAX_BALLS)
    ]
    assert len(outlines(scene.with_bodies(many))["raw"]["lines"]) == MAX_BALLS
    assert outlines(scene.bare())["raw"]["lines"] == []
    assert outlines(scene.bare())["raw"]["cross"] == pytest.approx([1007.5, 1007.5], abs=1.0)
