"""Is one sigma of the map one sigma, region by region? Labs whose corners err as those of exact renders do."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.seen.prediction import expect
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.drawn_labs import Drawn, drawn_lab
from tracer.bodies import Core, Sphere
from tracer.media import VACUUM, ConstantMedium, shifted
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

BOARD = Chessboard(2.5, 1.0)
SIZE_PX, FIRST, LABS = 1008, 64000, 16
NOT_COUNTED = "the radius of a core is held as told; 0.02 mm of doubt make errors 1.6 sigma behind thin walls"


def aligned(rng: np.random.Generator, seed: int) -> tuple[Scene, Scene, Chessboard]:
    """Three balls on the axis, whose radii and glass are known as well as the fit takes them to be."""
    nominal = at_size(demo_scene("three_spheres_500"), SIZE_PX)
    truth = misalign(nominal, 1000 + seed)
    n = shifted(truth.spheres[0].medium, float(rng.normal(0.0, 0.003)))
    smaller = [
        replace(ball, medium=n, radius_mm=ball.radius_mm - rng.uniform(0.0, 0.02)) for ball in truth.spheres
    ]
    return nominal, truth.with_bodies(smaller), BOARD


def hollow(rng: np.random.Generator, seed: int) -> tuple[Scene, Scene, Chessboard]:
    """Two hollow balls with walls of 0.5 to 4 mm, told as well as radii are: to 0.02 mm outside and inside."""
    wall = float(rng.choice([0.5, 1.0, 2.0, 4.0]))
    balls = [
        Sphere(name, centre, radius, ConstantMedium(n), (Core(radius - wall, VACUUM),))
        for name, centre, radius, n in (
            ("left", (-20.0, 5.0, 22.0), 20.0, 1.5),
            ("right", (23.5, -3.0, 26.0), 22.0, 1.47),
        )
    ]
    nominal = at_size(demo_scene("one_sphere_500"), SIZE_PX).with_bodies(balls)
    truth = misalign(nominal, 1000 + seed)

    def made(ball: Sphere) -> Sphere:
        off, inside = np.clip(rng.normal(0.0, 0.02, 2), -0.04, 0.04)
        cores = (Core(ball.cores[0].radius_mm + inside, VACUUM),)
        n = shifted(ball.medium, float(rng.normal(0.0, 0.003)))
        return replace(ball, radius_mm=ball.radius_mm + off, medium=n, cores=cores)

    return nominal, truth.with_bodies([made(ball) for ball in truth.spheres]), BOARD


def chi(labs: list[Drawn], behind: bool) -> float:
    """Root mean square of error over sigma; errors of one lab belong together, so each lab counts once."""
    parts = [(lab.error_px, lab.sigma_px) if behind else lab.beside[1:] for lab in labs]
    return float(np.sqrt(np.mean([np.mean((error / sigma) ** 2) for error, sigma in parts])))


def test_the_bending_of_a_view_pulls_corners_along_its_unevenness_and_nowhere_else():
    scene = at_size(demo_scene("three_spheres_500"), SIZE_PX)
    shown = expect(scene, TargetPose(), BOARD)
    pull = np.linalg.norm(shown.bent_px, axis=1)
    assert pull[shown.branch == 0].max() < 1e-6
    assert pull.max() > 0.01
    bent = shown.take(pull > 0.005)
    away = bent.pixel - np.array(scene.camera.principal_px)
    along = np.sum(away * bent.bent_px, axis=1) / np.linalg.norm(away, axis=1)
    assert (np.abs(along) > 0.9 * np.linalg.norm(bent.bent_px, axis=1)).all()  # by symmetry


@pytest.mark.slow
def test_sigma_behind_aligned_balls_holds_what_the_bent_view_does_to_corners():
    """As far off as exact renders are: error 0.003 px where corners alone promise 0.001."""
    lab = drawn_lab(FIRST, noise_px=0.003, draw=aligned, pulled=1.0)
    assert chi([lab], behind=True) < 1.6
    assert lab.fit.verdict.is_right


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "draw", [aligned, pytest.param(hollow, marks=pytest.mark.xfail(reason=NOT_COUNTED, strict=True))]
)
def test_one_sigma_is_one_sigma(draw):
    rng = np.random.default_rng(5)
    labs = [drawn_lab(FIRST + n, draw=draw, pulled=rng.normal() * (draw is aligned)) for n in range(LABS)]
    for behind in (False, True):
        print(f"behind glass {behind}: {chi(labs, behind):.3f}")
        assert 0.8 <= chi(labs, behind) <= 1.25
