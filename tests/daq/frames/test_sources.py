"""Every kind of source keeps one contract: the same pairs, by names that can be read one by one anywhere."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.frames.named_frame import read_named
from daq.frames.source import KINDS, is_source, source_of
from piv.errors import FrameDamaged, FrameError, PairError
from piv.files.frame_file import checksum
from tests.daq.frames.davis_files import StandIn
from tests.daq.frames.videos import write_video
from tests.loops import loop_over

h5py = pytest.importorskip("h5py")
PAIRS, SHAPE = 3, (6, 8)


def frames(kind=np.uint16):
    return (np.arange(2 * PAIRS * 48).reshape(PAIRS, 2, *SHAPE) % 251).astype(kind)


def letters(folder, stack):
    for number, pair in enumerate(stack):
        for letter, frame in zip("ab", pair, strict=True):
            tifffile.imwrite(folder / f"B{number:05d}_{letter}.tif", frame)
    return folder / "B%05d_a.tif"


def numbers(folder, stack):
    for number, frame in enumerate(stack.reshape(-1, *SHAPE)):
        tifffile.imwrite(folder / f"im{number + 7}.tif", frame)
    return folder / "im%d.tif"


def pages(folder, stack):
    tifffile.imwrite(folder / "stack.tif", stack.reshape(-1, *SHAPE), photometric="minisblack")
    return folder / "stack.tif"


def in_pairs(folder, stack):
    with h5py.File(folder / "data.h5", "w") as file:
        file["frames"] = stack
        file["times"] = np.arange(PAIRS)
    return folder / "data.h5"


def nexus(folder, stack):
    with h5py.File(folder / "data.nxs", "w") as file:
        file["entry/data/frames"] = stack.reshape(-1, *SHAPE)
        file["entry/dark/frames"] = stack.reshape(-1, *SHAPE)
        file.attrs["default"], file["entry"].attrs["default"] = "entry", "data"
        file["entry/data"].attrs["signal"] = "frames"
    return folder / "data.nxs"


def by_name(folder, stack):
    return Path(f"{nexus(folder, stack)}@/entry/dark/frames")


def folder(folder, stack):
    tifffile.imwrite(folder / "target_clear.tif", stack[0, 0])  # has no number
    return letters(folder, stack).parent


def video(folder, stack):
    pytest.importorskip("av")
    return write_video(folder / "run.mkv", stack.reshape(-1, *SHAPE), pixels="gray16le")


def davis(folder, stack):
    sys.modules["lvpyio"].write_set([list(pair) for pair in stack], folder / "run.set")
    return folder / "run.set"


@pytest.fixture(autouse=True)
def stand_in(monkeypatch):
    """For lvpyio, which is not among what the tests install (`davis_files`)."""
    monkeypatch.setitem(sys.modules, "lvpyio", StandIn())


def second_pattern(folder, stack):
    letters(folder, stack)
    return folder / "B%05d_a.tif@@B%05d_b.tif"


def double(folder, stack):
    for number, pair in enumerate(stack):
        tifffile.imwrite(folder / f"im{number}.tif", np.vstack(pair))
    return Path(f"{folder}@top-bottom")


ALL = [second_pattern, double, letters, numbers, pages, in_pairs, nexus, by_name, folder, davis]


def test_every_kind_is_under_contract(tmp_path):
    asked = {type(source_of(make(_own(tmp_path, make), frames()))).__name__ for make in (*ALL, video)}
    assert asked == {place.partition(":")[2] for place in KINDS}


def _own(tmp_path, make):
    (tmp_path / make.__name__).mkdir(exist_ok=True)
    return tmp_path / make.__name__


@pytest.mark.parametrize("make", ALL)
@loop_over("kind", [np.uint8, np.uint16, np.float32])
def test_pairs_come_in_order_with_names_that_are_read_one_by_one(tmp_path, make, kind):
    stack = frames(kind)
    (tmp_path / kind.__name__).mkdir()
    path = make(tmp_path / kind.__name__, stack)
    assert is_source(path)
    source = source_of(path)
    assert (len(source.pairs()), source.count_unpaired()) == (PAIRS, 0)
    for (number, *places), pair in zip(source.pairs(), stack, strict=True):
        assert number == source.pairs().index((number, *places))
        for place, frame in zip(places, pair, strict=True):
            assert source.file_of(place).is_file()
            found = read_named(place, SHAPE, checksum(frame))
            assert (found.dtype, found.tolist()) == (kind, frame.tolist())
            with pytest.raises(FrameDamaged, match="checksum"):
                read_named(place, SHAPE, "00000000")
            with pytest.raises(FrameError, match=r"8 x 6 px"):
                read_named(place, (8, 6))


@pytest.mark.parametrize("make", [in_pairs, nexus])
def test_big_endian_images_are_the_same_frames(tmp_path, make):
    stack = frames(">u2")
    _, first, _ = source_of(make(tmp_path, stack)).pairs()[0]
    assert read_named(first, SHAPE, checksum(frames()[0, 0])).tolist() == stack[0, 0].tolist()


def test_a_missing_frame_costs_its_own_pair(tmp_path):
    path = numbers(tmp_path, frames())
    (tmp_path / "im9.tif").unlink()  # first frame of pair 1
    source = source_of(path)
    assert [number for number, *_ in source.pairs()] == [0, 2]
    assert [place.name for place in source.pairs()[1][1:]] == ["im11.tif", "im12.tif"]
    assert source.count_unpaired() == 1
    (tmp_path / "letters").mkdir()
    path = letters(tmp_path / "letters", frames())
    (tmp_path / "letters" / "B00001_b.tif").unlink()
    source = source_of(path)
    assert ([number for number, *_ in source.pairs()], source.count_unpaired()) == ([0, 2], 1)


@pytest.mark.parametrize("make", [pages, nexus])
def test_the_last_frame_of_an_odd_number_is_alone(tmp_path, make):
    odd = np.stack([*frames().reshape(-1, *SHAPE), np.zeros(SHAPE, np.uint16)])
    source = source_of(make(tmp_path, odd))
    assert (len(source.pairs()), source.count_unpaired()) == (PAIRS, 1)


@pytest.mark.parametrize("make", [numbers, pages, nexus, video])
@pytest.mark.parametrize(
    ("said", "pairs", "alone"),
    [
        ("1-2", [(1, 2), (3, 4), (5, 6)], 0),
        ("1-2,2-3", [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6)], 0),
        ("1-3,2-4", [(1, 3), (2, 4), (3, 5), (4, 6)], 0),
        ("1-2,5-6", [(1, 2), (5, 6)], 2),
        ("2-3,4-5", [(2, 3), (4, 5)], 2),
    ],
)
def test_a_sequence_is_paired_as_is_said_behind_its_name(tmp_path, make, said, pairs, alone):
    stack = frames()
    source = source_of(Path(f"{make(tmp_path, stack)}@{said}"))
    found = [[int(read_named(place)[0, 0]) for place in places] for _, *places in source.pairs()]
    firsts = stack.reshape(-1, *SHAPE)[:, 0, 0].tolist()
    assert found == [[firsts[a - 1], firsts[b - 1]] for a, b in pairs]
    assert [number for number, *_ in source.pairs()] == list(range(len(pairs)))
    assert source.count_unpaired() == alone


def test_a_missing_frame_of_a_time_resolved_series_costs_two_pairs(tmp_path):
    path = numbers(tmp_path, frames())
    (tmp_path / "im9.tif").unlink()
    assert [number for number, *_ in source_of(Path(f"{path}@1-2,2-3")).pairs()] == [0, 3, 4]


@pytest.mark.parametrize("said", ["2-1", "1-1", "0-1", "1-2,1-2", "1-2,2-4", "3-4,1-2"])
def test_pairs_that_begin_no_series_are_refused(tmp_path, said):
    with pytest.raises(PairError, match=r"1-2,3-4 or 1-2,2-3"):
        source_of(Path(f"{pages(tmp_path, frames())}@{said}"))


@pytest.mark.parametrize("make", [letters, in_pairs])
def test_frames_that_are_pairs_already_are_not_paired_again(tmp_path, make):
    with pytest.raises(PairError, match="remove the numbers after @"):
        source_of(Path(f"{make(tmp_path, frames())}@1-2,2-3"))


def test_numbers_of_more_digits_and_other_names_are_told_apart(tmp_path):
    letters(tmp_path, frames())
    for name in ("B1_a.tif", "B00001_a.tiff", "XB00001_a.tif", "B00001_a.tif.part", "B-0001_a.tif"):
        (tmp_path / name).write_bytes(b"")
    assert [n for n, *_ in source_of(tmp_path / "B%05d_a.tif").pairs()] == [0, 1, 2]
    for letter in "ab":
        tifffile.imwrite(tmp_path / f"B100000_{letter}.tif", frames()[0, 0])
    assert [n for n, *_ in source_of(tmp_path / "B%05d_a.tif").pairs()] == [0, 1, 2, 100000]


def test_a_folder_with_several_numberings_asks_which(tmp_path):
    for name in ("im001.tif", "im002.tif", "B00001_a.tif", "B00001_b.tif"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(PairError, match=r'B%05d_a.tif" --second "B%05d_b.tif"  or  ".*im%03d.tif"'):
        source_of(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "frame.tif").write_bytes(b"")
    assert not is_source(tmp_path / "other")


def test_a_tiff_of_one_page_is_a_frame_and_no_source(tmp_path):
    tifffile.imwrite(tmp_path / "frame.tif", frames()[0, 0])
    assert not is_source(tmp_path / "frame.tif")


def test_what_cannot_be_read_is_one_sentence(tmp_path):
    (tmp_path / "empty.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "torn.tif").write_bytes(b"II*\0")
    with h5py.File(tmp_path / "two.h5", "w") as file:
        file["x"], file["y"], file["colour"] = frames()[0], frames()[0], np.zeros((3, 4, 5, 3), np.uint8)
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file["a"] = np.zeros((4, 4), np.uint16)
    for name, kind, words in (
        ("empty.h5", FrameError, "is not readable as HDF5"),
        ("nothing.h5", FrameError, "is not readable as HDF5"),
        ("two.h5", FrameError, "several stacks of images; name one: .*two.h5@/x, .*two.h5@/y"),
        ("two.h5@/colour", FrameError, "/colour is 3 x 4 x 5 x 3; images are n x H x W"),
        ("two.h5@/c", FrameError, "/c is not a data set"),
        ("none.h5", FrameError, "holds no stack of images: /a is 4 x 4"),
        ("torn.tif", FrameError, "TIFF|cannot be read"),
        ("nothing.tif", FrameError, "no such file"),
        ("B%05d_a.tif", PairError, "no file has such a name"),
        ("nowhere/B%05d_a.tif", PairError, "cannot be looked into"),
        ("notes.txt", PairError, "neither a run nor frames"),
        ("B%05d_%d.tif", FrameError, "no such file"),
    ):
        with pytest.raises(kind, match=re.compile(words, re.IGNORECASE)) as raised:
            source_of(tmp_path / name)
        assert len(str(raised.value).splitlines()) == 1
    (tmp_path / "nan").mkdir()
    _, first, _ = source_of(in_pairs(tmp_path / "nan", np.full((1, 2, *SHAPE), np.nan, np.float32))).pairs()[0]
    with pytest.raises(FrameError, match="holds nan"):
        read_named(first)
    with pytest.raises(FrameError, match="cannot be read"):
        read_named(Path(str(first).replace("@0", "@99")))
