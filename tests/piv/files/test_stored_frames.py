"""Frames as people have them: packed, inverted, turned, as colours or pages; read right, or refused by name."""

import io
import json
import os
import struct
import time
import tracemalloc
import zlib

import cv2
import numpy as np
import PIL.Image
import pytest
import tifffile

from ground import memory
from ground.errors import MemoryShort
from piv.errors import FrameError
from piv.files import tiff_page
from piv.files.frame_file import read_frame, stem_of

GREY16 = np.random.default_rng(0).integers(0, 4096, (40, 50)).astype(np.uint16)
GREY8 = (GREY16 >> 4).astype(np.uint8)


def colours(grey):
    return np.repeat(grey[..., None], 3, axis=2)


def with_alpha(grey, alpha):
    return np.dstack([colours(grey), np.full(grey.shape, alpha, grey.dtype)])


def greys(grey):
    """A palette that shows number n as grey 255 - n."""
    return np.repeat(257 * (255 - np.arange(256, dtype=np.uint16))[None], 3, axis=0)


@pytest.mark.parametrize("kind", [1, 5, 8, 32773, 32946])
@pytest.mark.parametrize("frame", [GREY8, GREY16, (GREY16 / 7).astype(np.float32)])
def test_packed_tiffs_are_read(tmp_path, kind, frame):
    """None, LZW, both deflates and PackBits, by the library that most programs write them with."""
    if frame.dtype == np.float32 and kind == 32773:
        pytest.skip("libtiff has no predictor for it")
    cv2.imwrite(str(tmp_path / "a.tif"), frame, [cv2.IMWRITE_TIFF_COMPRESSION, kind])
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        assert file.pages[0].compression == kind
    found = read_frame(tmp_path / "a.tif", frame.shape)
    assert found.dtype == frame.dtype
    assert np.array_equal(found, frame)


@pytest.mark.parametrize("packing", [None, "tiff_lzw", "tiff_adobe_deflate"])
@pytest.mark.parametrize("frame", [GREY8, GREY16])
def test_tiffs_of_another_writer_are_read(tmp_path, packing, frame):
    PIL.Image.fromarray(frame).save(tmp_path / "a.tif", compression=packing)
    assert np.array_equal(read_frame(tmp_path / "a.tif"), frame)


@pytest.mark.parametrize("packing", ["zlib", "lzw"])
@pytest.mark.parametrize("frame", [GREY8, GREY16])
def test_an_inverted_tiff_is_turned_round(tmp_path, packing, frame):
    path = tmp_path / "a.tif"
    if packing == "zlib":
        tifffile.imwrite(path, frame, photometric="miniswhite", compression="zlib")
    else:
        cv2.imwrite(str(path), frame, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
        with tifffile.TiffFile(path, mode="r+") as file:
            file.pages[0].tags["PhotometricInterpretation"].overwrite(0)
    assert np.array_equal(read_frame(path), np.iinfo(frame.dtype).max - frame)


def seen(frame, orientation):
    """As TIFF 6.0 says where the first row and the first column are seen."""
    return {
        1: frame, 2: np.fliplr(frame), 3: np.rot90(frame, 2), 4: np.flipud(frame),
        5: frame.T, 6: np.rot90(frame, -1), 7: np.rot90(frame, 2).T, 8: np.rot90(frame),
    }[orientation]  # fmt: skip


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_turned_tiff_is_turned_back(tmp_path, orientation):
    tag = [(274, "H", 1, orientation, True)]
    tifffile.imwrite(tmp_path / "a.tif", GREY16, photometric="minisblack", extratags=tag)
    right = seen(GREY16, orientation)
    assert np.array_equal(read_frame(tmp_path / "a.tif", right.shape), right)


def test_an_orientation_that_does_not_exist_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY16, photometric="minisblack", extratags=[(274, "H", 1, 9, True)])
    with pytest.raises(FrameError, match="orientation 9"):
        read_frame(tmp_path / "a.tif")


@pytest.mark.parametrize("frame", [GREY8, GREY16])
@pytest.mark.parametrize("way", ["contig", "separate", "png", "alpha.png", "lzw", "bmp"])
def test_grey_stored_as_colours_is_grey(tmp_path, frame, way):
    path = tmp_path / f"a.{way}" if way.endswith(("png", "bmp")) else tmp_path / "a.tif"
    if way in ("contig", "separate"):
        planes = colours(frame) if way == "contig" else np.moveaxis(colours(frame), 2, 0).copy()
        tifffile.imwrite(path, planes, photometric="rgb", planarconfig=way)
    elif way == "bmp" and frame.dtype == np.uint16:
        pytest.skip("a BMP has 8 bits")
    else:
        image = with_alpha(frame, np.iinfo(frame.dtype).max) if way.startswith("alpha") else colours(frame)
        cv2.imwrite(str(path), image, [cv2.IMWRITE_TIFF_COMPRESSION, 5] if way == "lzw" else [])
    found = read_frame(path, frame.shape)
    assert found.dtype == frame.dtype
    assert np.array_equal(found, frame)


