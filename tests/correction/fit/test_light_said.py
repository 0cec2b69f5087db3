"""What a calibration says of the light of its target frames: once, and in digits that mean something."""

from dataclasses import replace
from types import SimpleNamespace

from correction.fit.judge.weakness import _of_light
from correction.fit.solve.light import light_uncertainty
from sim.demo.scenes import demo_scene
from tracer.light import line
from tracer.media import MEDIA


def doubt(unsure_nm):
    scene = demo_scene("two_spheres_500")
    scene = scene.with_bodies([replace(ball, medium=MEDIA["N-BK7"]) for ball in scene.bodies])
    return light_uncertainty(scene, replace(line(625.0), unsure_nm=unsure_nm))


def test_how_well_a_wavelength_is_known_has_no_digits_beyond():
    assert "is known to 117 nm, n to" in doubt(116.591).sentence
    assert "is known to 4.6 nm, n to" in doubt(4.591).sentence


def test_a_light_that_cannot_be_the_told_one_is_not_also_said_to_be_known():
    fit = SimpleNamespace(light=doubt(116.591), verdict=SimpleNamespace(wrong_light=""))
    assert len(_of_light(fit)) == 1
    fit.verdict.wrong_light = "the light of the target frames seems to have a mean wavelength of 507 +- 14 nm"
    assert _of_light(fit) == []
