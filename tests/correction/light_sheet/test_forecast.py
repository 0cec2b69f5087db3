"""What is foreseen of the sheet: nothing without glass, much through a broad ring, less with fewer pixels."""

import pytest

from correction.light_sheet.double_views import double_views
from correction.light_sheet.forecast import sheet_forecast
from daq.verbs.trace import trace
from tests.correction.light_sheet.particle_frames import camera
from tracer.light_sheet import UNMEASURED_MM
from tracer.scene_file import dump_scene


def forecast(name, size_px, step=1):
    return sheet_forecast(double_views(camera(name, size_px).scene, step=step))


def test_a_broad_ring_tells_much_and_more_pixels_more():
    coarse, fine = forecast("three_spheres_500", 336), forecast("three_spheres_500", 672)
    assert fine.sigma_mm < 0.4 * coarse.sigma_mm < 0.02
    assert fine.tilt_sigma_deg < coarse.tilt_sigma_deg < 0.1
    assert "too little" not in fine.sentence


def test_a_coarse_look_says_the_same():
    every, third = forecast("three_spheres_500", 504), forecast("three_spheres_500", 504, step=3)
    assert third.area_mm2 == pytest.approx(every.area_mm2, rel=0.02)
    assert third.sigma_mm == pytest.approx(every.sigma_mm, rel=0.1)


def test_little_and_nothing_are_said():
    narrow = forecast("two_spheres_500", 504)  # its ring is five pixels wide
    assert narrow.sigma_mm > 0.15
    assert "so measure it" in narrow.sentence
    bare = sheet_forecast(double_views(camera("two_spheres_500", 252).scene.with_bodies(())))
    assert bare.sigma_mm == pytest.approx(UNMEASURED_MM)
    assert "nothing is seen twice" in bare.sentence


def test_trace_says_it(tmp_path, capsys):
    scene = camera("three_spheres_500", 252).scene
    (tmp_path / "scene.yaml").write_text(dump_scene(scene))
    found = trace(tmp_path / "scene.yaml", tmp_path / "out")
    assert found.sheet.sigma_mm < 0.1
    assert "of the light sheet are seen twice" in " ".join(capsys.readouterr().out.split())
