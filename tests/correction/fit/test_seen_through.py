"""Balls that show other squares: what they seem to be, by the picture alone; right ones are left alone."""

import numpy as np
import pytest

from correction.fit.seen.seen_through import balls_seen_otherwise
from correction.fit.seen.unconfirmed_ways import find_unconfirmed
from correction.target.chessboard import Chessboard, Dots
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.fit.faulty_labs import faulty
from tests.correction.small_scenes import small_scene
from tests.slow_cases import slow_but
from tracer.strategies.branches import text_of
from tracer.strategies.sensitivity import TargetPose

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
