"""A camera that looks by a mirror: the same frames from right to left give the same scene."""

from dataclasses import replace

import numpy as np
import pytest

from correction.errors import GlassNotSeen
from correction.fit.scene_fit import fit_scene
from correction.target.turned_frame import turn_between
from ground.errors import ConfigError
from tests.correction.fit.benches import bench
from tests.slow_cases import slow_but
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.trace import trace

MADE = "two_spheres_500", 6, (), (), 714
UNLIKE = "one_sphere_500", 3, (), (), 504  # along its axes: two balls behind each other are alike


def test_frames_from_right_to_left_give_the_same_scene_and_map():
    made = bench(*MADE)
    camera = made.nominal.camera
    mirrored = [replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1])) for frame in made.frames]
    usual = fit_scene(made.nominal, made.frames, made.board).measured_scene
    found = fit_scene(replace(made.nominal, camera=camera.mirrored()), mirrored, made.board).measured_scene
    assert found.camera.is_mirrored
    assert np.abs(np.subtract(found.camera.position_mm, usual.camera.position_mm)).max() < 1e-3
    for one, other in zip(found.spheres, usual.spheres, strict=True):
        assert np.abs(np.subtract(one.centre_mm, other.centre_mm)).max() < 5e-3
    last = camera.sensor_px[0] - 1.0
    pixels = np.stack(np.meshgrid(*[np.arange(5.0, last, 31.0)] * 2), axis=-1).reshape(-1, 2)
    seen, same = trace(usual, pixels), trace(found, pixels * (-1.0, 1.0) + (last, 0.0))
    both = seen.recovered & same.recovered
    assert both.mean() > 0.6
    assert np.median(np.linalg.norm((seen.plane_mm - same.plane_mm)[both], axis=1)) < 1e-3


TURNS = {
    "is mirrored left to right": lambda image: image[:, ::-1],
    "is mirrored upside down": lambda image: image[::-1],
    "is turned by 180 degrees": lambda image: image[::-1, ::-1],
    "is turned by 90 degrees counterclockwise": np.rot90,
    "has rows and columns exchanged": lambda image: image.T,
}


def test_turned_and_mirrored_frames_are_named_in_noise_and_other_light():
    bare, glass = (next(f.image for f in bench(*UNLIKE).frames if f.glass is g) for g in (False, True))
    for words, turn in TURNS.items():
        dim = 0.3 * turn(glass) + np.random.default_rng(1).normal(0.0, 8.0, turn(glass).shape)
        dim *= np.linspace(0.4, 1.6, dim.shape[1])  # a lamp that shines from elsewhere
        assert turn_between(bare, np.ascontiguousarray(dim, np.float32)) == words
    assert turn_between(bare, np.roll(glass, (9, 14), (0, 1))) == ""  # the camera has moved


@pytest.mark.parametrize("words", slow_but(TURNS, "is turned by 180 degrees"))
def test_frames_with_glass_that_alone_are_turned_or_mirrored_are_refused(words):
    made = bench(*UNLIKE)
    frames = [
        replace(frame, image=np.ascontiguousarray(TURNS[words](frame.image)))
        for frame in made.frames
        if frame.glass
    ]
    bare = [frame for frame in made.frames if not frame.glass]
    with pytest.raises(GlassNotSeen, match=rf"glass_z\+0mm {words} against target_clear.*: turn the file back"):
        fit_scene(made.nominal, [*bare, *frames], made.board)


def test_a_scene_file_keeps_that_its_camera_is_mirrored(tmp_path):
    scene = bench(*MADE).nominal
    scene = replace(scene, camera=scene.camera.mirrored())
    path = tmp_path / "scene.yaml"
    path.write_text(dump_scene(scene))
    assert "mirrored: true" in path.read_text()
    assert load_scene(path).camera == scene.camera
    path.write_text(path.read_text().replace("mirrored: true", "mirrored: false"))
    assert load_scene(path).camera == scene.camera.mirrored()


def test_a_left_handed_rotation_is_refused_with_the_key_to_give(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "camera: {focal_px: 400.0, sensor_px: [96, 96], position_mm: [0.0, 0.0, 500.0],"
        " rotation: [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]}\nbodies: []\n"
    )
    with pytest.raises(ConfigError, match="mirrored: true"):
        load_scene(path)
