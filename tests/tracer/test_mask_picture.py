"""A mask drawn as a picture leaves out its white pixels and no others, and is refused where it is none."""

import cv2
import numpy as np
import pytest
import tifffile

from correction.masked import _fill, mask_pixels, pixels_in, points_in
from correction.node_status import NodeStatus
from ground.errors import ConfigError
from sim.demo.scenes import at_size, demo_scene
from tests.loops import loop_over
from tracer.errors import SceneError
from tracer.masked import LEFT_OUT, left_out
from tracer.scene.scene_file import dump_scene, load_scene

H, W = 120, 160
V, U = np.mgrid[:H, :W]
R = np.hypot(U - 70.3, V - 61.7)
SPECKS = np.zeros((H, W), bool)
SPECKS[3, 5] = SPECKS[0] = SPECKS[50:52, 7] = SPECKS[70:80, 70:90] = SPECKS[119, 159] = True
SPECKS[73, 75] = SPECKS[75:77, 80:82] = False  # holes
DRAWN = {
    "disc": R < 40, "outside": R > 40, "ring": (R > 20) & (R < 40), "wall": V > 100, "specks": SPECKS,
    "blobs": cv2.GaussianBlur(np.random.default_rng(0).normal(size=(H, W)), (0, 0), 4.0) > 0.01,
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_white_pixels_are_left_out_and_no_others(tmp_path, name):
    cv2.imwrite(str(tmp_path / "mask.png"), 255 * DRAWN[name].astype(np.uint8))
    parts = left_out(tmp_path / "mask.png", (W, H))
    found = np.zeros((H, W), bool)
    for part in parts:
        assert part.why == LEFT_OUT
        found |= pixels_in(part, (H, W))
    np.testing.assert_array_equal(found, DRAWN[name])
    assert sum(len(part.outline_px) for part in parts) < {"wall": 5, "disc": 250}.get(name, 5000)


def test_pixels_of_an_outline_are_those_whose_middle_is_inside():
    """Row by row as point by point; on whole numbers too, where a middle lies on the outline."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[:40, :50]
    for number in range(100):
        outline = rng.uniform(-10.0, 60.0, (rng.integers(3, 12), 2))
        outline = np.rint(outline) if number % 3 == 0 else outline
        np.testing.assert_array_equal(_fill(outline, (40, 50)), points_in(outline, np.stack((u, v), axis=-1)))


@pytest.mark.parametrize(
    ("name", "kind", "white"),
    [("a.png", np.uint8, 1), ("a.png", np.uint16, 4095), ("a.tif", np.uint8, 255), ("a.bmp", np.uint8, 1),
     ("a.jpg", np.uint8, 200)],
)  # fmt: skip
def test_any_picture_will_do(tmp_path, name, kind, white):
    cv2.imwrite(str(tmp_path / name), DRAWN["wall"].astype(kind) * white)
    (part,) = left_out(tmp_path / name, (W, H))
    np.testing.assert_array_equal(pixels_in(part, (H, W)), DRAWN["wall"])


def refused(folder):
    white = 255 * DRAWN["disc"].astype(np.uint8)
    cv2.imwrite(str(folder / "small.png"), white[:90, :100])
    cv2.imwrite(str(folder / "black.png"), 0 * white)
    cv2.imwrite(str(folder / "white.png"), 0 * white + 255)
    specks = np.zeros((H, W), np.uint8)
    specks[::2, ::2] = 255
    cv2.imwrite(str(folder / "specks.png"), specks)
    (folder / "noise.png").write_bytes(b"\x89PNG nothing")
    (folder / "empty.png").write_bytes(b"")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("small.png", "is 100 x 90 px, and the camera 160 x 120; draw it on one of its frames"),
        ("black.png", "leaves out nothing; white is"),
        ("white.png", "leaves out all"),
        ("specks.png", "white areas are 4800"),
        ("noise.png", "damaged, or no picture"),
        ("empty.png", "damaged, or no picture"),
        ("missing.png", "cannot be read: No such file"),
    ],
)
def test_what_is_no_mask_of_this_camera_is_one_sentence(tmp_path, name, words):
    refused(tmp_path)
    with pytest.raises(SceneError, match=words) as caught:
        left_out(tmp_path / name, (W, H))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_scene_file_names_a_picture_that_stands_beside_it(tmp_path):
    scene = at_size(demo_scene("two_spheres_500"), 252)
    picture = np.zeros((252, 252), np.uint8)
    picture[200:, 30:90] = 255
    tifffile.imwrite(tmp_path / "mask.tif", picture)
    read = _loaded(tmp_path, dump_scene(scene) + "masked:\n- {why: left out, picture: mask.tif}\n")
    np.testing.assert_array_equal(mask_pixels(read) == NodeStatus.LEFT_OUT, picture > 0)
    assert _loaded(tmp_path, dump_scene(read)).masked == read.masked
    for entry, words in (
        ("{why: unconfirmed, picture: mask.tif}", "'left out'"),
        ("{why: left out, picture: mask.tif, through: [sphere1]}", "one of them"),
        ("{why: left out, picture: other.tif}", "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=words):
            _loaded(tmp_path, dump_scene(scene) + f"masked:\n- {entry}\n")


def _loaded(folder, text):
    (folder / "scene.yaml").write_text(text)
    return load_scene(folder / "scene.yaml")


@loop_over("name", ["disc", "outside", "specks"])
@loop_over(
    "kind, options",
    [
        (bool, {}),  # tifffile writes it with MinIsWhite
        (bool, {"byteorder": ">"}),
        (bool, {"bigtiff": True}),
        (np.uint8, {"photometric": "miniswhite"}),  # ImageJ's inverted table
        (np.uint8, {"photometric": "minisblack"}),
        (np.uint16, {"photometric": "miniswhite", "bigtiff": True, "byteorder": ">"}),
        (np.float32, {"photometric": "minisblack"}),
    ],
)
def test_numbers_of_a_mask_are_labels_however_they_are_shown(tmp_path, name, kind, options):
    largest = 1 if kind in (bool, np.float32) else np.iinfo(kind).max
    tifffile.imwrite(tmp_path / "mask.tif", (DRAWN[name] * largest).astype(kind), **options)
    found = np.zeros((H, W), bool)
    for part in left_out(tmp_path / "mask.tif", (W, H)):
        found |= pixels_in(part, (H, W))
    np.testing.assert_array_equal(found, DRAWN[name])
