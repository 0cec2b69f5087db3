"""A tilted sensor (Scheimpflug): against points of the sensor in space, through its file, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from tracer.camera import Camera, Lens, look_at
from tracer.errors import SceneError
from tracer.pupil import Pupil
from tracer.scene.scene_file import dump_scene, load_scene

PLACE = (200.0, 0.0, 230.0)
CAMERA = Camera(3000.0, (511.5, 400.0), (1024, 801), PLACE, look_at(PLACE, (0.0, 0.0, 0.0)))


def turned(axis, angle, about):
    """A vector turned about another (Rodrigues)."""
    along = about * (about @ axis)
    return along + np.cos(angle) * (axis - along) + np.sin(angle) * np.cross(about, axis)


@pytest.mark.parametrize("tilt", [(0.0, 0.2), (-0.1, 0.0), (0.15, -0.3)])
def test_rays_go_from_the_pinhole_through_the_points_of_the_sensor(tilt):
    first, second, ahead = np.array(CAMERA.rotation)
    # The picture before the pinhole: turned about its u axis, then about its own v axis as that one lies then.
    v_axis = turned(second, tilt[0], first)
    u_axis = turned(first, tilt[1], v_axis)
    rng = np.random.default_rng(1)
    pixels = rng.uniform(0.0, 800.0, (50, 2))
    off = pixels - CAMERA.principal_px
    points = CAMERA.focal_px * ahead + off[:, :1] * u_axis + off[:, 1:] * v_axis
    wanted = points / np.linalg.norm(points, axis=1)[:, None]
    np.testing.assert_allclose(CAMERA.with_tilted_sensor(*tilt).directions(pixels), wanted, atol=1e-12)


def test_a_sensor_that_meets_plane_and_lens_in_one_line_has_it_in_focus():
    # Scheimpflug: lens of focal length f; the plane is seen at 41 degrees, tan(tilt) = tan(41) m, m = f/(L - f).
    f_mm, distance = 60.0, float(np.hypot(PLACE[0], PLACE[2]))
    angle = np.arctan2(PLACE[0], PLACE[2])
    tilt = np.arctan(np.tan(angle) * f_mm / (distance - f_mm))
    image_mm = 1.0 / (1.0 / f_mm - 1.0 / distance)
    camera = replace(CAMERA, focal_px=image_mm / 0.01)
    sharp = []
    for sign in (1.0, -1.0):
        tilted = camera.with_tilted_sensor(0.0, sign * tilt)
        pixels = np.stack((np.linspace(0.0, 1023.0, 20), np.full(20, 400.0)), axis=1)
        rays = tilted.directions(pixels)
        depth = rays @ np.array(camera.rotation)[2]  # of a unit along the ray, along the lens axis
        to_plane = -PLACE[2] / rays[:, 2] * depth  # distance of the point on the plane along the lens axis
        focused_at = 1.0 / (1.0 / f_mm - 1.0 / to_plane)
        # Where the ray meets the sensor, along the lens axis.
        normal, at = np.array(tilted.rotation)[2], tilted.focal_px * 0.01
        to_sensor = at / (rays @ normal) * depth
        sharp.append(np.abs(to_sensor - focused_at).max())
    assert min(sharp) < 1e-6
    assert max(sharp) > 0.1


def test_a_file_with_a_tilt_is_written_as_the_camera_that_it_is(tmp_path):
    text = """camera: {f_mm: 60.0, L_mm: 300.0, pixel_pitch_um: 10.0, sensor_px: [1024, 801],
 position_mm: [200.0, 0.0, 230.0], sensor_tilt_deg: [0.0, 11.0]}
"""
    file, written = tmp_path / "scene.yaml", tmp_path / "again.yaml"
    file.write_text(text)
    scene = load_scene(file)
    assert scene.camera.principal_px[0] != 511.5
    written.write_text(dump_scene(scene))
    again = load_scene(written)
    pixels = np.array([[0.0, 0.0], [1000.0, 700.0]])
    np.testing.assert_allclose(again.camera.directions(pixels), scene.camera.directions(pixels), atol=1e-12)


def test_no_tilt_is_the_same_camera_and_lens_terms_are_refused():
    assert CAMERA.with_tilted_sensor(0.0, 0.0) is CAMERA
    for camera in (replace(CAMERA, lens=Lens(k1=0.1)), replace(CAMERA, pupil=Pupil(2.0, 300.0))):
        with pytest.raises(SceneError, match="tilted sensor"):
            camera.with_tilted_sensor(0.0, 0.1)
    with pytest.raises(SceneError, match="80 degrees"):
        CAMERA.with_tilted_sensor(1.0, 1.3)
