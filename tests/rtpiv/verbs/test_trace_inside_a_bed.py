"""`rtpiv trace` between the balls of a bed: its first figure is the share of the gaps that is seen."""

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from daq.bench.scene_plausibility import scene_questions
from rtpiv.analysis.gaps import gap_share
from rtpiv.verbs.trace import trace
from tests.correction.small_scenes import EXAMPLES
from tests.tracer.scenes import ball, camera_at
from tracer.scene.scene import Scene
from tracer.scene.scene_file import load_scene
from tracer.strategies.ray_map import build_ray_map

R, CELL = 20.0, 46.2


@pytest.mark.parametrize(("name", "low", "high"), [("inside_a_bed", 0.999, 1), ("inside_a_bed_deeper", 0.08, 0.1)])
def test_by_hand_all_of_the_top_layer_and_nine_per_cent_below_it(name, low, high, capsys):
    traced = trace(load_scene(EXAMPLES / f"{name}.yaml"), pictures=False)
    assert traced.gaps is not None
    assert low <= traced.gaps.share <= high
    assert capsys.readouterr().out.startswith("inside a bed: ")


def test_the_gaps_are_those_of_discs():
    """Nine discs of a square lattice, all in view: their hull less their areas, and lines of sight over it."""
    balls = [ball(f"b{i}{j}", i * CELL, j * CELL, 0.0, R) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    scene = Scene(camera_at((0.0, 0.0, 2000.0), focal_px=8000.0, sensor_px=(640, 640)), tuple(balls))
    gaps = gap_share(scene, build_correction_map(scene, build_ray_map(scene)))
    hull = (2.0 * CELL) ** 2 + 4.0 * 2.0 * CELL * R + np.pi * R**2
    assert gaps.gas_mm2 == pytest.approx(hull - 9.0 * np.pi * R**2, rel=0.01)
    assert gaps.glass == pytest.approx(9.0 * np.pi * R**2 / 160.0**2, rel=0.01)
    assert gaps.share > 0.99


def test_one_ball_and_balls_before_the_plane_have_no_gaps():
    for z in (0.0, 20.0):
        scene = Scene(camera_at(focal_px=1000.0, sensor_px=(64, 64)), (ball("one", 0.0, 0.0, z, R),))
        assert gap_share(scene, build_correction_map(scene, build_ray_map(scene))) is None


def asked(tmp_path, *heights_mm):
    """Questions of `check` about balls of 10 mm in a row, at these heights."""
    balls = [
        f"  - {{name: b{n}, kind: sphere, centre_mm: [{25.0 * n}, 0.0, {z}], radius_mm: 10.0, material: N-BK7}}"
        for n, z in enumerate(heights_mm)
    ]
    camera = "camera: {f_mm: 100.0, L_mm: 900.0, pixel_pitch_um: 11.0, sensor_px: [1008, 1008]}"
    (tmp_path / "scene.yaml").write_text("\n".join(["wavelength_nm: 532.0", camera, "bodies:", *balls]))
    return " ".join(scene_questions(tmp_path / "scene.yaml"))


def test_a_wrong_sign_of_z_is_asked_about(tmp_path):
    assert "all stand behind the plane z = 0" in asked(tmp_path, -10.0, -10.0)
    assert "b1: reaches 15 mm through the plane, as no other ball does" in asked(tmp_path, 10.0, -5.0)
    assert "plane" not in asked(tmp_path, 10.0, 10.0)
    assert "plane" not in asked(tmp_path, 0.0, 0.0)
    assert "plane" not in asked(tmp_path, 2.0)
