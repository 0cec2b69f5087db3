"""Pictures of any camera: colours as grey and said once, JPEG, PGM; cut short or lying, refused in a sentence."""

import io
import re
import struct

import cv2
import numpy as np
import PIL.Image
import pytest
import tifffile

from ground import terminal
from piv.errors import FrameError
from piv.files.frame_file import read_frame
from tests.loops import loop_over

RNG = np.random.default_rng(0)
RGB8 = RNG.integers(0, 256, (40, 50, 3)).astype(np.uint8)
RGB16 = RNG.integers(0, 65536, (40, 50, 3)).astype(np.uint16)
SMOOTH = cv2.GaussianBlur(RNG.integers(0, 256, (40, 56)).astype(np.uint8), (0, 0), 3.0)


@pytest.fixture
def said(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "_said", set())
    return lambda: " ".join(capsys.readouterr().err.split())


def luma(rgb):
    return rgb @ [0.299, 0.587, 0.114]


def palette_of(colours, path):
    """Numbers of 16 colours, and what each of them is."""
    numbers = RNG.integers(0, 16, (40, 50)).astype(np.uint8)
    table = np.zeros((3, 256), np.uint16)
    table[:, :16] = 257 * colours[:16].T.astype(np.uint16)
    tifffile.imwrite(path, numbers, photometric="palette", colormap=table)
    return colours[numbers]


