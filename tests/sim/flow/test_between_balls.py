"""The flow between balls has no divergence and no slip, and a bench puts it around its own balls."""

import numpy as np
import pytest
import yaml

from sim.flow.between_balls import BetweenBalls
from sim.flow.fields import Flow
from sim.flow.particles import advect
from sim.flow.table import FlowTable
from tests.tracer.scenes import ball, camera_at
from tracer.errors import SceneError
from tracer.scene.scene import Scene

# Two balls that touch, one apart.
BALLS = ((0.0, 0.0, 0.0, 10.0), (12.0, 16.0, 0.0, 10.0), (-25.0, 4.0, 6.0, 8.0))
FLOW = BetweenBalls(through=0.6, balls_mm=BALLS)


def in_gas(count: int, seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).uniform(-40.0, 40.0, (count, 3))
    return points[FLOW.holds(points)]


def test_it_has_no_divergence():
    points, step = in_gas(4000, 1), 1e-4
    ends = [FLOW.mean(points + side * step * axis) for axis in np.eye(3) for side in (1.0, -1.0)]
    gradient = np.stack([(ends[2 * k] - ends[2 * k + 1]) / (2.0 * step) for k in range(3)], axis=1)
    divergence = np.trace(gradient, axis1=1, axis2=2)
    assert np.abs(divergence).max() < 1e-5 * np.abs(gradient).max()


def test_it_rests_on_the_surfaces_and_has_its_speed_far_from_them():
    way = np.random.default_rng(2).normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    for *centre, radius in BALLS:
        surface, beside = (FLOW.mean(np.array(centre) + (radius + gap) * way) for gap in (0.0, 0.5))
        assert np.abs(surface).max() < 1e-9
        assert 10.0 < np.linalg.norm(beside, axis=1).mean() < 300.0
    assert np.abs(FLOW.mean(np.array([[6.0, 8.0, 0.0]]))).max() < 1e-9  # where two touch
    far = np.random.default_rng(3).uniform(200.0, 900.0, (4000, 3))
    assert np.sqrt(np.square(FLOW.mean(far)).sum(axis=1).mean()) == pytest.approx(500.0, rel=0.1)


def test_no_particle_goes_into_a_ball():
    points = in_gas(4000, 4)
    carried = advect(Flow(FLOW), points, 0.0, 5e-3)  # 2 mm
    assert FLOW.holds(carried).all()
    assert np.linalg.norm(carried - points, axis=1).max() > 2.0


def test_without_a_share_through_the_plane_it_stays_in_it():
    flow = BetweenBalls(balls_mm=BALLS)
    assert np.abs(flow.mean(in_gas(500, 5))[:, 2]).max() < 1e-9


def test_a_bench_puts_it_around_the_balls_of_its_scene():
    scene = Scene(camera_at((0.0, 0.0, 500.0)), (ball("a", 3.0, 4.0, 20.0, 12.0),))
    table = FlowTable(field="between_balls", turbulence=None, parameters={"speed_mm_s": 300.0})
    assert table.flow(1, scene).base.balls_mm == ((3.0, 4.0, 20.0, 12.0),)
    written = FlowTable(**yaml.safe_load(table.as_text(1, scene)))
    points = np.random.default_rng(6).uniform(0.0, 40.0, (50, 3))
    np.testing.assert_array_equal(written.flow(1).mean(points), table.flow(1, scene).mean(points))
    with pytest.raises(SceneError, match="must be positive"):
        BetweenBalls(wall_mm=0.0)
