"""Windows and tubes found from target frames of the renderer's optics, where the scene file has them otherwise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.board import Chessboard
from correction.fit.result import SceneFit
from correction.fit.scene_fit import fit_scene
from correction.fit.weakness import weaknesses
from sim.demo.scenes import at_size, misaligned, named_scene
from tests.correction.fit.benches import errors_behind, photograph
from tracer.bodies import Body, Sphere, Tube, Window
from tracer.media import MEDIA
from tracer.scene import Scene

SIZE_PX = {"window": 700, "tube": 1008}
SQUARE_MM = {"window": 3.5, "tube": 2.0}  # smaller balls, so that the tube holds them
GLASS = MEDIA["borosilicate"]


@cache
def found(kind: str) -> tuple[SceneFit, Scene]:
    """The fit of two balls behind a wall that is not as the file says, and the truth."""
    base = at_size(named_scene("two_spheres_500"), SIZE_PX[kind])
    nominal_wall, true_wall, balls = WALLS[kind](base.spheres)
    nominal = base.with_bodies([nominal_wall, *balls])
    truth = misaligned(nominal, 1)
    truth = truth.with_bodies([true_wall if body.name == kind else body for body in truth.bodies])
    side = SQUARE_MM[kind]
    frames = [photograph(truth.bare(), False, 0.0, 1, side), photograph(truth, True, 0.0, 2, side)]
    return fit_scene(nominal, frames, Chessboard(side, 0.4 * side), say=print), truth


def window(balls: tuple[Sphere, ...]) -> tuple[Body, Body, tuple[Sphere, ...]]:
    """A plate of 10 mm, believed upright, that leans by one degree."""
    upright = Window("window", (0.0, 0.0, 160.0), (0.0, 0.0, 1.0), 10.0, 90.0, GLASS)
    lean = np.deg2rad(1.0)
    return upright, replace(upright, normal=(float(np.sin(lean)), 0.0, float(np.cos(lean)))), balls


def tube(balls: tuple[Sphere, ...]) -> tuple[Body, Body, tuple[Sphere, ...]]:
    """A tube of 100 x 5 mm with two balls and the board in it, 0.2 mm too thick, and not where it should be."""
    nominal = Tube("tube", (0.0, -150.0, 0.0), (0.0, 150.0, 0.0), 50.0, 45.0, GLASS)
    true = nominal.with_numbers([0.2, -0.25, 0.004, -0.003, 50.2, 45.1, GLASS.n(532.0) + 0.001], 532.0)
    one, other = balls
    low = replace(one, centre_mm=(2.0, 21.0, 20.5), radius_mm=20.0)
    return nominal, true, (low, replace(other, centre_mm=(-2.0, -21.0, 20.5), radius_mm=20.0))


WALLS = {"window": window, "tube": tube}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", ["window", "tube"])
def test_a_wall_is_found_from_target_frames(kind: str) -> None:
    """Map <= 0.05 px rms behind glass, every number of the wall within three sigmas (all together: chi-square)."""
    fit, truth = found(kind)
    error_px, sigma_px, _ = errors_behind(fit, truth)
    assert np.sqrt(np.mean(error_px**2) / 2.0) < 0.05
    assert np.mean(error_px**2) < 4.0 * np.mean(sigma_px**2)
    names = [name for name in fit.names if name.startswith(f"{kind}.")]
    at = [fit.names.index(name) for name in names]
    unit = fit.unknowns.sigma[at]
    off = fit.values[at] - true_numbers(fit.unknowns.scene, truth, kind, names)
    assert (np.abs(off) < 3.0 * fit.sigmas[at]).all()
    covariance = fit.covariance[np.ix_(at, at)] * np.outer(unit, unit)
    assert off @ np.linalg.solve(covariance, off) < 3.0 * len(at)
    if kind == "window":
        assert fit.values[names.index("window.tilt_x") + at[0]] > 2.0 * fit.sigmas[at[0]]
        (said,) = [one.sentence for one in weaknesses(fit) if "window window" in one.sentence]
        assert "window.thickness" in said
        assert "between equal media its distance moves no ray" in said


def true_numbers(nominal: Scene, truth: Scene, kind: str, names: list[str]) -> np.ndarray:
    """The wall's true numbers, counted from where the scene file has it."""
    (believed,), (true,) = ([b for b in scene.bodies if b.name == kind] for scene in (nominal, truth))
    if isinstance(true, Window):
        tilt = float(np.arctan2(true.normal[0], true.normal[2]))
        known = {"tilt_x": tilt, "tilt_y": 0.0, "thickness": true.thickness_mm, "n": true.medium.n(532.0)}
    else:
        assert isinstance(true, Tube)
        assert isinstance(believed, Tube)
        values = [0.2, -0.25, 0.004, -0.003, true.outer_radius_mm, true.inner_radius_mm, true.medium.n(532.0)]
        known = dict(zip((number.name for number in believed.numbers(532.0)), values, strict=True))
    return np.array([known[name.split(".")[1]] for name in names])
