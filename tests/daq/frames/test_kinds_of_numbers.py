"""Frames of any kind of number, in TIFF and HDF5, in any order of axes: read right, or refused with the reason."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from daq.frames.named_frame import read_named
from daq.frames.source import source_of
from piv.errors import FrameError, PairError
from tests.loops import loop_over

h5py = pytest.importorskip("h5py")
SHAPE = (40, 48)
STACK = np.random.default_rng(0).integers(0, 120, (6, *SHAPE))
KINDS = ("u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f4", "f8", ">i2", ">f8", ">u4")
AS_THEY_ARE = ("u1", "u2", "f4")


@loop_over("kind", KINDS)
def test_any_kind_of_number_is_read(tmp_path, kind):
    values = STACK if "u" in kind else STACK - 60
    wanted = kind[-2:] if kind[-2:] in AS_THEY_ARE else "f4"
    tifffile.imwrite(tmp_path / "a.tif", values[0].astype(kind), byteorder=kind[0] if kind[0] == ">" else None)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["images"] = values.astype(kind)
    _, first, second = source_of(tmp_path / "a.h5").pairs()[1]
    for place, number in ((tmp_path / "a.tif", 0), (first, 2), (second, 3)):
        found = read_named(place, SHAPE)
        assert found.dtype == wanted
        np.testing.assert_array_equal(found, values[number])


@pytest.mark.parametrize("kind", ["f2", "c8", "bool"])
def test_other_kinds_are_refused_by_their_names(tmp_path, kind):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["images"] = STACK.astype(kind)
    with pytest.raises(FrameError, match=rf"/images holds {np.dtype(kind)}; frames are integers"):
        source_of(tmp_path / "a.h5")
    with pytest.raises(FrameError, match=rf"holds {np.dtype(kind)}; frames are integers"):
        source_of(tmp_path / "a.h5@/images")


def test_half_numbers_of_a_tiff_are_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", STACK[0].astype(np.float16))
    with pytest.raises(FrameError, match="holds float16; frames are integers"):
        read_named(tmp_path / "a.tif")


def test_axes_in_any_order(tmp_path):
    stack = STACK.astype(np.uint16)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["last"] = np.moveaxis(stack, 0, -1)
        file["single"] = stack[..., None]
        file["paired"] = stack.reshape(3, 2, *SHAPE)
        file["matlab"] = stack.transpose(0, 2, 1)  # as MATLAB writes H x W x n
        file["matlab"].attrs["MATLAB_class"] = np.bytes_("uint16")
        file["flat"], file["cubes"] = np.zeros((40, 48)), np.zeros((3, 4, 5, 6))
    for name in ("last", "single", "paired", "matlab"):
        found = [
            [read_named(place, SHAPE) for place in places]
            for _, *places in source_of(Path(f"{tmp_path / 'a.h5'}@/{name}")).pairs()
        ]
        np.testing.assert_array_equal(found, stack.reshape(3, 2, *SHAPE))
    for name, words in (
        ("flat", "is 40 x 48; images are"),
        ("cubes", "is 3 x 4 x 5 x 6; images are"),
        ("no", "not a data set"),
    ):
        with pytest.raises(FrameError, match=words):
            source_of(Path(f"{tmp_path / 'a.h5'}@/{name}"))


@pytest.mark.parametrize(
    "names", [("A", "B"), ("frame0", "frame1"), ("cam1/images_a", "cam1/images_b"), ("a1", "b1")]
)
def test_first_and_second_frames_in_data_sets_of_their_own(tmp_path, names):
    with h5py.File(tmp_path / "two.h5", "w") as file:
        for k, name in enumerate(names):
            file[name] = STACK[k::2].astype(np.uint8)
        file["times"] = np.arange(3.0)
    for path in (tmp_path / "two.h5", Path(f"{tmp_path / 'two.h5'}@/{names[0]}")):
        pairs = source_of(path).pairs()
        found = [[read_named(place, SHAPE) for place in places] for _, *places in pairs]
        np.testing.assert_array_equal(found, STACK.reshape(3, 2, *SHAPE))
    with pytest.raises(FrameError, match=f"these are second frames; give .*two.h5@/{names[0]}"):
        source_of(Path(f"{tmp_path / 'two.h5'}@/{names[1]}"))
    with pytest.raises(PairError, match="pairs already"):
        source_of(Path(f"{tmp_path / 'two.h5'}@1-2,2-3"))
