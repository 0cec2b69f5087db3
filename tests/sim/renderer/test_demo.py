"""Frame sets: what is on disk is what is said to be there."""

import cv2
import numpy as np
import pytest
import tifffile

from sim.demo.frames import load_frames, make_frames
from sim.demo.scenes import SCENES, at_size, demo_scene, misalign
from sim.renderer.sensor import SILENT
from tracer.errors import SceneError


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return make_frames("two_spheres_500", 504, 3, tmp_path_factory.mktemp("demo"), sensor=SILENT, samples=3)


def test_folder_holds_the_whole_set(frames):
    targets = ["clear_z+10mm", "clear_z+20mm", "clear_z-10mm", "clear_z-20mm", "clear"]
    targets += ["glass_z-10mm", "glass_z-20mm", "glass"]
    wanted = {f"target_{t}" for t in targets} | {f"particles_{v}_{ab}" for v in ("clear", "glass") for ab in "ab"}
    assert set(frames.kinds) == wanted
    names = {path.name for path in frames.folder.iterdir()}
    assert names == {f"{kind}.tif" for kind in wanted} | {"scene.yaml", "truth.yaml", "frames.json"}
    image = frames.frame("target_glass")
    assert (image.shape, image.dtype) == ((504, 504), np.uint16)
    with tifffile.TiffFile(frames.path("target_glass")) as file:
        assert file.pages[0].compression == tifffile.COMPRESSION.ADOBE_DEFLATE


def test_truth_is_hidden_and_read_back(frames):
    again = load_frames(frames.folder)
    assert again == frames
    assert frames.nominal.content_hash() == at_size(demo_scene("two_spheres_500"), 504).content_hash()
    assert frames.truth.content_hash() == misalign(frames.nominal, 3).content_hash()
    assert frames.truth.content_hash() != frames.nominal.content_hash()


@pytest.mark.parametrize("kind", ["clear", "clear_z+10mm", "clear_z-20mm"])
def test_board_corners_lie_where_the_true_camera_projects_them(frames, kind):
    z = float(kind.removeprefix("clear_z").removesuffix("mm")) if "z" in kind else 0.0
    i, j = np.mgrid[-20:21:3, -20:21:3]
    corners = np.stack((2.5 * i, 2.5 * j, np.full(i.shape, z)), axis=-1).reshape(-1, 3)
    expected = frames.truth.camera.project(corners).astype(np.float32)
    image = frames.frame(f"target_{kind}").astype(np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    found = cv2.cornerSubPix(image, expected.reshape(-1, 1, 2).copy(), (2, 2), (-1, -1), stop).reshape(-1, 2)
    assert np.abs((found - expected).mean(axis=0)).max() < 0.01
    assert (found - expected).std() < 0.09  # cornerSubPix itself: 0.07 px at 8 px a square, whatever the sampling


def test_particles_move_fourteen_pixels_to_the_north_east(frames):
    a, b = (frames.frame(f"particles_clear_{ab}").astype(np.float32)[40:-40, 40:-40] for ab in "ab")
    (right, down), _ = cv2.phaseCorrelate(a, b)
    assert np.hypot(right, down) == pytest.approx(14.0, abs=0.1)
    assert right == pytest.approx(-down, abs=0.1)
    scale = frames.truth.camera.focal_px / frames.truth.camera.position_mm[2]
    assert np.hypot(*frames.shift_mm) * scale == pytest.approx(14.0, abs=0.05)


def test_a_set_repeats_and_replaces(tmp_path):
    one = make_frames("pair_off_axis", 64, 1, tmp_path / "one", stack=False, samples=2)
    make_frames("pair_off_axis", 64, 2, tmp_path / "two", stack=False, samples=2)
    two = make_frames("pair_off_axis", 64, 1, tmp_path / "two", stack=False, samples=2)
    for kind in one.kinds:
        assert np.array_equal(one.frame(kind), two.frame(kind))
    a, clear = one.frame("target_glass"), one.frame("target_clear")
    assert not np.array_equal(a[:10], clear[:10])  # each frame has noise of its own


@pytest.mark.parametrize("name", sorted(SCENES))
def test_misalignment_is_small_legal_and_everywhere(name):
    nominal = demo_scene(name)
    for seed in range(8):
        truth = misalign(nominal, seed)
        for before, after in zip(nominal.spheres, truth.spheres, strict=True):
            step = np.abs(np.subtract(after.centre_mm, before.centre_mm))
            assert 0.0 < step.max() < 0.8
            assert after.radius_mm == before.radius_mm
        assert 0.0 < np.abs(np.subtract(truth.camera.position_mm, nominal.camera.position_mm)).max() < 0.61
        turn = nominal.camera.rotation_matrix @ truth.camera.rotation_matrix.T
        assert 1e-5 < np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)) < 0.006
        assert truth.camera.focal_px == nominal.camera.focal_px
    barrel = misalign(nominal, 1, barrel=0.018).camera
    edge = barrel.ideal([(barrel.principal_px[0] + 1007.5, barrel.principal_px[1])])[0, 0] - barrel.principal_px[0]
    assert edge == pytest.approx(1007.5 * 1.018)


def test_size_keeps_the_field_of_view():
    full, half = demo_scene("tilted").camera, at_size(demo_scene("tilted"), 1008).camera
    # The outer edges of the sensor, half a pixel outside the outermost centres.
    for whole, part in ((-0.5, -0.5), (2015.5, 1007.5)):
        assert half.directions((part, part)) == pytest.approx(full.directions((whole, whole)), abs=1e-14)


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(SceneError, match="two_spheres_500"):
        demo_scene("nowhere")
