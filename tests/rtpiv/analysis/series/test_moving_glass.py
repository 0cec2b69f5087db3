"""Pairs get the scene of their time where places change by the limit; balls that touch stay apart."""

import numpy as np
import pytest

from benchmarks.views import scene_at
from rtpiv.analysis.series.moving_glass import FOLLOW_LIMIT_PX, move_balls, steps_to_apply

PX_PER_MM = np.array([4.0, 4.0, 1.0])


def test_a_run_at_rest_has_one_map_and_a_drift_one_a_limit():
    path = np.linspace(0.0, 0.05, 101)[:, None] * np.array([1.0, 0.0, 0.0])
    assert not steps_to_apply(0.05 * path, PX_PER_MM).any()
    found = steps_to_apply(path, PX_PER_MM)
    assert (np.abs((path - found) * PX_PER_MM) <= FOLLOW_LIMIT_PX).all()
    assert len(np.unique(found, axis=0)) == 10  # 0.2 px in steps just beyond 0.02
    knock = np.where(np.arange(20)[:, None] < 12, 0.0, np.array([0.02, 0.0, 0.0]))
    np.testing.assert_array_equal(steps_to_apply(knock, PX_PER_MM), knock)


def test_a_ball_that_touches_another_is_moved_beside_it():
    scene = scene_at("two", 0.0, 64)  # one behind the other, in contact
    near, far = scene.bodies
    moved = move_balls(scene, [near.name], np.array([0.02, 0.0, 0.004])).bodies
    assert moved[1] == far
    assert moved[0].centre_mm == pytest.approx((0.02, 0.0, near.centre_mm[2]), abs=1e-4)
    free = move_balls(scene, [near.name], np.array([0.02, 0.0, -0.004])).bodies[0]
    assert free.centre_mm == pytest.approx((0.02, 0.0, near.centre_mm[2] - 0.004), abs=1e-9)
