"""What is foreseen of the sheet: nothing without glass, much through a broad ring, less with fewer pixels."""

import numpy as np
import pytest

from correction.fitted.scene_sigma import SceneSigma
from correction.light_sheet.double_views import double_views
from correction.light_sheet.forecast import sheet_forecast
from rtpiv.verbs.trace import trace
from tests.correction.light_sheet.particle_frames import camera
from tracer.light_sheet import UNMEASURED_MM
from tracer.scene.scene_file import dump_scene
from tracer.strategies.sensitivity import CAMERA, SPHERE


def forecast(name, size_px, step=1):
    scene = camera(name, size_px).scene
    return sheet_forecast(scene, double_views(scene, step=step))


@pytest.mark.slow
def test_a_broad_ring_tells_much_and_more_pixels_more():
    coarse, fine = forecast("three_spheres_500", 336), forecast("three_spheres_500", 672)
    assert fine.sigma_mm < 0.4 * coarse.sigma_mm < 0.02
    assert fine.tilt_sigma_deg < coarse.tilt_sigma_deg < 0.1
    assert "too little" not in fine.sentence


@pytest.mark.parametrize(
    ("name", "size_px", "crop_px", "pairs", "found_mm"),
    [
        ("one_sphere_500", 504, None, 20, (0.0833,)),
        ("two_spheres_500", 1008, 560, 30, (0.1294, 0.1566)),
        ("three_spheres_500", 504, None, 20, (0.0138,)),
    ],
)
def test_what_drawn_sheets_were_told_to_was_foreseen(name, size_px, crop_px, pairs, found_mm):
    """Sigmas of sheets found in simulated flows; behind one ball a sixth of them was promised."""
    scene = camera(name, size_px, crop_px=crop_px).scene
    low, high = sheet_forecast(scene, double_views(scene, step=3), pairs=pairs).range_mm
    assert low < min(found_mm)
    assert max(found_mm) < high


def test_a_coarse_look_says_the_same():
    every, third = forecast("three_spheres_500", 504), forecast("three_spheres_500", 504, step=3)
    assert third.area_mm2 == pytest.approx(every.area_mm2, rel=0.02)
    assert third.sigma_mm == pytest.approx(every.sigma_mm, rel=0.1)


def test_bend_and_an_unsure_scene_are_foreseen():
    """Chance alone would be 0.06 mm at 1008 px; the bend is worth 0.36 mm, a third of which stays."""
    scene = camera("two_spheres_500", 1008).scene
    views = double_views(scene, step=4)
    exact = sheet_forecast(scene, views)
    assert 0.09 < exact.sigma_mm < 0.16
    root = np.zeros((len(CAMERA) + len(SPHERE) * len(scene.spheres), 1))
    root[len(CAMERA) + len(SPHERE) + 2, 0] = 0.02
    assert sheet_forecast(scene, views, SceneSigma(scene.content_hash(), root)).sigma_mm > 1.5 * exact.sigma_mm


def test_little_and_nothing_are_said():
    narrow = forecast("two_spheres_500", 504)  # its ring is five pixels wide
    assert narrow.sigma_mm > 0.15
    assert "so measure it" in narrow.sentence
    nothing = camera("two_spheres_500", 252).scene.with_bodies(())
    bare = sheet_forecast(nothing, double_views(nothing))
    assert bare.sigma_mm == pytest.approx(UNMEASURED_MM)
    assert "nothing is seen twice" in bare.sentence


def test_trace_says_it(tmp_path, capsys):
    scene = camera("three_spheres_500", 252).scene
    (tmp_path / "scene.yaml").write_text(dump_scene(scene))
    found = trace(tmp_path / "scene.yaml", tmp_path / "out", pictures=False)
    assert found.sheet.sigma_mm < 0.1
    assert "of the light sheet are seen twice" in " ".join(capsys.readouterr().out.split())
