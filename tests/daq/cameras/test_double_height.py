"""Buffers with both exposures are cut in two; memory is given back once; counters count halves."""

import numpy as np
import pytest

from daq.cameras.camera import Counters
from daq.cameras.double_height import DoubleHeightCamera
from daq.cameras.frame import Frame, FrameMeta
from daq.errors import BadFrame


class Stacking:
    """A camera that gives what it is told to."""

    def __init__(self, rows, count=3):
        self.released = []
        self.left = [Frame(np.arange(rows * 4, dtype=np.uint16).reshape(rows, 4) + 1000 * number,
                           FrameMeta(7 + number, number, 10**9 + number, 1, 50.0, "Mono12", 12),
                           lambda number=number: self.released.append(number))
                     for number in range(count)]  # fmt: skip

    def poll(self, timeout_s):
        return self.left.pop(0) if self.left else None

    def arm(self, buffers):
        pass

    def settings(self):
        return {"Height": 8, "Width": 4}

    def disarm(self):
        return Counters(delivered=3, incomplete=1, underrun=2, missing=1, resent=5, ignored_triggers=4)


def test_a_on_top_comes_first_with_neighbouring_numbers():
    inner = Stacking(8)
    camera = DoubleHeightCamera(inner)
    camera.arm()
    first, second = camera.poll(0.0), camera.poll(0.0)
    assert first.pixels.shape == second.pixels.shape == (4, 4)
    assert (first.pixels[0, 0], second.pixels[0, 0]) == (0, 16)
    assert (first.meta.sequence, second.meta.sequence) == (0, 1)
    assert first.meta.timestamp_ns == second.meta.timestamp_ns
    assert camera.poll(0.0).meta.sequence == 2
    first.release()
    assert inner.released == []
    second.release()
    second.release()
    assert inner.released == [0]
    assert camera.settings()["Height"] == 4


def test_counters_count_halves_and_what_nobody_fetched():
    inner = Stacking(8)
    camera = DoubleHeightCamera(inner)
    camera.arm()
    for _ in range(5):
        camera.poll(0.0).release()
    counts = camera.disarm()
    assert (counts.delivered, counts.unused) == (5, 1)
    assert (counts.incomplete, counts.underrun, counts.missing) == (2, 4, 2)
    assert inner.released == [0, 1, 2]  # also the half that nobody fetched


def test_a_buffer_that_cannot_be_cut_is_refused_and_counted():
    inner = Stacking(7, count=1)
    camera = DoubleHeightCamera(inner)
    camera.arm()
    with pytest.raises(BadFrame, match="7 rows cannot hold two exposures"):
        camera.poll(0.0)
    assert inner.released == [0]
    assert camera.disarm().unused == 2
