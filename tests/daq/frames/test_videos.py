"""Frames of videos: by number in any order, what is damaged refused by name, and nothing else lost with it."""

import shutil
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from daq.errors import RunUsageError
from daq.frames.named_frame import read_named
from daq.frames.source import is_source, source_of
from ground import terminal
from piv.errors import FrameError, PairError
from piv.files.frame_file import checksum, stem_of
from tests.daq.frames.videos import H, W, damaged, moving, write_cine, write_video

av = pytest.importorskip("av")
LOSSLESS = [("a.avi", "rawvideo", "gray"), ("b.avi", "ffv1", "gray"), ("c.mkv", "ffv1", "gray16le"),
            ("d.avi", "rawvideo", "bgr24"), ("e.mkv", "ffv1", "bgr0")]  # fmt: skip
LOSSY = [("f.mp4", "mpeg4", "yuv420p"), ("g.avi", "mjpeg", "yuvj420p"), ("h.mov", "libx264", "yuv420p"),
         ("i.mp4", "libx264", "gray"), ("j.avi", "rawvideo", "yuyv422")]  # fmt: skip
IN_ANY_ORDER = (1, 2, 3, 9, 4, 12, 5)


def frame(path, number):
    return path.with_name(f"{path.name}@{number}")


@pytest.mark.parametrize(("name", "codec", "pixels"), LOSSLESS)
def test_every_frame_is_found_by_its_number_to_the_bit(tmp_path, name, codec, pixels):
    shown = moving(kind=np.uint16 if "16" in pixels else np.uint8)
    path = write_video(tmp_path / name, shown, codec, pixels)
    assert is_source(path)
    assert not is_source(frame(path, 3))
    source = source_of(path)
    assert [tuple(place.name for place in places) for _, *places in source.pairs()] == [
        (f"{name}@{n}", f"{name}@{n + 1}") for n in range(1, 13, 2)
    ]
    assert source.count_unpaired() == 0
    for number in IN_ANY_ORDER:
        found = read_named(frame(path, number), (H, W), checksum(shown[number - 1]))
        assert found.dtype == shown.dtype
        assert np.array_equal(found, shown[number - 1])


@pytest.mark.parametrize(("name", "codec", "pixels"), LOSSY)
def test_frames_that_are_made_from_others_are_the_same_whoever_asks_first(tmp_path, name, codec, pixels):
    """A decoder is kept between two calls; each frame must be what it is to somebody who begins with it."""
    shown, path = moving(), write_video(tmp_path / name, moving(), codec, pixels)
    for number in IN_ANY_ORDER:
        found = read_named(frame(path, number)).astype(float)
        assert int(np.argmin([abs(found - each).mean() for each in shown])) == number - 1
        alone = shutil.copy(path, tmp_path / f"{number}{name}")  # x264 does not always write the same
        assert np.array_equal(found, read_named(frame(alone, number)))


@pytest.mark.parametrize(("kind", "bits"), [(np.uint8, 8), (np.uint16, 16), (np.uint16, 12)])
@pytest.mark.parametrize("flipped", [False, True])
def test_a_cine_of_a_phantom_camera_is_read(tmp_path, kind, bits, flipped):
    """Of 12 bits as of 16: brighter by 16, and the lowest bits repeat the highest."""
    shown = moving(6, kind) >> (8 * np.dtype(kind).itemsize - bits)
    path = write_cine(tmp_path / "a.cine", shown, bits, flipped)
    assert [number for number, *_ in source_of(path).pairs()] == [0, 1, 2]
    for number in (1, 6, 3):
        wanted = shown[number - 1][::-1] if flipped else shown[number - 1]
        wanted = (wanted << 4) | (wanted >> 8) if bits == 12 else wanted
        assert np.array_equal(read_named(frame(path, number)), wanted)


