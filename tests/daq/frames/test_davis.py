"""Images of DaVis: frames by their number through a set, and what cannot be read right refused by name.

By a stand-in of lvpyio, and by lvpyio itself where it is installed; a real file of DaVis where `readim7`, another
reader with two of them, is installed too.
"""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from daq.errors import RunUsageError
from daq.frames.named_frame import read_named
from daq.frames.source import is_source, source_of
from piv.errors import FrameError
from tests.daq.frames.davis_files import StandIn, frame_of

H, W = 24, 40


@pytest.fixture(params=["stand-in", "lvpyio"])
def library(request, monkeypatch):
    if request.param == "lvpyio":
        return pytest.importorskip("lvpyio")
    monkeypatch.setitem(sys.modules, "lvpyio", StandIn())
    return sys.modules["lvpyio"]


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "lvpyio", StandIn())
    return sys.modules["lvpyio"]


def drawn(buffers, frames, kind=np.uint16):
    rng = np.random.default_rng(7)
    return [[rng.integers(0, 4095, (H, W)).astype(kind) for _ in range(frames)] for _ in range(buffers)]


def names(source):
    return [tuple(place.name for place in places) for _, *places in source.pairs()]


def test_a_set_of_double_frames_is_its_pairs_to_the_bit(tmp_path, library):
    shown, path = drawn(3, 2), tmp_path / "run.set"
    library.write_set(shown, str(path))
    assert is_source(path)
    source = source_of(path)
    assert names(source) == [("run.set@1", "run.set@2"), ("run.set@3", "run.set@4"), ("run.set@5", "run.set@6")]
    for number in (6, 1, 4, 3):
        place = path.with_name(f"run.set@{number}")
        found = read_named(place, (H, W))
        assert found.dtype == np.uint16
        assert np.array_equal(found, shown[(number - 1) // 2][(number - 1) % 2])
        assert source.file_of(place) == tmp_path / "run" / f"B{(number + 1) // 2:05d}.im7"


def test_a_set_of_single_frames_is_paired_as_is_said(tmp_path, library):
    library.write_set(drawn(4, 1), str(tmp_path / "run.set"))
    source = source_of(Path(f"{tmp_path / 'run.set'}@1-2,2-3"))
    assert names(source)[:2] == [("run.set@1", "run.set@2"), ("run.set@2", "run.set@3")]


def test_an_image_of_one_frame_is_a_frame_and_of_two_a_pair(tmp_path, library):
    (one,), (two,) = drawn(1, 1), drawn(1, 2)
    library.write_buffer(one, str(tmp_path / "one.im7"))
    library.write_buffer(two, str(tmp_path / "two.im7"))
    assert not is_source(tmp_path / "one.im7")
    assert np.array_equal(read_named(tmp_path / "one.im7"), one[0])
    assert names(source_of(tmp_path / "two.im7")) == [("two.im7@1", "two.im7@2")]
    with pytest.raises(FrameError, match=r"two\.im7: holds 2 frames; name one, such as two\.im7@1"):
        read_named(tmp_path / "two.im7")
    with pytest.raises(FrameError, match=r"two\.im7@3: there are frames 1 to 2, and no 3"):
        read_named(tmp_path / "two.im7@3")
    with pytest.raises(FrameError, match=r"is 40 x 24 px, and should be 24 x 40 px"):
        read_named(tmp_path / "two.im7@2", (W, H))


def test_floats_stay_what_they_are(tmp_path, library):
    shown = [[np.linspace(0.0, 5.0, H * W, dtype=np.float32).reshape(H, W)]]
    library.write_set(shown, str(tmp_path / "run.set"))
    found = read_named(tmp_path / "run.set@1")
    assert found.dtype == np.float32
    assert np.array_equal(found, shown[0][0])


def test_a_scale_of_intensity_counts(tmp_path, stand_in):
    (image,) = drawn(1, 1)
    stand_in.write_buffer([frame_of(image[0], scale=(0.5, 10.0))], tmp_path / "a.im7")
    np.testing.assert_allclose(read_named(tmp_path / "a.im7"), 10.0 + 0.5 * image[0], rtol=1e-6)


PIXELS = np.ones((H, W), np.uint16)
REFUSED = {
    "is masked in DaVis": lambda: frame_of(PIXELS, mask=np.eye(H, W, dtype=np.uint8)),
    "holds vectors, not pixels": lambda: frame_of(PIXELS, kind="VectorFrame"),
    "raw of a colour sensor": lambda: frame_of(PIXELS, RGBFrame="1"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_no_frame_as_acquired_is_refused(tmp_path, stand_in, words):
    stand_in.write_buffer([REFUSED[words]()], tmp_path / "a.im7")
    with pytest.raises(FrameError, match=words) as caught:
        read_named(tmp_path / "a.im7")
    assert str(caught.value).startswith(f"{tmp_path / 'a.im7'}: ")


def test_frames_of_two_cameras_are_no_series(tmp_path, stand_in):
    frames = [frame_of(PIXELS + n, CameraName=name) for n, name in enumerate(("1A: X", "1B: X", "2A: X", "2B: X"))]
    stand_in.write_buffer(frames, tmp_path / "a.im7")
    with pytest.raises(FrameError, match=r"cameras 1, 2; name two of one camera, such as a\.im7@3 a\.im7@4"):
        source_of(tmp_path / "a.im7")
    assert read_named(tmp_path / "a.im7@3")[0, 0] == 3


def test_what_is_damaged_is_refused_and_no_other_frame_with_it(tmp_path, stand_in):
    """Packed pixels that are cut short leave nothing behind them, and lvpyio says nothing of it."""
    stand_in.write_set(drawn(3, 2), tmp_path / "run.set")
    stand_in.write_buffer(drawn(1, 2)[0], tmp_path / "run" / "B00002.im7", attributes={"LoadFile": "x"})
    with pytest.raises(FrameError, match=r"run\.set@3: is damaged or cut short"):
        read_named(tmp_path / "run.set@3")
    assert read_named(tmp_path / "run.set@5").shape == (H, W)


def test_a_file_that_is_none_is_one_sentence(tmp_path, library):
    (tmp_path / "a.im7").write_bytes(b"abc" * 100)
    for name in ("a.im7", "a.im7@1"):
        with pytest.raises(FrameError, match=r"a\.im7: cannot be read by lvpyio \(\w+"):
            read_named(tmp_path / name)
    (tmp_path / "b.set").write_bytes(b"\xff\xfe" * 100)
    with pytest.raises(FrameError, match=r"b\.set: (cannot be read by lvpyio|holds 0 frames)"):
        source_of(tmp_path / "b.set")
    for name in ("none.im7", "none.set@2"):
        with pytest.raises(FrameError, match="cannot be read: No such file"):
            read_named(tmp_path / name)


def test_without_the_library_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "lvpyio", None)
    for name in ("a.im7", "b.set"):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(RunUsageError, match=r"needs lvpyio; install rtpiv\[davis\], or export as TIFF"):
            source_of(tmp_path / name)
        with pytest.raises(RunUsageError, match="rtpiv"):
            read_named(tmp_path / f"{name}@1")


def test_real_files_of_davis_are_read_as_another_reader_does_and_cut_ones_refused(tmp_path):
    pytest.importorskip("lvpyio")
    readim7 = pytest.importorskip("readim7")
    samples = Path(importlib.import_module("readim7").__file__).parent / "sample_files"
    for name, count in (("1camera.im7", 2), ("2cameras.im7", 4)):
        buffer, _ = readim7.get_Buffer_andAttributeList(str(samples / name))
        shown, _ = readim7.buffer_as_array(buffer)
        for number in range(1, count + 1):
            assert np.array_equal(read_named(samples / f"{name}@{number}"), shown[number - 1])
    assert names(source_of(samples / "1camera.im7")) == [("1camera.im7@1", "1camera.im7@2")]
    with pytest.raises(FrameError, match="cameras 1, 2"):
        source_of(samples / "2cameras.im7")
    whole = (samples / "1camera.im7").read_bytes()
    for left in (300, 10_000, 500_000, 1_000_000, len(whole) - 20_000):
        (tmp_path / "cut.im7").write_bytes(whole[:left])
        with pytest.raises(FrameError, match="damaged or cut short"):
            read_named(tmp_path / "cut.im7@1")