def write_png(path, image, mode=None):
    made = PIL.Image.fromarray(image)
    (made if mode is None else made.convert(mode)).save(path)


@pytest.mark.parametrize("frame", [GREY8, GREY16])
def test_pngs_are_read_as_they_are(tmp_path, frame):
    write_png(tmp_path / "a.png", frame)
    found = read_frame(tmp_path / "a.png", frame.shape)
    assert found.dtype == frame.dtype
    assert np.array_equal(found, frame)


def test_a_palette_of_greys_is_looked_up(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY8, photometric="palette", colormap=greys(GREY8))
    assert np.array_equal(read_frame(tmp_path / "a.tif"), 255 - GREY8)
    image = PIL.Image.fromarray(GREY8, "L").convert("P")
    image.save(tmp_path / "a.png")
    assert np.array_equal(read_frame(tmp_path / "a.png"), GREY8)


def test_a_page_is_read_by_choice(tmp_path):
    for name, options in (("plain", {}), ("packed", {"compression": "zlib"})):
        tifffile.imwrite(
            tmp_path / f"{name}.tif", np.stack([GREY16, GREY16 + 1]), photometric="minisblack", **options
        )
    cv2.imwritemulti(str(tmp_path / "lzw.tif"), [GREY16, GREY16 + 1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    for name in ("plain", "packed", "lzw"):
        for page in (1, 2):
            path = tmp_path / f"{name}.tif@{page}"
            assert np.array_equal(read_frame(path), GREY16 + (page - 1))
            assert stem_of(path) == f"{name}_{page}"
        with pytest.raises(FrameError, match=f"holds 2 pages; say which, as in {name}.tif@1"):
            read_frame(tmp_path / f"{name}.tif")
        with pytest.raises(FrameError, match="holds 2 pages, and no page 3"):
            read_frame(tmp_path / f"{name}.tif@3")


def test_a_file_that_is_called_like_a_page_is_a_file(tmp_path):
    tifffile.imwrite(tmp_path / "x.tif", GREY16)
    (tmp_path / "x.tif").rename(tmp_path / "a.tif@2")
    with pytest.raises(FrameError, match="frames end in"):
        read_frame(tmp_path / "a.tif@2")


def test_a_preview_is_no_page(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(GREY16, photometric="minisblack")
        file.write(GREY16[::4, ::4].copy(), photometric="minisblack", subfiletype=1)
    assert np.array_equal(read_frame(tmp_path / "a.tif"), GREY16)


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int32, np.uint32, np.float32, np.float64])
def test_packed_numbers_of_any_kind(tmp_path, kind):
    """OpenCV packs what has the same bits; the tag then says what they are."""
    frame = (GREY16.astype(np.int64) // 40 - (40 if kind is not np.uint32 else 0)).astype(kind)
    packed_as = {1: np.uint8, 2: np.uint16, 4: np.float32, 8: np.float64}[frame.itemsize]
    form = {"u": 1, "i": 2, "f": 3}[frame.dtype.kind]
    for codec in (5, 8):
        for predictor in (1, 2, 3) if packed_as in (np.float32, np.float64) else (1, 2):
            how = [cv2.IMWRITE_TIFF_COMPRESSION, codec, cv2.IMWRITE_TIFF_PREDICTOR, predictor]
            cv2.imwrite(str(tmp_path / "a.tif"), frame.view(packed_as), how)
            with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
                file.pages[0].tags["SampleFormat"].overwrite(form)
            np.testing.assert_array_equal(read_frame(tmp_path / "a.tif"), frame.astype(np.float32), f"{how}")


def refused(folder):
    cv2.imwrite(str(folder / "clear.png"), with_alpha(GREY8, 100))
    write_png(folder / "bilevel.png", GREY8, "1")
    tifffile.imwrite(folder / "float.tif", GREY16.astype(np.float32), photometric="miniswhite")
    tifffile.imwrite(folder / "cmyk.tif", np.zeros((40, 50, 4), np.uint8), photometric="separated")
    tifffile.imwrite(folder / "bayer.tif", GREY16, photometric="cfa")
    tifffile.imwrite(
        folder / "two.tif", np.zeros((40, 50, 2), np.uint16), photometric="minisblack", planarconfig=1
    )
    tifffile.imwrite(folder / "codec.tif", GREY8, photometric="minisblack")
    with tifffile.TiffFile(folder / "codec.tif", mode="r+") as file:
        file.pages[0].tags["Compression"].overwrite(34712)
    description = "ImageJ=1.53t\nimages=5\nslices=5\n"
    tifffile.imwrite(folder / "imagej.tif", GREY16, description=description, metadata=None)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("clear.png", "transparent"), ("bilevel.png", "uint1"), ("float.tif", "MinIsWhite"),
        ("cmyk.tif", "SEPARATED"), ("bayer.tif", "CFA"), ("two.tif", "2 channels"), ("codec.tif", "JPEG2000"),
        ("imagej.tif", "5 images as ImageJ packs them"),
    ],
)  # fmt: skip
def test_what_is_no_grey_image_is_refused_by_name(tmp_path, name, words):
    refused(tmp_path)
    with pytest.raises(FrameError, match=words) as caught:
        read_frame(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "camera again" not in str(caught.value)


def png_of(width, height, content):
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)), (b"IDAT", content), (b"IEND", b"")]
    out = io.BytesIO(b"\x89PNG\r\n\x1a\n")
    out.seek(0, 2)
    for kind, data in parts:
        out.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))
    return out.getvalue()


