"""What had light, and whether A and B have changed places: found where it is so, silent where it is not."""

import numpy as np
import pytest

from daq.runner.brightness import BLOCK, BrightnessSign, LightWatch, had_light, mean_counts

FLOOR = 35.0


def lit(count, rng, signal=6.0, spread=0.05):
    """Brightness of lit frames: a laser whose energy varies."""
    return list(FLOOR + signal * (1.0 + spread * rng.standard_normal(count)))


def dark(count, rng):
    return list(FLOOR + 0.01 * rng.standard_normal(count))


@pytest.mark.parametrize("signal", [0.5, 2.0, 6.0, 100.0])
@pytest.mark.parametrize("before", range(7))
def test_the_first_light_is_found(before, signal):
    rng = np.random.default_rng(before)
    for _ in range(50):
        counts = dark(before, rng) + lit(7 - before, rng, signal)
        assert had_light(counts) == [False] * before + [True] * (7 - before)


def test_light_between_darkness_is_found():
    rng = np.random.default_rng(8)
    for count in (1, 2, 4):
        counts = dark(5, rng) + lit(count, rng) + dark(9, rng)
        assert had_light(counts) == [False] * 5 + [True] * count + [False] * 9


def test_without_any_light_nothing_is_cut():
    rng = np.random.default_rng(0)
    assert all(all(had_light(dark(7, rng))) for _ in range(200))


def test_frames_behind_the_last_light_are_told():
    rng, watch = np.random.default_rng(1), LightWatch()
    assert all(watch.is_lit(counts) for counts in lit(50, rng))
    assert not any(watch.is_lit(counts) for counts in dark(6, rng))


def test_lit_frames_are_hardly_ever_taken_for_dark():
    rng, watch = np.random.default_rng(2), LightWatch()
    assert sum(not watch.is_lit(counts) for counts in lit(20_000, rng)) <= 2


@pytest.mark.parametrize("flips_at", [20, 27, 40, 333])
def test_a_flip_is_seen_within_two_blocks(flips_at):
    rng, sign = np.random.default_rng(3), BrightnessSign()
    for number in range(1000):
        first, second = lit(1, rng)[0], lit(1, rng)[0] + 1.5
        if number >= flips_at:
            first, second = second, first
        if sign.is_flipped(first, second):
            assert flips_at + BLOCK // 2 <= number < flips_at + 2 * BLOCK
            return
    pytest.fail("the flip was not seen")


@pytest.mark.parametrize("difference", [0.0, 0.05, 0.3, 2.0])
def test_without_a_flip_nobody_cries(difference):
    rng, sign = np.random.default_rng(4), BrightnessSign()
    for _ in range(20_000):
        common = lit(1, rng)[0]
        assert not sign.is_flipped(common + 0.1 * rng.standard_normal(), common + difference)


def test_the_mean_of_a_frame_is_that_of_its_pixels():
    frame = np.random.default_rng(5).integers(0, 100, (512, 512)).astype(np.uint16)
    assert mean_counts(frame) == pytest.approx(frame.mean(), abs=1.0)


def test_what_was_dark_once_is_known_later():
    rng, watch = np.random.default_rng(6), LightWatch()
    counts = dark(3, rng) + lit(1, rng)
    assert watch.are_lit(counts) == [False] * 3 + [True]
    assert not any(watch.is_lit(one) for one in dark(5, rng))
    assert all(watch.are_lit(lit(5, rng)))
    assert not any(watch.are_lit(dark(3, rng)))
