"""Balls that show other squares: what they seem to be, by the picture alone; right ones are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.seen.seen_through import OWN_OUTLINE, _outline_box, balls_seen_otherwise
from correction.fit.seen.unconfirmed_ways import find_unconfirmed
from correction.fit.seen.unsure_rims import beside_rim, unsure_rims, windows_beside
from correction.fit.solve.solver import Corners
from correction.masked import pixels_in
from correction.target.chessboard import Chessboard, Dots
from sim.demo.scenes import at_size, demo_scene
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.faulty_labs import faulty
from tests.correction.small_scenes import small_scene
from tests.slow_cases import slow_but
from tracer.scene.scene import Scene
from tracer.strategies.branches import text_of
from tracer.strategies.sensitivity import TargetPose
from tracer.strategies.trace import trace

KINDS = {
    "balls of two glasses swapped": ("ball0", r"n = 1.46 and not 1.62"),
    "ball is hollow": ("ball0", "a hollow ball"),
    "ball is not hollow": ("ball0", "a ball that is not hollow"),
    "ball is not there": ("ball1", "the board is seen there without glass"),
    "ball not listed": ("ball1", "a ball that the scene does not list"),
    "glass is another one": ("ball1", "glass of n = 1.46 and not 1.53"),
}
SEEDS = dict(zip(KINDS, (71009, 71012, 71013, 71016, 71010, 71005), strict=True))


def words(kind: str, seed: int, is_refused: bool = True) -> dict[str, str]:
    """What is said of a lab whose camera is known, and whose balls stand a little beside their places."""
    case = faulty(kind, seed)
    image = render(case.glass, Print(case.board.square_mm, case.board.disc_mm), Sensor(), samples=2, seed=seed)
    scene = case.given.with_camera(case.glass.camera)
    return balls_seen_otherwise(scene, image, TargetPose(), case.board, is_refused)


@pytest.mark.parametrize("kind", slow_but(KINDS, "ball is hollow"))
def test_a_ball_that_is_not_as_described_is_named_with_what_it_seems_to_be(kind):
    ball, said = KINDS[kind]
    found = words(kind, SEEDS[kind])
    assert said in found[ball]
    assert next(iter(found)) == ball


@pytest.mark.slow
def test_balls_as_described_are_left_alone_and_what_nothing_explains_is_no_alarm():
    assert not words("", 74050)  # one ball stands 0.3 mm nearer to the camera than given
    # Two labs are rendered for this: the second shows a ball that nothing on the list explains.
    assert not words("ball not listed", 71010, is_refused=False)


def test_a_ball_that_is_shown_otherwise_is_unconfirmed_and_masked():
    scene = small_scene("two_spheres_500")
    one, other = (ball.name for ball in scene.spheres)
    every = {one: 20, f"{one} > {other}": 10, other: 15}
    (lost,) = find_unconfirmed(scene, every, every, {one: 0.1, other: 0.1}, rather={one: "it is hollow"})
    assert str(lost) == "it is hollow; the ball is masked in every map"
    through = [part.through for part in lost.masked if part.through]
    assert {text_of(way) for way in through} == {one, f"{one} > {other}"}
    assert any(part.through is None or not part.through for part in lost.masked)  # its outline as well


@pytest.mark.slow
def test_right_labs_are_left_alone():
    assert not [seed for seed in range(74000, 74060) if words("", seed, is_refused=False)]


def test_a_board_of_dots_is_not_asked():
    dots = Chessboard(5.0, 3.0, discs=((0, 0), (1, 0), (0, 2)), dots=Dots(1.5, True))
    scene = small_scene("one_sphere_250")
    assert not balls_seen_otherwise(scene, np.zeros(scene.camera.shape), TargetPose(), dots)


@pytest.mark.parametrize("name", ["one_sphere_250", "two_spheres_500", "pyramid_500"])
@pytest.mark.parametrize("bent", [0.0, -0.4])
def test_no_pixel_that_is_asked_lies_outside_the_box_of_a_ball(name, bent):
    scene = small_scene(name)
    camera = replace(scene.camera, lens=replace(scene.camera.lens, k1=bent), principal_px=(20.0, 300.0))
    scene = scene.with_camera(camera)  # some of the balls reach beyond the sensor
    rows, columns = np.indices(camera.shape)
    away = camera.directions(np.stack((columns, rows), axis=-1).astype(np.float64))
    for ball in scene.spheres:
        towards = np.array(ball.centre_mm) - np.array(camera.position_mm)
        across = np.linalg.norm(np.cross(away, towards), axis=-1)
        half = np.arcsin(ball.radius_mm / np.linalg.norm(towards))
        asked = np.arctan2(across, away @ towards) < OWN_OUTLINE * half
        (left, top), (right, bottom) = _outline_box(scene, ball)
        assert np.count_nonzero(asked[top:bottom, left:right]) == np.count_nonzero(asked)
        if min(left, top) > 0 and right < camera.sensor_px[0] and bottom < camera.sensor_px[1]:
            assert (right - left) * (bottom - top) < 3.0 * np.count_nonzero(asked)


# Nodes beside a ball whose place is not known well: what may be seen through it is masked, and no more.


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