def huge(folder):
    """40 000 x 40 000 px of 16 bits in 3 MB: honest, packed, and two that are a lie."""
    rows = [bytes(2 * 40_000)] * 40_000
    strips = [zlib.compress(b"".join(rows[:1000]), 1)] * 40
    (folder / "lie.png").write_bytes(png_of(40_000, 40_000, zlib.compress(bytes(1000))))
    tags = {"photometric": "minisblack", "compression": "zlib", "rowsperstrip": 1000}
    tifffile.imwrite(folder / "packed.tif", iter(strips), shape=(40_000, 40_000), dtype="u2", **tags)
    tifffile.imwrite(folder / "lie.tif", GREY16, photometric="minisblack")
    with tifffile.TiffFile(folder / "lie.tif", mode="r+") as file:
        for name in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[name].overwrite(15_000)


@pytest.mark.parametrize("shape", [None, (40, 50)])
@pytest.mark.parametrize("name", ["packed.tif", "lie.tif", "lie.png"])
def test_a_size_is_refused_before_pixels_are_decoded(tmp_path, name, shape):
    huge(tmp_path)
    tracemalloc.start()
    begun_s = time.perf_counter()
    with pytest.raises(FrameError, match=r"000 px|000 x"):
        read_frame(tmp_path / name, shape)
    assert time.perf_counter() - begun_s < 1.0
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()


def test_a_frame_that_does_not_fit_into_memory_is_refused(tmp_path, monkeypatch):
    tifffile.imwrite(tmp_path / "a.tif", GREY16)
    monkeypatch.setattr(memory, "free_bytes", lambda: 10_000)
    monkeypatch.setattr(memory, "ASKED_FROM_BYTES", 1000)
    with pytest.raises(MemoryShort, match=r"a frame of 50 x 40 px needs about 0\.0 GB"):
        read_frame(tmp_path / "a.tif")
    assert tiff_page.MOST_PX > 150e6  # the largest sensors that labs have


@pytest.mark.parametrize("ending", [".tif", ".png", ".bmp"])
def test_pipes_devices_and_folders_are_refused_at_once(tmp_path, ending):
    os.mkfifo(tmp_path / f"pipe{ending}")
    (tmp_path / f"zero{ending}").symlink_to("/dev/zero")
    (tmp_path / f"folder{ending}").mkdir()
    for name, words in (("pipe", "pipe"), ("zero", "device"), ("folder", "folder")):
        with pytest.raises(FrameError, match=words):
            read_frame(tmp_path / f"{name}{ending}")


@pytest.mark.parametrize("place", [20, 70, 200, -20])
def test_a_damaged_png_is_found_by_its_own_checksums(tmp_path, place, capfd):
    write_png(tmp_path / "a.png", GREY16)
    data = bytearray((tmp_path / "a.png").read_bytes())
    data[place] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(FrameError, match="damaged"):
        read_frame(tmp_path / "a.png")
    assert capfd.readouterr().err == ""


def test_descriptions_survive(tmp_path):
    """Of any packing: what a frame says about itself is read beside its pixels."""
    about = json.dumps({"crc32": "00000000"})
    tifffile.imwrite(tmp_path / "a.tif", GREY16, compression="zlib", description=about, metadata=None)
    with pytest.raises(FrameError, match="checksum 00000000"):
        read_frame(tmp_path / "a.tif")
