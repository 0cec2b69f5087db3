"""Ids that wrap, jump, repeat; pairs that lose a partner."""

import numpy as np
import pytest

from daq.cameras.frame import Frame, FrameMeta
from daq.cameras.ids import IdTracker
from daq.cameras.pairs import pairs


def test_wrap_skips_zero():
    tracker = IdTracker(bits=16)
    assert [tracker.note(i) for i in (65534, 65535, 1, 2)] == [0, 1, 2, 3]
    assert tracker.missing(0) == 0


def test_gap_over_the_wrap_is_counted():
    tracker = IdTracker(bits=16)
    tracker.note(65533)
    assert tracker.note(3) == 5  # 65534, 65535, 1, 2 are missing
    assert tracker.missing(0) == 4
    assert tracker.missing(3) == 1  # three of them were incomplete or found no buffer


def test_late_and_repeated_frames_do_not_move_the_count():
    tracker = IdTracker(bits=16)
    assert [tracker.note(i) for i in (10, 11, 11, 9, 12)] == [0, 1, 1, 1, 2]
    assert (tracker.missing(0), tracker.repeated) == (0, 2)


def test_64_bit_ids_do_not_wrap():
    tracker = IdTracker()
    assert [tracker.note(i) for i in (65535, 65536, 65538)] == [0, 1, 3]
    assert tracker.missing(0) == 1


def frame(sequence, timestamp_us):
    meta = FrameMeta(sequence, sequence, round(timestamp_us * 1000), 0, 100.0, "Mono12", 12)
    return Frame(np.zeros((2, 2), np.uint16), meta)


@pytest.mark.parametrize("lost", range(8))
def test_one_lost_frame_breaks_one_pair_only(lost):
    frames = [frame(n, 1e5 * (n // 2) + 25 * (n % 2)) for n in range(8) if n != lost]
    found = list(pairs(frames, max_separation_us=1000))
    assert len(found) == 4
    for k, pair in enumerate(found):
        members = [None if f is None else f.meta.sequence for f in (pair.first, pair.second)]
        assert members == [None if n == lost else n for n in (2 * k, 2 * k + 1)]
    whole = [pair for pair in found if pair.first and pair.second]
    assert [pair.separation_us for pair in whole] == [25.0] * 3


def test_neighbouring_ids_far_apart_in_time_are_no_pair():
    found = list(pairs([frame(1, 25), frame(2, 100_000), frame(3, 100_025)], max_separation_us=1000))
    assert found[0].first is None
    assert found[0].second.meta.sequence == 1
    assert found[1].separation_us == 25
