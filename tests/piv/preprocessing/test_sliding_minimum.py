"""The sliding minimum of a pulse, streamed: equal to brute force to the last bit; what it must not do."""

import numpy as np
import pytest

from piv.errors import FrameError
from piv.preprocessing.sliding_minimum import DARK_SHARE, without_sliding_minimum
from tests.loops import loop_over


def brute_force(frames, reach):
    """By single pixels, in whole numbers."""
    clean = np.empty_like(frames)
    for step, row, column in np.ndindex(frames.shape):
        near = range(max(0, step - reach), min(len(frames), step + reach + 1))
        clean[step, row, column] = int(frames[step, row, column]) - min(int(frames[s, row, column]) for s in near)
    return clean


@loop_over("reach", [1, 4, 20])
@loop_over("count", [2, 5, 9, 23])
def test_it_is_brute_force_to_the_last_bit(count, reach):
    frames = np.random.default_rng(count).integers(0, 65536, (count, 5, 6)).astype(np.uint16)
    clean = list(without_sliding_minimum(iter(frames), reach))
    assert len(clean) == count
    assert clean[0].dtype == np.uint16
    assert np.array_equal(np.array(clean), brute_force(frames, reach))


@pytest.mark.parametrize("dark_share", [0.0, DARK_SHARE])
def test_of_frames_alike_none_is_dark(dark_share):
    frames = np.random.default_rng(3).integers(20, 4096, (30, 40, 40)).astype(np.uint16)
    assert np.array_equal(
        np.array(list(without_sliding_minimum(iter(frames), 4, dark_share))), brute_force(frames, 4)
    )


def test_it_holds_no_more_frames_than_it_looks_at():
    made = delivered = most = 0

    def frames():
        nonlocal made
        for _ in range(100):
            made += 1
            yield np.zeros((4, 4), np.uint16)

    for _ in without_sliding_minimum(frames(), 4):
        delivered += 1
        most = max(most, made - delivered)
    assert (made, delivered, most) == (100, 100, 4)


def test_input_stays_as_it_was():
    frames = np.random.default_rng(4).integers(0, 4096, (12, 8, 8)).astype(np.uint16)
    kept = frames.copy()
    list(without_sliding_minimum(iter(frames), 4, DARK_SHARE))
    assert np.array_equal(frames, kept)


def test_a_lost_frame_takes_its_place_in_time_and_no_part_in_the_minimum():
    frames = list(np.random.default_rng(5).integers(0, 4096, (11, 6, 6)).astype(np.uint16))
    clean = list(without_sliding_minimum([*frames[:5], None, *frames[6:]], 4))
    assert clean[5] is None
    near = [frames[k] for k in (0, 1, 2, 3, 4, 6, 7, 8)]
    assert np.array_equal(clean[4], frames[4] - np.min(near, axis=0))
    assert np.array_equal(clean[10], frames[10] - np.min(frames[6:], axis=0))


def reflections(rng, count=20, side=64, moving=0.0):
    """Static reflections of a sheet on dark noise, sparse particles that are elsewhere in every frame."""
    frames = rng.normal(35.0, 2.0, (count, side, side))
    for number, frame in enumerate(frames):
        shift = round(moving * number)
        frame[20 + shift : 30 + shift, 10:40] += 900.0
        places = rng.integers(0, side, (40, 2))
        frame[places[:, 0], places[:, 1]] += 250.0
    return np.clip(np.rint(frames), 0, 4095).astype(np.uint16)


def test_static_reflections_go_and_particles_stay():
    frames = reflections(np.random.default_rng(6))
    clean = np.array(list(without_sliding_minimum(iter(frames), 4)))
    assert clean[:, 21:29, 12:38].mean() < 20.0
    assert np.percentile(clean, 99.9) > 200.0


def test_one_dark_frame_does_not_bring_the_reflections_back():
    """A failed flash: the plain minimum leaves the reflection in eight frames, one that sees it in none."""
    frames = reflections(np.random.default_rng(7))
    frames[9] = np.random.default_rng(8).normal(35.0, 2.0, frames[9].shape).astype(np.uint16)
    inside = (slice(21, 29), slice(12, 38))
    plain = np.array([c[inside].mean() for c in without_sliding_minimum(iter(frames), 4)])
    seeing = np.array([c[inside].mean() for c in without_sliding_minimum(iter(frames), 4, DARK_SHARE)])
    others = np.arange(20) != 9
    assert np.count_nonzero(plain[others] > 800.0) == 8
    assert seeing[others].max() < 20.0


def test_saturated_pixels_wrap_nowhere():
    frames = np.full((9, 6, 6), 65535, np.uint16)
    frames[:, 3, 3] = 0
    frames[4, 3, 3] = 65535
    clean = np.array(list(without_sliding_minimum(iter(frames), 4, DARK_SHARE)))
    assert clean[4, 3, 3] == 65535
    assert clean.sum(dtype=np.int64) == 65535


def test_a_reflection_that_moves_faster_than_the_reach_is_not_background():
    """What moves by its own width within the reach cannot be told from particles: it stays, and this says so."""
    frames = reflections(np.random.default_rng(9), moving=1.5)
    clean = list(without_sliding_minimum(iter(frames), 4))
    assert clean[9][33:42, 12:38].mean() > 400.0


def test_a_frame_that_nobody_is_near_to_has_no_background_and_ends_nothing():
    frames = [np.full((4, 4), count, np.uint16) for count in (9, 7, 5)]
    assert list(without_sliding_minimum(frames[:1])) == [None]
    clean = list(without_sliding_minimum([frames[0], None, None, *frames[1:]], 2))
    assert clean[:3] == [None] * 3
    assert [int(each.max()) for each in clean[3:]] == [2, 0]


def test_what_is_no_series_is_named():
    square = np.zeros((4, 4), np.uint16)
    with pytest.raises(FrameError, match="reach of at least 1"):
        list(without_sliding_minimum([square, square], 0))
    with pytest.raises(FrameError, match=r"\(5, 4\) and those before it"):
        list(without_sliding_minimum([square, np.zeros((5, 4), np.uint16)]))
    with pytest.raises(FrameError, match="uint8"):
        list(without_sliding_minimum([square, square.astype(np.uint8)]))
    with pytest.raises(FrameError, match="2-D array"):
        list(without_sliding_minimum([np.zeros((4, 4, 3))] * 2))


@pytest.mark.slow
def test_full_size_full_scale_to_the_last_bit():
    """40 frames of 4 million pixels over all 65536 grey levels against a whole-series minimum."""
    rng = np.random.default_rng(10)
    frames = rng.integers(0, 65536, (40, 2016, 2016), dtype=np.uint16)
    for step, clean in enumerate(without_sliding_minimum(iter(frames), 4, DARK_SHARE)):
        lowest = frames[max(0, step - 4) : step + 5].min(axis=0)
        assert np.array_equal(clean + lowest, frames[step])
        assert np.array_equal(clean, frames[step].astype(np.int32) - lowest)
