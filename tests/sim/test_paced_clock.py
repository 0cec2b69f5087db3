"""A paced clock is virtual until somebody looks in real time, and knows its moments on the wall's clock."""

import time

from sim.mechanics.clock import PacedClock, ScaledClock


def test_without_anybody_who_looks_time_passes_at_once():
    clock, begun_s = PacedClock(), time.monotonic()
    clock.sleep_s(1000.0)
    clock.advance_to(1500.0)
    clock.advance_to(3.0)
    assert clock.now_s() == 1500.0
    assert time.monotonic() - begun_s < 0.5


def test_it_keeps_pace_while_it_has_to_and_never_goes_back():
    clock, looks = PacedClock(), []
    clock.is_paced = lambda: bool(looks)
    clock.sleep_s(100.0)
    looks.append(1)
    first, begun_ns = clock.now_s(), time.monotonic_ns()
    clock.sleep_s(0.05)
    assert 0.045 <= clock.now_s() - first < 0.5
    assert abs(clock.wall_ns(first) - begun_ns) < 50_000_000
    assert clock.wall_ns(first + 1.0) - clock.wall_ns(first) == 1_000_000_000
    looks.clear()
    before = clock.now_s()
    clock.sleep_s(1000.0)
    assert clock.now_s() == before + 1000.0
    looks.append(1)
    assert clock.now_s() >= before + 1000.0


def test_a_scaled_clock_says_when_its_moments_are():
    clock = ScaledClock(10.0)
    now_s, wall_ns = clock.now_s(), time.monotonic_ns()
    assert abs(clock.wall_ns(now_s) - wall_ns) < 50_000_000
    assert clock.wall_ns(now_s + 1.0) - clock.wall_ns(now_s) == 100_000_000
