"""Frames come in their order, each as it was written, and what is wrong with one is known before the first."""

import threading

import numpy as np
import pytest
import tifffile

from daq.runs.acquired import ReadAhead
from piv.errors import FrameError

SHAPE = (8, 12)


@pytest.fixture
def paths(tmp_path):
    found = []
    for number in range(5):
        found.append(tmp_path / f"{number}.tif")
        tifffile.imwrite(found[-1], np.full(SHAPE, number, np.uint16))
    return found


def test_all_come_in_their_order(paths):
    with ReadAhead(paths, SHAPE) as frames:
        frames.require_sound()
        assert [int(frame[0, 0]) for frame in frames] == [0, 1, 2, 3, 4]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("rtpiv-frames")]


@pytest.mark.parametrize("wrong", [0, 3])
def test_one_that_is_damaged_is_known_before_any_is_used(paths, wrong):
    paths[wrong].write_bytes(b"II*\0 no frame")
    with ReadAhead(paths, SHAPE) as frames, pytest.raises(FrameError, match=paths[wrong].name):
        frames.require_sound()


def test_none_are_none():
    with ReadAhead([], SHAPE) as frames:
        frames.require_sound()
        assert list(frames) == []
