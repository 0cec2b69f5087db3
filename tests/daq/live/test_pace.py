"""How often a run is shown: as often as is wanted, made up for frames that come late, less on a full computer."""

import numpy as np
import pytest

from daq.live.live_page import IDLE_HZ, LEAST_HZ, MOST_HZ, RateLimiter


def shown_of(rate_limiter: RateLimiter, times_s: np.ndarray, watched: bool = True) -> int:
    count = 0
    for now_s in times_s.tolist():
        if rate_limiter.is_due(now_s, watched):
            rate_limiter.note_shown(now_s, watched)
            count += 1
    return count


@pytest.mark.parametrize("rate_hz", [20.0, 13.0, 100.0])
def test_frames_that_come_unevenly_are_shown_as_often_as_wanted(rate_hz: float) -> None:
    rng = np.random.default_rng(1)
    times_s = np.sort(np.arange(0.0, 60.0, 1.0 / rate_hz) + rng.uniform(0.0, 0.6 / rate_hz, round(60 * rate_hz)))
    assert shown_of(RateLimiter(), times_s) == pytest.approx(60.0 * MOST_HZ, rel=0.03)


def test_a_slow_camera_is_shown_whole_and_nobody_gets_one_a_second() -> None:
    assert shown_of(RateLimiter(), np.arange(0.0, 30.0, 0.1)) == 300
    rate_limiter, times_s = RateLimiter(), np.arange(0.0, 30.0, 0.05)
    assert shown_of(rate_limiter, times_s, watched=False) == pytest.approx(30 * IDLE_HZ, abs=2)
    assert rate_limiter.is_due(30.0, True)  # whoever comes has a picture with the next frame
    late = shown_of(rate_limiter, np.arange(100.0, 100.5, 0.01))
    assert late <= 0.5 * MOST_HZ + 2.0  # a pause is not made up for


def test_a_full_computer_shows_less_and_says_so_until_it_has_caught_up() -> None:
    rate_limiter, done, left_out = RateLimiter(), 0, 0
    assert rate_limiter.sentence == ""
    for second in range(20):
        done, left_out = done + 10, left_out + 10
        rate_limiter.see(float(second), done, left_out)
        rate_limiter.see(second + 0.5, done, left_out)  # too early to tell
    assert rate_limiter.most_hz == LEAST_HZ
    assert "at most 2 a second" in rate_limiter.sentence
    for second in range(20, 40):
        done, left_out = done + 19, left_out + 1
        rate_limiter.see(float(second), done, left_out)
    assert rate_limiter.most_hz == MOST_HZ
    assert rate_limiter.sentence == ""
