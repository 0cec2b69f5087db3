"""Windows and tubes found from target frames of the renderer's optics, where the scene file has them otherwise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from correction.fit.adjustment import Adjustment
from correction.fit.judge.result import SceneFit
from correction.fit.judge.weakness import two_gases, weaknesses
from correction.fit.scene_fit import fit_scene
from correction.fit.solve.unknowns import unknowns_of
from correction.fitted.map_sigma import sigma_at
from correction.grid import grid_of
from correction.target import Chessboard
from rtpiv.command_line.cli import DONE, main
from sim.demo.frames import make_frames
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.benches import errors_behind, map_error_px, photograph
from tests.correction.fit.test_honesty import PRIORS, seen
from tracer.bodies import Body, Sphere, Tube, Window
from tracer.bodies.sphere import Core
from tracer.media import MEDIA, VACUUM, ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene
from tracer.strategies.trace import trace

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


# Balls behind a window, fitted from target frames of the renderer's own optics; walls are held.


EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_balls_in_a_furnace_are_fitted_through_its_window(tmp_path: Path) -> None:
    """Rms of the map inside r < 0.75 R below 0.02 px, centres within 10 um, from a start 0.2 mm off."""
    made = make_frames(load_scene(EXAMPLES / "furnace_window.yaml"), 1008, 5, tmp_path / "frames")
    fit, nominal = tmp_path / "fit", tmp_path / "frames" / "scene.yaml"
    words = ["calibrate", str(made.folder), "--scene", str(nominal), "-o", str(fit), "--no-pictures"]
    assert main(words) == DONE
    found = load_scene(fit / "scene.yaml")
    for ball, truth in zip(found.spheres, made.truth.spheres, strict=True):
        assert np.linalg.norm(np.array(ball.centre_mm) - truth.centre_mm) < 0.01
    pixels = np.stack(np.meshgrid(*[np.arange(8.0, 1000.0, 12.0)] * 2), axis=-1).reshape(-1, 2)
    seen, true = trace(found, pixels), trace(made.truth, pixels)
    lower = made.truth.spheres[-1]
    middle = np.linalg.norm(true.plane_mm - lower.centre_mm[:2], axis=-1) < 0.75 * lower.radius_mm
    same = seen.recovered & true.recovered & (seen.rays["key"] == true.rays["key"]) & middle
    px_per_mm = found.camera.focal_px / float(np.linalg.norm(found.camera.position_mm))
    error_px = px_per_mm * (seen.plane_mm - true.plane_mm)[same]
    assert same.sum() > 3000
    assert np.sqrt(np.mean(error_px**2)) < 0.02


# A hollow ball and the room around it: one gas, or a sentence that says what two of them do.


FILE = """
ambient: {ambient}
camera: {{focal_px: 1000.0, sensor_px: [200, 200], position_mm: [0.0, 0.0, 500.0]}}
bodies:
  - {{name: shell, kind: sphere, centre_mm: [0.0, 0.0, 26.0], radius_mm: 25.0, material: {{n: 1.5}},
     core: {{radius_mm: 24.0, material: {core}}}}}
"""


@pytest.mark.parametrize("ambient", ["{n: 1.0}", "air", "vacuum", "{n: 1.00027}"])
def test_air_in_a_ball_is_the_gas_of_the_room(tmp_path, ambient):
    path = tmp_path / "scene.yaml"
    path.write_text(FILE.format(ambient=ambient, core="air"))
    scene = load_scene(path)
    (shell,) = scene.spheres
    assert shell.cores[0].medium.n(532.0) == scene.n_ambient
    assert not two_gases(scene)


def test_air_in_a_ball_under_water_is_air(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(FILE.format(ambient="{n: 1.333}", core="air"))
    scene = load_scene(path)
    assert scene.spheres[0].cores[0].medium == MEDIA["air"]
    assert not two_gases(scene)


@pytest.mark.parametrize(("ambient", "core"), [("air", "{n: 1.0}"), ("{n: 1.0003}", "vacuum")])
def test_two_gases_are_named(tmp_path, ambient, core):
    path = tmp_path / "scene.yaml"
    path.write_text(FILE.format(ambient=ambient, core=core))
    (sentence,) = two_gases(load_scene(path))
    assert "shell.z and n of its glass run away together" in sentence


def test_the_wrong_gas_shows_in_no_residual_and_is_said():
    """Truth holds what is around it; the fit believes air in vacuum, and finds another ball."""
    scene = at_size(demo_scene("one_sphere_500"), 500)
    (ball,) = scene.spheres
    ball = replace(ball, name="shell", centre_mm=(3.0, -2.0, 55.0), radius_mm=50.0, medium=ConstantMedium(1.5))
    truth = scene.with_bodies([replace(ball, cores=(Core(48.0, VACUUM),))])
    told = scene.with_bodies([replace(ball, cores=(Core(48.0, MEDIA["air"]),))])
    frames = [seen(truth, glass, np.random.default_rng(1)) for glass in (False, True)]
    fits = {}
    for name, believed in (("right", truth), ("wrong", told)):
        bench = unknowns_of(believed, [0.0], PRIORS)
        fits[name] = Adjustment().estimate(bench, bench.start, frames, ())
    off = {name: abs(fit.scene.spheres[0].centre_mm[2] - 55.0) for name, fit in fits.items()}
    rms = {name: float(fit.corners.rms_px(behind=True).max()) for name, fit in fits.items()}
    print(off, rms, {name: fit.scene.spheres[0].medium.n(532.0) for name, fit in fits.items()})
    assert off["wrong"] > off["right"]
    assert rms["wrong"] < 1.1 * rms["right"]
    assert any("run away together" in weakness.sentence for weakness in weaknesses(fits["wrong"]))
    assert not any("run away together" in weakness.sentence for weakness in weaknesses(fits["right"]))
