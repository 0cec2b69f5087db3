"""Windows and tubes found from target frames of the renderer's optics, where the scene file has them otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import weaknesses
from correction.fit.scene_fit import fit_scene
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.target import Chessboard
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.benches import errors_behind, map_error_px, photograph
from tracer.bodies import Body, Sphere, Tube, Window
from tracer.media import MEDIA
from tracer.scene.scene import Scene

SIZE_PX, SQUARE_MM = 700, 3.5
GLASS = MEDIA["borosilicate"]
BASE = at_size(demo_scene("two_spheres_500"), SIZE_PX)
WINDOW = Window("window", (0.0, 0.0, 160.0), (0.0, 0.0, 1.0), 10.0, 90.0, GLASS)
TUBE = Tube("tube", (0.0, -150.0, 0.0), (0.0, 150.0, 0.0), 50.0, 45.0, GLASS)
LEAN = float(np.deg2rad(1.0))
TRUE = {  # in the order of `Body.numbers`, from where the scene file has them
    "window": (LEAN, 0.0, 10.0, GLASS.n(532.0)),
    "tube": (0.2, -0.25, 0.004, -0.003, 50.2, 45.1, GLASS.n(532.0) + 0.001),
}


def fitted(nominal: Scene, wall: Body) -> tuple[SceneFit, Scene]:
    """The fit from a scene whose wall is in truth another one, and the truth."""
    truth = misalign(nominal, 1)
    truth = truth.with_bodies([wall if body.name == wall.name else body for body in truth.bodies])
    frames = [photograph(truth.bare(), False, 0.0, 1, SQUARE_MM)]
    frames += [photograph(truth, True, 0.0, 2, SQUARE_MM)] if nominal.spheres else []
    return fit_scene(nominal, frames, Chessboard(SQUARE_MM, 0.4 * SQUARE_MM)), truth


def check_numbers(fit: SceneFit, kind: str) -> None:
    """Every number of the wall within three sigmas, and all together within what they are known to together."""
    at = [place for place, name in enumerate(fit.names) if name.startswith(f"{kind}.")]
    off, unit = fit.values[at] - TRUE[kind], fit.unknowns.sigma[at]
    assert (np.abs(off) < 3.0 * fit.sigmas[at]).all()
    covariance = fit.covariance[np.ix_(at, at)] * np.outer(unit, unit)
    assert off @ np.linalg.solve(covariance, off) < 3.0 * len(at)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_window_that_leans_is_found_with_the_balls_behind_it() -> None:
    """10 mm, 1 degree, believed upright: map <= 0.05 px rms, numbers within their sigmas, the rest said."""
    fit, truth = fitted(BASE.with_bodies([WINDOW, *BASE.bodies]), WINDOW.with_numbers(TRUE["window"], 532.0))
    error_px, sigma_px, _ = errors_behind(fit, truth)
    assert np.sqrt(np.mean(error_px**2) / 2.0) < 0.05
    assert np.mean(error_px**2) < 4.0 * np.mean(sigma_px**2)
    check_numbers(fit, "window")
    tilt = fit.names.index("window.tilt_x")
    assert fit.values[tilt] > 2.0 * fit.sigmas[tilt]
    (said,) = [one.sentence for one in weaknesses(fit) if "window window" in one.sentence]
    assert "window.thickness" in said
    assert "between equal media its distance moves no ray" in said


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_tube_is_found_by_the_board_in_it() -> None:
    """100 x 5 mm, beside its place, leaning and too thick by tenths: map of what is seen in it <= 0.05 px rms."""
    nominal = replace(BASE, bodies=(TUBE,))
    fit, truth = fitted(nominal, TUBE.with_numbers(TRUE["tube"], 532.0))
    check_numbers(fit, "tube")
    grid = grid_of(truth.camera)
    u, v = np.meshgrid(np.arange(170.0, 535.0, 5.0), np.arange(5.0, 695.0, 10.0))  # 0.9 of the tube's inside
    pixels = np.stack((u.ravel(), v.ravel()), axis=-1)
    error_px = map_error_px(fit.scene, truth, pixels, grid)
    assert np.isfinite(error_px).all()
    assert np.sqrt(np.mean(error_px**2)) < 0.05
    sigma_px = sigma_at(fit, pixels, False) / grid.pitch_mm
    assert np.mean(error_px**2) < 4.0 * np.mean(sigma_px**2)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_a_tubes_edge_cuts_of_the_board_does_not_hold_its_radii() -> None:
    """Corners beside the edge, taken for whole ones, held the radii six sigmas off in silence."""
    side = 2.5
    true = (-0.240498749, 0.0832879232, 0.000107587284, -0.000319684612, 49.9642281, 45.0489962, 1.47395425)
    balls = [Sphere("a", (2.0, 20.5, 20.5), 20.0, GLASS), Sphere("b", (-2.0, -20.5, 20.5), 20.0, GLASS)]
    truth = misalign(BASE.with_bodies([TUBE, *balls]), 5).with_bodies([TUBE.with_numbers(true, 532.0)])
    frame = photograph(truth, False, 0.0, 500, side)
    fit = fit_scene(replace(BASE, bodies=(TUBE,)), [frame], Chessboard(side, 0.4 * side))
    for part, number in (("outer_radius", 4), ("inner_radius", 5), ("n", 6)):
        at = fit.names.index(f"tube.{part}")
        assert abs(fit.values[at] - true[number]) < 4.0 * fit.sigmas[at]
