"""Frames of a camera that looks by a mirror: named where nobody said so, and kept by the scene file."""

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

UNLIKE = "one_sphere_500", 3, (), (), 504  # along its axes: two balls behind each other are alike


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
    scene = bench(*UNLIKE).nominal
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
