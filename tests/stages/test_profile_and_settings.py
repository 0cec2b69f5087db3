"""Legs, durations, and what an axis refuses to be."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stages.axis_settings import AxisSettings
from stages.profile import Approach, duration_s, legs
from tests.loops import loop_over

UP = Approach(side="from_below", distance_mm=0.5, speed_mm_s=1.0)
DOWN = Approach(side="from_above", distance_mm=0.5, speed_mm_s=1.0)


@given(st.floats(-100, 100), st.floats(-100, 100), st.sampled_from([UP, DOWN]))
def test_arrival_is_always_from_the_same_side_over_the_whole_distance(start_mm, target_mm, approach):
    way = legs(start_mm, target_mm, 20.0, approach)
    assert way[0].start_mm == start_mm
    assert way[-1].end_mm == target_mm
    assert all(a.end_mm == b.start_mm for a, b in pairwise(way))
    last_mm = way[-1].end_mm - way[-1].start_mm
    assert (last_mm if approach.upwards else -last_mm) >= 0.5 - 1e-9
    assert 1 <= len(way) <= 2


def test_a_long_move_in_the_right_direction_is_one_leg_and_a_short_one_two():
    assert [leg.end_mm for leg in legs(0.0, 10.0, 20.0, UP)] == [10.0]
    assert [leg.end_mm for leg in legs(0.0, 0.1, 20.0, UP)] == [-0.4, 0.1]
    assert [leg.end_mm for leg in legs(10.0, 0.0, 20.0, UP)] == [-0.5, 0.0]
    assert [leg.speed_mm_s for leg in legs(10.0, 0.0, 20.0, UP)] == [20.0, 1.0]
    assert len(legs(10.0, 0.0, 20.0, None)) == 1


@given(st.floats(0.001, 1000), st.floats(0.1, 100), st.floats(1, 1000))
def test_duration_is_that_of_the_integrated_trapezoid(distance_mm, speed, acceleration):
    total, pieces = duration_s(distance_mm, speed, acceleration), 400
    middles = [(index + 0.5) * total / pieces for index in range(pieces)]
    speeds = [min(speed, acceleration * now, acceleration * (total - now)) for now in middles]
    assert sum(speeds) * total / pieces == pytest.approx(distance_mm, rel=2e-3)


APPROACH = {"side": "from_below", "distance_mm": 0.5, "speed_mm_s": 1.0}


@loop_over(
    "change",
    [
        {"limits_mm": [0.0, 0.0]},
        {"limits_mm": [1.0, 0.0]},
        {"limits_mm": [0.0, math.inf]},
        {"limits_mm": [math.nan, 1.0]},
        {"speed_mm_s": 0.0},
        {"acceleration_mm_s2": -1.0},
        {"sign": 0},
        {"offset_mm": math.nan},
        {"settle_s": -0.1},
        {"in_position_um": 10.1},
        {"in_position_um": 0.0},
        {"steps_per_mm": 40.0},  # half a step is 12.5 um
        {"approach": {**APPROACH, "distance_mm": 200.0}},
        {"approach": {**APPROACH, "distance_mm": 0.0}},
        {"approach": {**APPROACH, "speed_mm_s": 11.0}},
    ],
)
def test_an_axis_that_makes_no_sense_is_refused(change):
    good = {"channel": 1, "limits_mm": [0.0, 100.0], "speed_mm_s": 10.0, "acceleration_mm_s2": 50.0,
            "approach": APPROACH}  # fmt: skip
    assert AxisSettings(**good).channel == "1"
    with pytest.raises(ValidationError):
        AxisSettings(**{**good, **change})
