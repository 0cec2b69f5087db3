"""Whether A and B have changed places: found where it is so, silent where it is not."""

import numpy as np
import pytest

from daq.runner.pair_finder import BLOCK, BrightnessSign, mean_counts

FLOOR = 35.0


def lit(count, rng, signal=6.0, spread=0.05):
    """Brightness of lit frames: a laser whose energy varies."""
    return list(FLOOR + signal * (1.0 + spread * rng.standard_normal(count)))


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