@pytest.mark.parametrize(
    ("name", "codec", "options"), [("a.avi", "png", {}), ("a.mkv", "ffv1", {"level": 3, "slicecrc": 1, "g": 1})]
)
def test_a_damaged_frame_is_refused_and_its_neighbours_are_not(tmp_path, name, codec, options):
    whole = write_video(tmp_path / name, moving(), codec, "gray", **options)
    broken = damaged(whole, 5)
    assert [number for number, *_ in source_of(broken).pairs()] == list(range(6))
    for number in (*IN_ANY_ORDER, 5, 6):
        if number == 5:
            with pytest.raises(FrameError, match=r"broken\....@5: is damaged, or made from a frame"):
                read_named(frame(broken, number))
        else:
            assert np.array_equal(read_named(frame(broken, number)), read_named(frame(whole, number)))


def test_what_is_made_from_a_damaged_frame_is_refused_with_it(tmp_path):
    """MPEG-4, one frame in six stands alone: 9 is damaged, 10 to 12 are made from it, 13 is whole again."""
    whole = write_video(tmp_path / "a.mp4", moving(18), "mpeg4", "yuv420p", g=6)
    broken = damaged(whole, 9)
    for number in (13, 8, 9, 10, 12, 14, 7, 11, 18, 1):
        if 9 <= number <= 12:
            with pytest.raises(FrameError, match="is damaged, or made from a frame that is"):
                read_named(frame(broken, number))
        else:
            assert np.array_equal(read_named(frame(broken, number)), read_named(frame(whole, number)))


@pytest.fixture
def said(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "_said", set())
    return lambda: " ".join(capsys.readouterr().err.split())


def test_a_video_that_is_cut_short_keeps_what_it_has(tmp_path, said):
    path = write_video(tmp_path / "a.avi", moving(), "rawvideo", "gray")
    content = path.read_bytes()
    path.write_bytes(content[: int(0.6 * len(content))])
    source = source_of(path)
    assert "of its 12 frames; the file is cut short" in said()
    assert len(source.pairs()) == 3
    assert np.array_equal(read_named(frame(path, 6)), moving()[5])
    cut = write_video(tmp_path / "b.mp4", moving(), "mpeg4", "yuv420p")
    cut.write_bytes(cut.read_bytes()[:-100])  # where it says what lies where
    with pytest.raises(FrameError, match=r"b\.mp4: (is not readable as a video|holds no frame that can be read)"):
        source_of(cut)


def test_a_frame_that_the_camera_lost_costs_its_own_pairs(tmp_path):
    """Times 0 1 2 4 5 6: the fourth is missing, and 5 and 6 are a pair all the same."""
    path = write_video(tmp_path / "a.mkv", moving(6), times=[0, 1, 2, 4, 5, 6])
    source = source_of(path)
    assert [first.name[-1] + second.name[-1] for _, first, second in source.pairs()] == ["12", "56"]
    assert source.count_unpaired() == 2
    assert np.array_equal(read_named(frame(path, 5)), moving(6)[3])
    every = source_of(Path(f"{path}@1-2,2-3"))
    assert [number for number, *_ in every.pairs()] == [0, 1, 4, 5]
    with pytest.raises(FrameError, match=r"frames 1 to 7, and no 4"):
        read_named(frame(path, 4))


def test_frames_at_odd_times_are_refused(tmp_path):
    path = write_video(tmp_path / "a.mkv", moving(6), times=[0, 10, 20, 34, 44, 54])
    with pytest.raises(FrameError, match="not at equal distances in time"):
        source_of(path)


def test_colours_are_grey_and_said_once(tmp_path, said):
    grey = moving(4)
    red = np.zeros((*grey.shape, 3), np.uint8)
    red[..., 0] = grey
    for name, codec, pixels in (("a.avi", "rawvideo", "bgr24"), ("b.avi", "mjpeg", "yuvj444p")):
        path = write_video(tmp_path / name, red, codec, pixels)
        for number in (1, 2):
            found = read_named(frame(path, number))
            assert np.abs(found - 0.299 * grey[number - 1]).mean() < 3.0
    assert said().count("colours are taken as grey") == 1
    read_named(frame(write_video(tmp_path / "c.avi", grey, "mjpeg", "yuvj420p"), 1))
    assert not said()


