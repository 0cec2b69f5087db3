"""A hollow ball and the room around it: one gas, or a sentence that says what two of them do."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fit.adjustment import Adjustment
from correction.fit.judge.weakness import two_gases, weaknesses
from correction.fit.solve.unknowns import unknowns_of
from sim.demo.scenes import at_size, demo_scene
from tests.correction.fit.test_honesty import PRIORS, seen
from tracer.bodies.sphere import Core
from tracer.media import MEDIA, VACUUM, ConstantMedium
from tracer.scene.scene_file import load_scene

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
