"""The simulated axis against closed formulas and against small time steps, written down separately."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.emulators.faults import Fault, FaultSchedule
from sim.mechanics.clock import ScaledClock, VirtualClock
from sim.mechanics.motion import Mechanics, Motor

FREE = Mechanics(
    lead_mm=4.0, steps_per_rev=1600, power_up_mm=50.0, low_switch_mm=-1e6, high_switch_mm=1e6, index_mm=1e6
)


class Heard:
    def __init__(self, motor):
        self.motor, self.edges, self.rests = motor, [], []
        motor.listener = self

    def on_edge(self, name, upwards):
        self.edges.append((name, upwards, self.motor.time_s, self.motor.carriage_mm))

    def on_rest(self):
        self.rests.append(self.motor.time_s)


@pytest.mark.parametrize(("distance", "speed", "ramp"), [(4000, 1000, 2000), (300, 1000, 2000), (-5000, 800, 400)])
def test_a_move_takes_as_long_as_the_trapezoid(distance, speed, ramp):
    motor = Motor(FREE)
    heard = Heard(motor)
    motor.go(distance, speed, ramp)
    way = abs(distance)
    expected_s = way / speed + speed / ramp if way > speed**2 / ramp else 2 * math.sqrt(way / ramp)
    motor.advance(1e3)
    assert heard.rests == [pytest.approx(expected_s)]
    assert motor.steps == distance
    assert motor.carriage_mm == pytest.approx(50.0 + distance / 400.0)


@given(st.lists(st.tuples(st.integers(-3000, 3000), st.floats(0.01, 3.0)), min_size=1, max_size=6))
def test_whatever_is_commanded_on_the_way_speed_and_ramp_are_kept(moves):
    """Retargeting in motion: compare successive positions with what speed and acceleration allow."""
    motor, time_s, places = Motor(FREE), 0.0, []
    for target, duration_s in moves:
        motor.go(target, 1000.0, 4000.0)
        for _ in range(20):
            time_s += duration_s / 20
            motor.advance(time_s)
            places.append((time_s, motor._pulses, motor._speed))
    motor.advance(1e4)
    assert motor.steps == moves[-1][0]
    for (t0, p0, v0), (t1, p1, v1) in pairwise(places):
        assert abs(v1) <= 1000.0 + 1e-6
        assert abs(v1 - v0) <= 4000.0 * (t1 - t0) + 1e-6 or p1 == float(round(p1))
        assert abs(p1 - p0) <= 1000.0 * (t1 - t0) + 1.0


def test_steps_are_whole_and_the_carriage_stands_on_them():
    motor = Motor(FREE)
    motor.go(1000, 100, 1000)
    for index in range(1, 200):
        motor.advance(index * 0.01)
        nearest = round((motor.carriage_mm - 50.0) * 400.0)
        assert motor.carriage_mm == pytest.approx(50.0 + nearest / 400.0, abs=1e-12)


def test_play_swallows_the_first_part_of_every_turn_round():
    motor = Motor(Mechanics(**{**{n: getattr(FREE, n) for n in FREE.__slots__}, "backlash_um": 50.0}))
    places = []
    for target in (400, 380, 400, 0, 400):
        motor.go(target, 1000, 5000)
        motor.advance(motor.time_s + 100)
        places.append(motor.carriage_mm)
    # 400 steps are 1 mm; the carriage hangs 25 um behind on the side it was pushed from
    assert places == pytest.approx([50.975, 50.975, 50.975, 50.025, 50.975])
    motor.go(380, 1000, 5000)  # 50 um back: exactly the play
    motor.advance(motor.time_s + 10)
    assert motor.carriage_mm == pytest.approx(50.975)
    motor.go(360, 1000, 5000)  # 50 um more: all of it arrives
    motor.advance(motor.time_s + 10)
    assert motor.carriage_mm == pytest.approx(50.925)


def test_lead_errors_are_where_the_workshop_put_them():
    screw = Mechanics(
        **{**{n: getattr(FREE, n) for n in FREE.__slots__}, "lead_error_um": 5.0, "scale_error_ppm": 100.0}
    )
    motor, begin_mm = Motor(screw), Motor(screw).carriage_mm
    motor.go(400, 1e4, 1e5)
    motor.advance(10)
    quarter = 5e-3 * (math.sin(math.tau * (12.5 + 0.25)) - math.sin(math.tau * 12.5))
    assert motor.carriage_mm - begin_mm == pytest.approx(1.0001 + quarter, abs=1e-9)
    motor.go(1600, 1e4, 1e5)
    motor.advance(20)
    assert motor.carriage_mm - begin_mm == pytest.approx(4.0004, abs=1e-9)


def test_switches_are_found_at_their_place_however_seldom_one_looks():
    for looks in (1, 1000):
        motor = Motor(Mechanics(steps_per_rev=1600, power_up_mm=50.0, high_switch_mm=60.0, index_mm=55.0))
        heard = Heard(motor)
        motor.go(4400, 1000, 10_000)  # to 61 mm
        for index in range(looks):
            motor.advance(10.0 * (index + 1) / looks)
        assert [(name, up) for name, up, _, _ in heard.edges] == [("index", True), ("high", True)]
        assert heard.edges[0][3] == pytest.approx(55.0, abs=0.003)
        assert heard.edges[1][2] - heard.edges[0][2] == pytest.approx(2.0, abs=1e-3)  # 5 mm at 2.5 mm/s
        assert motor.is_closed("high")
        assert not motor.is_closed("low")


def test_a_held_carriage_loses_pulses_and_only_the_encoder_knows():
    motor = Motor(FREE)
    heard, motor.obstacle_mm = Heard(motor), 60.0
    motor.go(6000, 2000, 10_000)
    motor.advance(100)
    assert [name for name, *_ in heard.edges] == ["blocked"]
    assert motor.carriage_mm == 60.0
    assert motor.steps == 6000
    assert motor.encoder_steps == 4000
    motor.go(5600, 2000, 10_000)
    motor.advance(200)
    assert motor.carriage_mm == pytest.approx(59.0)


def test_halt_and_brake():
    motor = Motor(FREE)
    motor.go(math.inf, 1000, 1000)
    motor.advance(5.0)
    motor.halt()
    assert not motor.running
    halted = motor.steps
    motor.advance(10.0)
    assert motor.steps == halted == 4500
    motor.go(math.inf, 1000, 1000)
    motor.advance(15.0)
    motor.brake(500)
    motor.advance(30.0)
    assert motor.steps - halted == pytest.approx(4500 + 1000, abs=1)


def test_clocks():
    virtual = VirtualClock()
    virtual.sleep_s(2.0)
    virtual.advance_to(1.0)
    assert virtual.now_s() == 2.0
    fast = ScaledClock(100.0)
    fast.sleep_s(1.0)
    assert 1.0 <= fast.now_s() < 60.0


def test_faults_do_what_they_are_called_and_keep_the_order():
    kinds = ("late", "lost", "cut", "doubled", "garbled", "split")
    faults = FaultSchedule(
        [Fault(kind, index, delay_s=1.0 if kind in ("late", "split") else 0.0) for index, kind in enumerate(kinds)]
    )
    passed = [faults.pass_on(0.1 * index, b"abcdef") for index in range(7)]
    assert passed[0] == [(1.0, b"abcdef")]
    assert [pieces[0][0] for pieces in passed] == [1.0] * 6 + [2.0]  # nothing overtakes
    assert [pieces[0][1] for pieces in passed[1:4]] == [b"", b"abc", b"abcdefabcdef"]
    assert sum(a != b for a, b in zip(passed[4][0][1], b"abcdef", strict=True)) == 1
    assert passed[5] == [(1.0, b"abc"), (2.0, b"def")]
    assert passed[6] == [(2.0, b"abcdef")]
    assert [fault.kind for fault in faults.met] == list(kinds)
    assert FaultSchedule([Fault("unplug", time_s=3.0)]).dead(3.0)
    assert not FaultSchedule([Fault("unplug", time_s=3.0)]).dead(2.9)