def test_colours_are_taken_as_grey_and_it_is_said_once(tmp_path, said):
    shown = {}
    for name, rgb in (("8", RGB8), ("16", RGB16)):
        tifffile.imwrite(tmp_path / f"{name}.tif", rgb, photometric="rgb")
        tifffile.imwrite(tmp_path / f"apart{name}.tif", np.moveaxis(rgb, 2, 0), photometric="rgb", planarconfig=2)
        cv2.imwrite(str(tmp_path / f"lzw{name}.tif"), rgb[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
        cv2.imwrite(str(tmp_path / f"{name}.png"), rgb[..., ::-1])
        shown |= {f"{kind}{name}.tif": rgb for kind in ("", "apart", "lzw")} | {f"{name}.png": rgb}
    PIL.Image.fromarray(RGB8).save(tmp_path / "a.bmp")
    shown["a.bmp"] = RGB8
    shown["palette.tif"] = palette_of(RGB8[0], tmp_path / "palette.tif")
    for name, rgb in shown.items():
        found = read_frame(tmp_path / name)
        assert (found.dtype, found.shape) == (rgb.dtype, (40, 50)), name
        most = 1.0 if rgb.dtype == np.uint8 else 2.0  # OpenCV counts in whole numbers
        assert np.abs(found - luma(rgb.astype(float))).max() <= most, name
    assert said().count("colours are taken as grey: 0.299 red + 0.587 green + 0.114 blue") == 1


def test_a_worker_says_nothing(monkeypatch, said):
    """Whoever started it reads the same frames."""
    monkeypatch.setattr("multiprocessing.parent_process", lambda: object())
    terminal.say_once("colours")
    assert not said()


def jpeg(image, **options):
    out = io.BytesIO()
    PIL.Image.fromarray(image).save(out, "JPEG", quality=95, **options)
    return out.getvalue()


@pytest.mark.parametrize(
    "options", [{}, {"progressive": True}, {"restart_marker_rows": 1}, {"comment": b"\xff\xd9"}]
)
@pytest.mark.parametrize("ending", ["jpg", "JPEG"])
def test_a_jpeg_is_read_and_refused_where_its_end_is_missing(tmp_path, said, options, ending):
    path, content = tmp_path / f"a.{ending}", jpeg(SMOOTH, **options)
    for behind in (b"", b"what a phone puts behind it"):
        path.write_bytes(content + behind)
        found = read_frame(path, SMOOTH.shape)
        assert found.dtype == np.uint8
        assert np.abs(found.astype(int) - SMOOTH).max() < 6
    for kept in (len(content) - 2, len(content) // 2, 30, 4):
        path.write_bytes(content[:kept])
        with pytest.raises(FrameError, match="is damaged") as caught:
            read_frame(path)
        assert "\n" not in str(caught.value)
    assert not said()


def test_a_jpeg_in_colours_is_grey_and_its_exif_turns_nothing(tmp_path, said):
    image = PIL.Image.fromarray(np.dstack([SMOOTH, SMOOTH // 2, SMOOTH // 3]))
    exif = image.getexif()
    exif[274] = 6  # held upright
    image.save(tmp_path / "a.jpg", quality=95, exif=exif, subsampling=0)
    found = read_frame(tmp_path / "a.jpg", SMOOTH.shape)
    assert np.abs(found - luma(np.asarray(image).astype(float))).max() < 8
    assert "colours are taken as grey" in said()


def test_what_a_jpeg_says_of_itself_is_not_believed(tmp_path):
    content = bytearray(jpeg(SMOOTH))
    place = content.index(b"\xff\xc0") + 5
    for width, height, words in (
        (60000, 60000, "million pixels"),
        (12000, 12000, "more than it can hold"),
        (0, 9, "0 x 9"),
    ):
        content[place : place + 4] = struct.pack(">HH", height, width)
        (tmp_path / "a.jpg").write_bytes(content)
        with pytest.raises(FrameError, match=words):
            read_frame(tmp_path / "a.jpg")
    PIL.Image.fromarray(np.zeros((8, 8, 4), np.uint8), "CMYK").save(tmp_path / "a.jpg")
    with pytest.raises(FrameError, match="4 channels"):
        read_frame(tmp_path / "a.jpg")


@loop_over("comment", [b" ", b"\n# by a camera\n", b"\n# a\n# b 1 2\n"])
@loop_over("most, kind", [(255, np.uint8), (100, np.uint8), (4095, np.uint16), (65535, np.uint16)])
def test_a_pgm_is_read_number_by_number(tmp_path, most, kind, comment):
    shown = RNG.integers(0, most + 1, (40, 50)).astype(kind)
    head = b"P5" + comment + b"50" + comment + b"40\n" + str(most).encode() + b"\n"
    (tmp_path / "a.pgm").write_bytes(head + shown.astype(shown.dtype.newbyteorder(">")).tobytes())
    found = read_frame(tmp_path / "a.pgm", (40, 50))
    assert found.dtype == kind
    assert np.array_equal(found, shown)


def test_pgms_that_cannot_be_read_are_one_sentence(tmp_path):
    pixels = bytes(range(250)) * 8
    for content, words in (
        (b"P5 50 40 255\n" + pixels[:-1], "more than it can hold|end is missing"),
        (b"P5 90000 90000 255\n" + pixels, "million pixels"),
        (b"P5 50 40 100\n" + pixels, "it holds 249, and its largest grey is 100"),
        (b"P5 50 40 70000\n" + pixels, "its largest grey is 70000"),
        (b"P2 2 1 255\n3 4\n", "no binary PGM"),
        (b"P6 50 40 255\n" + 3 * pixels, "no binary PGM"),
        (b"P5 50", "no binary PGM"),
    ):
        (tmp_path / "a.pgm").write_bytes(content)
        with pytest.raises(FrameError, match=words) as caught:
            read_frame(tmp_path / "a.pgm")
        assert "\n" not in str(caught.value)
    (tmp_path / "a.pgm").write_bytes(b"P5 50 40 255\n" + pixels)
    with pytest.raises(FrameError, match="is 50 x 40 px, and 10 x 20 px are expected"):
        read_frame(tmp_path / "a.pgm", (20, 10))


@pytest.mark.parametrize(
    ("name", "start", "said"),
    [
        ("a.tif", b"\x89PNG\r\n\x1a\n", "is a PNG by its content; rename it to a.png"),
        ("a.tiff", b"\xff\xd8\xff\xe0", "is a JPEG by its content; rename it to a.jpg"),
        ("a.png", b"II*\0", "is a TIFF by its content; rename it to a.tif"),
        ("a.jpg", b"MM\0+", "is a TIFF by its content; rename it to a.tif"),
        ("a.tif", b"version https://git-lfs.github.com/spec/v1\noid sha256:1", "get the frame by: git lfs pull"),
        ("a.bmp", b"\n<!DOCTYPE html><html>", "is a web page or XML and no frame; download the frame again"),
        ("a.tif", b"\x1f\x8b\x08", "is compressed by gzip"),
        ("a.png", b"", "is empty; copy it from the camera again"),
        ("a.tif", b"II*\0", "is damaged or no TIFF"),
        ("a.jpeg", b"\xff\xd8\xff\xe0", "is damaged"),
    ],
)
def test_a_file_of_another_kind_than_its_name_says_is_named(name, start, said, tmp_path):
    (tmp_path / name).write_bytes(start + (b"\0" * 64 if start else b""))
    with pytest.raises(FrameError, match=re.escape(said)):
        read_frame(tmp_path / name)
