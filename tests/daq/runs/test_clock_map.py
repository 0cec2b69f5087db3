"""The camera's clock on the computer's: drawn clocks whose truth is known, with answers that take their time."""

import math
import random

import pytest

from daq.runs.clock_map import clock_maps

SESSION = {"kind": "session"}


def told(before_ns, camera_ns, after_ns):
    return {"kind": "camera", "monotonic_ns": [before_ns, after_ns], "camera_ns": camera_ns}


class Drawn:
    """Two clocks, integers and fractions only: camera = start + (host - power_up) * (1 + ppm / 1e6)."""

    def __init__(self, seed):
        draw = random.Random(seed)
        self.power_up_ns, self.start_ns = draw.randrange(10**15), draw.randrange(10**14)
        self.ppm = draw.uniform(-100, 100)
        one_way = draw.random()  # of the time that question and answer take, the same all along
        self.entries, host_ns = [SESSION], self.power_up_ns + 10**9
        for _ in range(draw.randrange(2, 60)):
            width_ns = int(draw.lognormvariate(math.log(300_000), 1.0))
            self.entries.append(told(host_ns, self.camera(host_ns + int(one_way * width_ns)), host_ns + width_ns))
            host_ns += width_ns + draw.randrange(10**8, 10**10)
        self.last_ns = host_ns

    def camera(self, host_ns):
        since_ns = host_ns - self.power_up_ns
        return self.start_ns + since_ns + round(since_ns * self.ppm / 1e6)


def test_what_it_says_is_inside_its_sigma():
    beyond, drifts = 0, 0
    for seed in range(300):
        drawn = Drawn(seed)
        (found,) = clock_maps(drawn.entries)
        assert found.questions == len(drawn.entries) - 1
        middle_ns = (drawn.power_up_ns + drawn.last_ns) // 2
        off_ns = found.on_host_ns(drawn.camera(middle_ns)) - middle_ns
        since_ns = drawn.camera(middle_ns) - found.at_ns
        drifted_ns = since_ns * found.drift_sigma_ppm * 1e-6 if since_ns else 0.0
        beyond += abs(off_ns) > 2.0 * math.hypot(found.sigma_ns, drifted_ns)
        slower_ppm = 1e6 * (1 / (1 + drawn.ppm / 1e6) - 1)
        drifts += abs(found.drift_ppm - slower_ppm) > 2.0 * found.drift_sigma_ppm
    assert beyond <= 15  # of 300: 5 %
    assert drifts <= 15


def test_sigma_is_no_smaller_for_asking_more_often():
    apart_ns, width_ns = 10**9, 200_000
    few, many = (
        clock_maps([SESSION, *(told(k * apart_ns, k * apart_ns, k * apart_ns + width_ns) for k in range(n))])[0]
        for n in (2, 400)
    )
    assert few.sigma_ns == pytest.approx(many.sigma_ns) == pytest.approx(width_ns / math.sqrt(12))


def test_a_clock_that_was_started_anew_has_a_map_of_its_own():
    lines = [SESSION, told(0, 5_000, 100), told(10**9, 10**9 + 5_000, 10**9 + 100)]
    back = told(2 * 10**9, 700, 2 * 10**9 + 100)
    ahead = told(3 * 10**9, 9 * 10**9, 3 * 10**9 + 100)
    maps = clock_maps([*lines, back, ahead, SESSION, told(4 * 10**9, 10**10, 4 * 10**9 + 100)])
    assert [found.questions for found in maps] == [2, 1, 1, 1]
    assert maps[1].drift_sigma_ppm == math.inf
    assert maps[1].on_host_ns(700) == 2 * 10**9 + 50
    assert "drift unknown" in maps[1].sentence


def test_nobody_s_clock_is_no_map():
    assert clock_maps([SESSION, {"kind": "camera", "monotonic_ns": [1, 1], "celsius": 40.0}]) == []
    (still,) = clock_maps([SESSION, told(7, 9, 7), told(7, 9, 7)])  # asked twice in no time
    assert still.on_host_ns(9) == 7
