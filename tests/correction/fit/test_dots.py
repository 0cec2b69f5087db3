"""Centres of dots: what perspective and balls do to their pictures is known from the rays, and taken off."""

import numpy as np
import pytest

from correction.fit.scene_fit import fit_scene
from correction.fit.seen.bent_view import window_bias
from correction.fit.seen.dot_rims import off_centre
from correction.fit.seen.measurement import TargetFrame
from correction.fit.seen.prediction import expect, measure
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import DotGrid, Pose, place
from sim.renderer.render import render, render_irradiance
from sim.renderer.sensor import Sensor
from tests.correction.target.drawn_boards import camera
from tracer.board import LARGE_DOTS, Dots
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

EXACT = Sensor(white_counts=53000.0, electrons_per_count=float("inf"), read_noise_counts=0.0, bits=16, blur_px=0.6)


def grid(pitch_mm, share=0.4):
    """A grid, and its print."""
    words = {"discs": LARGE_DOTS, "dots": Dots(share * pitch_mm)}
    return Chessboard(pitch_mm, 0.65 * pitch_mm, **words), DotGrid(pitch_mm, 0.65 * pitch_mm, **words)


def middle_of_conic(view, centre_mm, radius_mm):
    """Middle (2,) of the ellipse that a plane view (3, 3) makes of a circle, by the inverse of its conic."""
    x, y = centre_mm
    conic = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [-x, -y, x * x + y * y - radius_mm**2]])
    middle = view @ np.linalg.inv(conic) @ view.T @ (0.0, 0.0, 1.0)
    return middle[:2] / middle[2]


def test_perspective_puts_the_middle_of_a_circle_where_projective_geometry_has_it():
    near = camera((60.0, 20.0, 70.0), (0.0, 0.0), 0.3)
    board = grid(8.0, 0.4)[0]
    index = np.array([(0, 0), (-1, 1), (2, 0)])
    nodes = board.corner_mm(index)
    focal, (cu, cv) = near.focal_px, near.principal_px
    inner = np.array([[focal, 0.0, cu], [0.0, focal, cv], [0.0, 0.0, 1.0]])
    rotation = near.rotation_matrix
    view = inner @ np.column_stack((rotation[:, 0], rotation[:, 1], -rotation @ near.position_mm))
    at = near.project(np.column_stack((nodes, np.zeros(3))))
    step = [near.project(np.column_stack((nodes + 4.0 * way, np.zeros(3)))) - at for way in np.eye(2)]
    off = off_centre(Scene(near, ()), board, index, at, np.stack(step, axis=-1) * 2.0)
    radius = 0.5 * board.dot_share(index) * 8.0
    true = [middle_of_conic(view, node, r) for node, r in zip(nodes, radius, strict=True)] - at
    assert np.abs(true).max() > 0.3
    assert np.abs(off - true).max() < 1e-4


@pytest.mark.slow
def test_centres_behind_two_balls_are_right_once_the_bias_of_circles_is_taken_off():
    scene = misalign(at_size(demo_scene("two_spheres_500"), 504), 5)
    board, paper = grid(5.0)
    frame = EXACT.expose(render_irradiance(scene, paper, samples=8, seed=1), seed=0)
    shown = expect(scene, TargetPose(), board)
    shown = shown.take(shown.branch > 0)
    fit = measure(frame, shown, board)
    aside, _ = window_bias(scene, TargetPose(), board, shown, fit.blur_px)
    there = fit.valid & np.isfinite(aside[:, 0])
    raw, off = fit.position_px - shown.pixel, fit.position_px - aside - shown.pixel
    assert there.sum() > 30
    assert np.sqrt(np.mean(raw[there] ** 2)) > 0.03
    assert np.sqrt(np.mean(off[there] ** 2)) < 0.02


@pytest.mark.slow
def test_dots_that_are_all_alike_fit_a_camera_by_the_origin_pointed_at_in_the_first_of_three_heights():
    nominal = at_size(demo_scene("two_spheres_500"), 504)
    truth = misalign(nominal, 3).with_bodies(())
    words = {"discs": (), "dots": Dots(2.0)}
    paper = DotGrid(5.0, 2.0, **words)
    frames = [
        TargetFrame(
            f"z{z:g}", render(truth, place(paper, Pose((0.0, 0.0, z))), Sensor(), samples=2, seed=1), False, z
        )
        for z in (0.0, 12.0, -12.0)
    ]
    pointed = tuple((truth.camera.project(np.zeros(3)) + np.array((3.0, -2.0))).tolist())
    fit = fit_scene(nominal.with_bodies(()), frames, Chessboard(5.0, 2.0, **words, origin_px=pointed))
    assert any("rests on origin_px" in str(step) for step in fit.history)
    corners = np.array([(x, y, z) for x in (-20.0, 20.0) for y in (-20.0, 20.0) for z in (-12.0, 12.0)])
    assert np.abs(fit.scene.camera.project(corners) - truth.camera.project(corners)).max() < 0.05
