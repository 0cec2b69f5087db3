"""Frames on disk: what is refused, what is written, and that nothing is half-written."""

import json

import cv2
import numpy as np
import pytest
import tifffile

from piv.errors import FrameError
from piv.files.frame_file import read_frame, write_frame


@pytest.fixture
def frame():
    return np.random.default_rng(0).integers(0, 4096, (40, 50)).astype(np.uint16)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_tiff_round_trip_with_scale(tmp_path, frame, dtype):
    path = tmp_path / "a.tif"
    write_frame(path, frame.astype(dtype), 12.4, {"origin_mm": [-1.0, 2.0]})
    assert np.array_equal(read_frame(path, (40, 50)), frame.astype(dtype))
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        about = json.loads(page.description)
        x, y = page.tags["XResolution"].value, page.tags["YResolution"].value
        assert page.tags["ResolutionUnit"].value == 3
    assert about == {"px_per_mm": 12.4, "origin_mm": [-1.0, 2.0]}
    assert x[0] / x[1] == pytest.approx(124.0)
    assert y == x
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


@pytest.mark.parametrize("ending", [".png", ".bmp"])
def test_other_formats_are_read(tmp_path, frame, ending):
    path = tmp_path / f"a{ending}"
    grey = (frame >> 4).astype(np.uint8)
    cv2.imwrite(str(path), grey)
    assert np.array_equal(read_frame(path), grey)


def bad_files(folder, frame):
    good = folder / "good.tif"
    tifffile.imwrite(good, frame, compression="zlib")
    content = good.read_bytes()
    files = {"truncated": content[: len(content) // 2], "empty": b"", "noise": bytes(range(256)) * 8}
    for name, data in files.items():
        (folder / f"{name}.tif").write_bytes(data)
    tifffile.imwrite(folder / "stack.tif", np.zeros((3, 40, 50), np.uint16), photometric="minisblack")
    tifffile.imwrite(folder / "half.tif", np.zeros((40, 50), np.float16))
    (folder / "noise.png").write_bytes(b"\x89PNG nothing")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("truncated.tif", "damaged"),
        ("empty.tif", "is empty; copy it"),
        ("noise.tif", "damaged"),
        ("stack.tif", "pages"),
        ("half.tif", "float16"),
        ("noise.png", "damaged"),
        ("missing.tif", "cannot be read"),
        ("missing.png", "cannot be read"),
        ("notes.txt", "no frame"),
    ],
)
def test_bad_files_are_named_in_one_sentence(tmp_path, frame, name, words):
    bad_files(tmp_path, frame)
    with pytest.raises(FrameError, match=words) as caught:
        read_frame(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_frame_of_the_wrong_size_is_named(tmp_path, frame):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, frame)
    with pytest.raises(FrameError, match="50 x 40 px, and 60 x 40 px are expected"):
        read_frame(path, (40, 60))


def test_a_failed_write_leaves_nothing(tmp_path, frame, mocker):
    mocker.patch("os.fsync", side_effect=OSError(28, "No space left on device"))
    with pytest.raises(OSError, match="No space"):
        write_frame(tmp_path / "a.tif", frame, 1.0, {})
    assert not list(tmp_path.iterdir())
