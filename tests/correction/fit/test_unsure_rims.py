"""Nodes beside a ball whose place is not known well: what may be seen through it is masked, and no more."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.seen.unsure_rims import beside_rim, unsure_rims, windows_beside
from correction.fit.solve.solver import Corners
from correction.masked import pixels_in
from sim.demo.scenes import at_size, demo_scene
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace

ROOT_MM = np.array(
    [[0.06, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.2], [0.02, 0.0, 0.0]]
)  # x and radius together
STEP = 3


@pytest.fixture(scope="module")
def lab() -> Scene:
    """One ball, clear of the plane."""
    scene = at_size(demo_scene("one_sphere_500"), 504)
    x, y, z = scene.spheres[0].centre_mm
    return scene.with_bodies([replace(scene.spheres[0], centre_mm=(x, y, z + 3.0))])


def through_ball(scene: Scene, pixels: np.ndarray) -> np.ndarray:
    """Whether rays of pixels (N, 2) meet the ball, by the tracer."""
    ways = trace(scene, pixels).rays["key"]
    return np.asarray(ways != trace(scene.bare(), pixels[:1]).rays["key"][0])


def test_what_another_place_of_the_ball_would_show_is_in_the_band(lab):
    (rim,) = unsure_rims(lab, ROOT_MM[None])
    assert rim.ball == lab.spheres[0].name
    height, width = lab.camera.shape
    inside = pixels_in(rim.masked, (height, width))
    rows, columns = np.mgrid[0:height:STEP, 0:width:STEP]
    pixels = np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64)
    banded = inside[rows.ravel(), columns.ravel()]
    believed = through_ball(lab, pixels)
    rng, wrong, missed = np.random.default_rng(3), 0, 0
    for _ in range(60):
        move = ROOT_MM @ rng.normal(size=3)
        ball = lab.spheres[0]
        moved = replace(
            ball,
            centre_mm=tuple((np.array(ball.centre_mm) + move[:3]).tolist()),
            radius_mm=ball.radius_mm + move[3],
        )
        other = through_ball(lab.with_bodies([moved]), pixels) != believed
        wrong, missed = wrong + np.count_nonzero(other), missed + np.count_nonzero(other & ~banded)
    assert wrong > 800
    assert missed < 0.01 * wrong


def test_the_band_is_as_wide_as_each_side_is_unsure(lab):
    along_x = np.zeros((1, 4, 1))
    along_x[0, 0, 0] = 0.5
    (rim,) = unsure_rims(lab, along_x)
    inside = pixels_in(rim.masked, lab.camera.shape)
    ball = lab.spheres[0]
    u, v = np.rint(lab.camera.project(np.array([ball.centre_mm]))[0]).astype(int)
    px_per_mm = lab.camera.focal_px / (lab.camera.position_mm[2] - ball.centre_mm[2])
    assert np.count_nonzero(inside[v]) == pytest.approx(2 * 2 * 3.0 * 0.5 * px_per_mm, rel=0.1)
    assert np.count_nonzero(inside[:, u]) < 0.3 * np.count_nonzero(inside[v])
    assert rim.sigma_px == pytest.approx(0.5 * px_per_mm, rel=0.1)


def test_a_ball_that_corners_tell_well_loses_nothing(lab):
    assert unsure_rims(lab, 0.03 * ROOT_MM[None]) == ()


def test_a_ball_that_is_masked_whole_has_no_band(lab):
    assert unsure_rims(lab, ROOT_MM[None], {lab.spheres[0].name}) == ()


def test_a_corner_whose_window_may_meet_the_rim_is_left_out(lab):
    along_x = np.zeros((1, 4, 1))
    along_x[0, 0, 0] = 0.5
    (rim,) = unsure_rims(lab, along_x)
    ball, square_px = lab.spheres[0], 24.0
    (u, v), (right, _) = lab.camera.project(
        np.array([ball.centre_mm, np.add(ball.centre_mm, (ball.radius_mm, 0.0, 0.0))])
    )
    half_px = 3.0 * rim.sigma_px
    pixel = np.array([(right + half_px + far * square_px, v) for far in (-0.2, 0.3, 0.8)] + [(u, v)])
    count = len(pixel)
    corners = Corners(0, True, pixel, np.zeros((count, 2)), 1.0)
    axes = np.tile(square_px * np.eye(2), (count, 1, 1))
    index, way = np.zeros((count, 2), np.int64), np.full(count, "")
    frame = MeasuredFrame("glass", corners, index, axes, way, np.zeros(count), np.ones((count, 2)), {}, {})
    assert windows_beside((rim,), frame).tolist() == [True, True, False, False]
    through = replace(frame, branch_name=np.full(count, ball.name))  # they are what tells its place
    assert not windows_beside((rim,), through).any()
    assert not windows_beside((), frame).any()
    assert beside_rim((rim,), (right, v))
    assert not beside_rim((rim,), (u, v))
