"""Ids that wrap, jump, repeat."""

import pytest

from daq.cameras.ids import IdTracker


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


def test_a_frame_behind_a_later_one_fills_its_gap_and_is_counted_once():
    tracker = IdTracker(bits=16)
    assert [tracker.note(i) for i in (65534, 2, 1, 1, 3)] == [0, 3, 2, 3, 4]
    assert (tracker.gaps, tracker.missing(0), tracker.repeated) == (1, 1, 1)  # 65535 has not come


def test_64_bit_ids_do_not_wrap():
    tracker = IdTracker()
    assert [tracker.note(i) for i in (65535, 65536, 65538)] == [0, 1, 3]
    assert tracker.missing(0) == 1


@pytest.mark.parametrize("ids", [(65534, 65535, 1, 2), (65534, 65535, 0, 1)])
def test_a_wrap_of_16_bits_is_seen_behind_a_producer_of_any_type(ids):
    tracker = IdTracker()
    assert [tracker.note(i) for i in ids] == [0, 1, 2, 3]
    assert (tracker.missing(0), tracker.repeated) == (0, 0)


def test_frames_that_are_lost_or_late_at_a_wrap_are_told_behind_a_producer_of_any_type():
    tracker = IdTracker()
    assert [tracker.note(i) for i in (65533, 3, 65535, 4)] == [0, 5, 2, 6]
    assert (tracker.missing(0), tracker.repeated) == (3, 0)


def test_a_camera_that_counts_anew_is_no_wrap():
    tracker = IdTracker()
    assert [tracker.note(i) for i in (40_000, 1, 2)] == [0, 0, 0]
    assert (tracker.missing(0), tracker.repeated) == (0, 2)
