"""Scenes that are a little wrong, and right heaps of touching balls, held against frames pixel by pixel.

What no corner tells is asked of the frame: the scene compared is the true one with one number wrong.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.fit.seen.unlisted_parts import Compared, View, compare_views
from correction.target import Chessboard
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.slow_cases import slow
from tracer.bodies import Sphere
from tracer.camera import Camera, look_at
from tracer.media import ConstantMedium, Medium
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

SIZE_PX, VIEW_MM, AWAY_MM = (560, 480), 64.0, 290.0
BOARD = Chessboard(3.7, 1.5)  # so wide that few corners are seen through a ball
LATTICE = [np.array([[-10, -9], [10, 9]])]
MORE_RADII = ("high", -0.01), ("alone", 0.01), ("low", 0.02)
FLINT, CROWN = ConstantMedium(1.62), ConstantMedium(1.47)


@cache
def lab() -> Scene:
    """A ball that is seen by itself, one before another, and a camera that looks from the side."""
    at = (-14.0, 11.0, AWAY_MM)
    middle = (0.5 * (SIZE_PX[0] - 1), 0.5 * (SIZE_PX[1] - 1))
    camera = Camera(SIZE_PX[0] * AWAY_MM / VIEW_MM, middle, SIZE_PX, at, look_at(at, (0.0, 0.0, 0.0), 0.05))
    balls = (
        Sphere("low", (-12.0, 6.0, 12.2), 11.5, CROWN),
        Sphere("high", (-1.0, -6.0, 45.0), 9.0, FLINT),
        Sphere("alone", (19.0, 11.0, 17.0), 9.5, CROWN),
    )
    return Scene(camera, balls)


@cache
def frame(scene: Scene, stretch: float = 1.0) -> np.ndarray:
    side = stretch * BOARD.square_mm
    return render(scene, Print(side, 0.4 * side), Sensor(), samples=3, seed=11)


def compared(scene: Scene, image: np.ndarray, board: Chessboard = BOARD, sure_mm: float = 0.01) -> Compared:
    known = dict.fromkeys((ball.name for ball in scene.spheres), sure_mm)
    return compare_views(scene, [View("glass", image, TargetPose())], board, LATTICE, known, known)


def with_ball(name: str, radius: float = 0.0, n: float = 0.0, aside_mm: float = 0.0) -> Scene:
    """The lab with one ball larger by a share, of another index, or elsewhere."""

    def changed(ball: Sphere) -> Sphere:
        medium: Medium | None = ball.medium
        if n and isinstance(medium, ConstantMedium):
            medium = ConstantMedium(medium.index + n)
        x, y, z = ball.centre_mm
        size = ball.radius_mm * (1.0 + radius)
        return replace(ball, radius_mm=size, medium=medium, centre_mm=(x + aside_mm, y, z))

    return lab().with_bodies([changed(ball) if ball.name == name else ball for ball in lab().spheres])


def test_a_right_scene_is_not_doubted():
    assert compared(lab(), frame(lab())) == Compared()


@pytest.mark.parametrize("blur_px", [0.8, 1.5])
@pytest.mark.parametrize("noise", [0.0, 60.0])
def test_nor_is_it_in_blurred_and_noisy_frames(blur_px, noise):
    import cv2

    image = cv2.GaussianBlur(frame(lab()).astype(np.float32), (0, 0), blur_px)
    image = image + np.random.default_rng(2).normal(0.0, noise, image.shape).astype(np.float32)
    assert compared(lab(), image) == Compared()


@pytest.mark.slow
def test_a_print_that_is_larger_than_measured_is_compared_as_large_as_it_was_found():
    image = frame(lab(), 1.012)
    assert compared(lab(), image, BOARD.stretch((1.012, 1.012))) == Compared()
    assert compared(lab(), image) != Compared()


@pytest.mark.parametrize(
    ("ball", "share"),
    [("high", 0.02), ("alone", -0.02), ("low", -0.01), *(slow(*one) for one in MORE_RADII)],
)
def test_a_radius_that_is_a_hundredth_off_is_named(ball, share):
    found = compared(with_ball(ball, radius=share), frame(lab()))
    assert ball in {one.ball for one in (*found.rims, *found.misfits)}
    assert {one.ball for one in found.rims} <= {ball}
    if found.rims:
        assert found.rims[0].larger_px * share < 0.0  # too large in the scene, seen smaller
        assert "radius" in str(found.rims[0])
    for misfit in found.misfits:
        assert ball in misfit.way
        assert all(word in str(misfit) for word in ("radius", "glass", "place", "hollow", "does not list"))


@pytest.mark.parametrize(("ball", "n"), [slow("high", 0.1), ("alone", -0.05), ("low", 0.02), slow("low", 0.08)])
def test_another_glass_is_a_misfit_of_its_view_and_no_body(ball, n):
    found = compared(with_ball(ball, n=n), frame(lab()))
    assert found.misfits
    assert all(ball in one.way for one in found.misfits)
    assert not found.rims
    assert not found.unlisted


@pytest.mark.parametrize("ball", ["alone", "high"])
def test_a_ball_that_stands_aside_is_named_by_its_rim(ball):
    found = compared(with_ball(ball, aside_mm=0.25), frame(lab()))
    assert ball in {one.ball for one in found.rims}
    rim = next(one for one in found.rims if one.ball == ball)
    assert np.hypot(*rim.aside_px) == pytest.approx(0.25 * lab().camera.focal_px / AWAY_MM, rel=0.3)


def test_a_place_that_is_not_known_better_is_no_rim_that_is_off():
    found = compared(with_ball("alone", aside_mm=0.25), frame(lab()), sure_mm=0.3)
    assert not found.rims


def test_a_whole_ball_that_is_not_listed_is_one_and_what_it_covers_is_unconfirmed():
    stray = Sphere("stray", (19.0, 8.0, 55.0), 7.0, CROWN)
    found = compared(lab(), frame(lab().with_bodies([*lab().bodies, stray])))
    assert found.unlisted or found.misfits
    assert any("alone" in one.way for one in found.misfits) or any("alone" in one.way for one in found.unlisted)


def heap(seed: int) -> Scene:
    """Balls dropped on each other, each touching one or two."""
    rng = np.random.default_rng((56, seed))
    radius, balls = float(rng.uniform(8.0, 10.0)), list[tuple[float, float, float]]()
    for _ in range(6):
        tries = []
        for x, y in rng.uniform((-22.0, -18.0), (22.0, 18.0), (2000, 2)).tolist():
            gaps = [(2.0 * radius + 0.01) ** 2 - (x - b[0]) ** 2 - (y - b[1]) ** 2 for b in balls]
            z = max([radius + 0.5, *(b[2] + gap**0.5 for b, gap in zip(balls, gaps, strict=True) if gap > 0.0)])
            near = min((np.linalg.norm(np.subtract((x, y, z), b)) for b in balls), default=0.0)
            tries.append((0.5 * z + near, (x, y, z)))
        balls.append(min(tries)[1])
    glass = ConstantMedium(float(rng.uniform(1.35, 1.6)))
    return Scene(lab().camera, tuple(Sphere(f"h{n}", b, radius, glass) for n, b in enumerate(balls)))


@pytest.mark.parametrize("seed", [0, *map(slow, range(1, 12))])
def test_a_right_heap_of_touching_balls_is_not_doubted(seed):
    scene, board = heap(seed), Chessboard(1.9, 0.76)
    image = render(scene, Print(1.9, 0.76), Sensor(), samples=3, seed=seed)
    known = {ball.name: 0.002 for ball in scene.spheres}
    lattice = [np.array([[-20, -18], [20, 18]])]
    found = compare_views(scene, [View("glass", image, TargetPose())], board, lattice, known, known)
    assert found == Compared()