@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.mov", "a.mkv", "a.cine"])
def test_what_is_no_video_is_refused_in_one_sentence(tmp_path, name):
    other = write_video(tmp_path / "other.avi", moving(2), "mjpeg", "yuvj420p")
    for content in (
        b"",
        b"#EXTM3U\n" + str(other).encode(),
        b"ffconcat version 1.0\nfile other.avi\n",
        bytes(4000),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FrameError, match=r"is not readable as a video|holds no frame") as caught:
            source_of(tmp_path / name)
        assert "\n" not in str(caught.value)
    (tmp_path / name).unlink()
    with pytest.raises(FrameError, match="cannot be read: No such file"):
        source_of(tmp_path / name)
    (tmp_path / name).mkdir()
    with pytest.raises(FrameError, match="is a folder"):
        source_of(tmp_path / name)


def test_without_its_library_it_is_said_what_to_install(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.avi", moving(2), "mjpeg", "yuvj420p")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(RunUsageError, match=r"install rtpiv\[video\]"):
        read_named(frame(path, 1))


def test_a_frame_has_a_size_a_number_and_a_name(tmp_path):
    path = write_video(tmp_path / "a.avi", moving(3), "mjpeg", "yuvj420p")
    with pytest.raises(FrameError, match=r"a\.avi@1: is 64 x 48 px, and should be 10 x 20 px"):
        read_named(frame(path, 1), (20, 10))
    for number in (0, 4):
        with pytest.raises(FrameError, match=f"frames 1 to 3, and no {number}"):
            read_named(frame(path, number))
    with pytest.raises(PairError, match="holds no pair"):
        source_of(Path(f"{path}@5-6,7-8"))
    assert [stem_of(frame(path, n)) for n in (1, 2)] == ["a_1", "a_2"]


def test_every_frame_is_decoded_once_where_all_are_asked_for_in_order(tmp_path, monkeypatch):
    """Pairs 1-2, 2-3 of a video with one frame in twelve that stands alone: not each from there again."""
    from daq.frames import video

    path = write_video(tmp_path / "a.mp4", moving(24), "mpeg4", "yuv420p", g=12)
    decoded, grey = [], video._grey
    monkeypatch.setattr(video, "_grey", lambda frame: decoded.append(frame.pts) or grey(frame))
    for pair in pairwise(range(1, 25)):
        for number in pair:
            read_named(frame(path, number))
    assert len(decoded) == 24


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [("a.mp4", "mpeg4", "yuv420p"), ("b.mov", "libx264", "yuv420p"), ("c.mkv", "ffv1", "gray"),
     ("d.avi", "mjpeg", "yuvj420p"), ("e.cine", "", "")],
)  # fmt: skip
def test_whatever_is_damaged_ends_in_frames_or_in_sentences(tmp_path, name, codec, pixels):
    """Names in another alphabet, packings that do not exist, sizes, times and counts that lie."""
    whole = tmp_path / name
    whole = write_video(whole, moving(6), codec, pixels) if codec else write_cine(whole, moving(6), 8)
    content, rng, ended = whole.read_bytes(), np.random.default_rng(len(name) + ord(name[0])), set()
    for number in range(30):
        altered = bytearray(content)
        for place in rng.integers(0, len(altered), rng.integers(1, 4)):
            altered[place] = rng.integers(256)
        path = tmp_path / f"{number}{name}"
        path.write_bytes(altered if number % 3 else altered[: rng.integers(len(altered))])
        try:
            for _, *places in source_of(path).pairs():
                for place in places:
                    assert read_named(place).ndim == 2
            said = "frames"
        except (FrameError, PairError) as error:
            said = str(error)
        assert "\n" not in said
        ended.add(said == "frames")
    assert ended == {True, False}


def test_names_in_another_alphabet_and_packings_that_do_not_exist(tmp_path):
    content = write_video(tmp_path / "a.mp4", moving(4), "mpeg4", "yuv420p").read_bytes()
    (tmp_path / "b.mp4").write_bytes(content.replace(b"isomiso2", b"iso\xebiso2"))
    assert np.array_equal(read_named(frame(tmp_path / "b.mp4", 2)), read_named(frame(tmp_path / "a.mp4", 2)))
    content = write_video(tmp_path / "d.mp4", moving(4), "libx264", "yuv420p").read_bytes()
    (tmp_path / "c.mp4").write_bytes(content.replace(b"avc1", b"xyz1"))
    with pytest.raises(FrameError, match="its codec is not supported"):
        source_of(tmp_path / "c.mp4")
