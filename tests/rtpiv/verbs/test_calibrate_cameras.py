"""`rtpiv calibrate --join`: balls better known by two cameras than by one, and what cameras contradict."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile

from correction.fitted.scene_sigma import SceneSigma
from ground.map_file import load_arrays
from rtpiv.verbs.calibrate_cameras import calibrate_cameras
from sim.demo.scenes import at_size, demo_scene, misalign
from tests.correction.fit.benches import SIZE_PX, SQUARE_MM, photograph
from tracer.bodies import translate_by
from tracer.camera import look_at
from tracer.scene.scene_file import dump_scene

SIZE = 720
SQUARE = SQUARE_MM * SIZE_PX / SIZE
pytestmark = pytest.mark.slow


def folder_of(folder, degrees, seed, bodies=None):
    """Frames of the target and nominal scene of a camera on an arc about y; returns the true scene."""
    scene = at_size(demo_scene("two_spheres_500"), SIZE)
    angle, distance = np.deg2rad(degrees), scene.camera.position_mm[2]
    place = (float(distance * np.sin(angle)), 0.0, float(distance * np.cos(angle)))
    nominal = scene.with_camera(replace(scene.camera, position_mm=place, rotation=look_at(place, (0.0, 0.0, 0.0))))
    truth = misalign(nominal, seed)
    truth = truth if bodies is None else truth.with_bodies(bodies)
    folder.mkdir()
    folder.with_suffix(".yaml").write_text(dump_scene(nominal))
    for glass, name in ((False, "target_clear.tif"), (True, "target_glass.tif")):
        frame = photograph(truth if glass else truth.bare(), glass, 0.0, seed + glass, SQUARE)
        tifffile.imwrite(folder / name, frame.image)
    return truth


def joined(tmp_path, others):
    return calibrate_cameras(
        [tmp_path / "left", tmp_path / "right"],
        scene=[tmp_path / "left.yaml", tmp_path / "right.yaml"],
        out=tmp_path / others,
        square_mm=SQUARE,
        pictures=False,
    )


def test_balls_are_better_known_and_the_files_hold_what_is_common(tmp_path):
    truth = folder_of(tmp_path / "left", 0.0, 1)
    folder_of(tmp_path / "right", 15.0, 2, truth.bodies)
    found = joined(tmp_path, "fit")
    assert not found.warning
    assert 0.3 < found.residual_sigma < 1.7
    sizes = np.linalg.norm(found.fits[0].ball_root[:, :3], axis=2)
    off = np.array([ball.centre_mm for ball in found.fits[0].scene.spheres])
    off -= [ball.centre_mm for ball in truth.spheres]
    assert np.abs(off).max() < 0.05  # the size of the print is known to 0.06 %, and the depth with it
    assert (found.sigmas < found.sigmas_alone + 1e-9).all()
    assert (found.sigmas < 0.7 * found.sigmas_alone[0]).sum() >= 4
    assert np.sqrt(np.mean(np.square(off / sizes))) < 2.0
    centres = [fit.scene.spheres[0].centre_mm for fit in found.fits]
    assert centres[0] == pytest.approx(centres[1], abs=1e-7)
    sigmas = [SceneSigma.load(tmp_path / f"fit/camera-{k}/fit.npz") for k in (1, 2)]
    assert sigmas[0].joint == sigmas[1].joint
    key, common = sigmas[0].joint
    assert key
    assert common == len(found.names)
    balls = slice(14, 14 + 5 * len(truth.spheres))
    np.testing.assert_allclose(sigmas[0].root[balls, :common], sigmas[1].root[balls, :common], atol=1e-7)
    # A file of one camera does not change.
    assert "joint" in load_arrays(tmp_path / "fit/camera-1/fit.npz", "scene fit")[0]


def test_glass_that_was_moved_between_the_cameras_is_said(tmp_path):
    truth = folder_of(tmp_path / "left", 0.0, 1)
    moved = [body.moved(translate_by((0.1, 0.0, 0.0))) for body in truth.bodies]
    folder_of(tmp_path / "right", 15.0, 2, moved)
    found = joined(tmp_path, "fit")
    assert "stood elsewhere for one of them" in found.warning
    assert not any(fit.joint[1] for fit in found.fits)
