"""A sheet of light between balls: the simulator's rays end as the tracer's do, its frames are measured."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.ndimage import binary_erosion

from correction.fitted.prepared import prepare
from correction.node_status import NodeStatus
from piv.correlation.pair import evaluate_pair
from sim.flow.between_balls import BetweenBalls
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.particles import LightSheet, ParticlePair, Seeding, advect
from sim.flow.table import FlowTable
from sim.flow.view import ParticleView
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.scenes import ball, camera_at
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet as PlaneOfLight
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, trace

CAMERA = camera_at((0.0, 0.0, 500.0), focal_px=2200.0, sensor_px=(320, 320))
# The board hangs at z = 0 behind balls of different size; the sheet is at z = 22, and runs through three of
# them.
CUT = (ball("a", -19.0, 0.0, 22.0, 16.0), ball("b", 14.0, 14.0, 20.0, 18.0), ball("c", 14.0, -16.0, 26.0, 12.0))
BED = (*CUT, ball("before", 0.0, 0.0, 50.0, 14.0))
LIT = Scene(CAMERA, BED, sheet=PlaneOfLight(22.0, thickness_mm=1.0))


def test_rays_end_in_the_gas_or_in_the_glass_as_the_tracer_says():
    """The tilted camera, hollow and opaque balls on both sides of the plane, one behind it."""
    balls = [
        ball("hollow", -19.0, 0.0, 2.0, 16.0, 1.5, (9.0, 1.0)),
        ball("steel", 14.0, 14.0, -3.0, 18.0, None),
        ball("drop", 14.0, -16.0, 6.0, 12.0, 1.33),
        ball("high", 0.0, 2.0, 31.0, 13.0),
        ball("behind", -10.0, -40.0, -30.0, 20.0),
    ]
    scene = Scene(camera_at((90.0, -50.0, 400.0), focal_px=2000.0, sensor_px=(320, 320)), tuple(balls))
    world = tables_of(scene, Pose(), None, is_light=True).world
    pixels = np.random.default_rng(1).uniform(0.0, 319.0, (4000, 2))
    traced = trace(scene, pixels)
    ours = np.array([to_plane(*camera_ray(u, v, 0.0, 0.0, world.camera), world) for u, v in pixels])
    good = traced.recovered
    assert np.array_equal(ours[:, 2] > 0.0, good)
    statuses = set(traced.rays["status"].tolist())
    assert statuses >= {RayStatus.RECOVERED, RayStatus.IN_GLASS, RayStatus.BLOCKED}
    assert (good & (traced.rays["events"] > 0)).sum() > 50
    near = good & (np.abs(ours[:, :2]).max(axis=1) < 100.0)
    assert ours[near, :2] == pytest.approx(traced.plane_mm[near], abs=1e-7)


def test_points_between_the_balls_are_looked_up_where_they_are_drawn():
    """Of the sheet at z = 22, which the scene file gives from the board behind: 0.01 px, and none in glass."""
    found = prepare(LIT.in_light_sheet()).corrector.map
    view = ParticleView(replace(LIT, sheet=None), (21.0, 23.0), plane_mm=22.0, step_px=1.0)
    rng, worst, compared = np.random.default_rng(2), 0.0, 0
    inside = binary_erosion(
        found.recovered, iterations=2
    )  # cells of rays at the border of glass are not cut finer
    rows, columns = np.nonzero(inside)
    for k in rng.choice(len(rows), 150, replace=False).tolist():
        row, column = int(rows[k]), int(columns[k])
        x, y = found.grid.nodes_mm()[row, column]
        drawn = view.images(np.array([[x, y, 22.0]]), np.ones(1))[:, :2]
        assert len(drawn), (x, y)
        worst = max(worst, float(np.hypot(*(drawn - found.pixel[0, row, column]).T).min()))
        compared += found.branch[0, row, column] != 0
    assert worst < 0.01
    assert compared >= 3  # through glass


def test_a_particle_above_the_glass_that_its_ray_enters_is_seen():
    """Over a cap of 5.5 mm in the plane of the sheet, as bright as without the ball."""
    point = np.array([[5.0, 0.0, 22.5]])
    over = ParticlePair((point, point), (np.ones(1), np.ones(1)))
    counts = []
    for balls in ((), (ball("cap", 0.0, 0.0, 10.0, 13.2),)):
        camera = FlowCamera(Scene(CAMERA, balls), Flow(Uniform()), LightSheet(offset_mm=22.0), reflections=None)
        counts.append(float(camera._particle_light(over, 0).sum()))
    assert counts[1] == pytest.approx(counts[0], rel=0.01)


def test_a_flow_between_balls_is_measured_and_glass_is_masked():
    flow = Flow(Uniform((900.0, -500.0, 0.0)))
    camera = FlowCamera(
        replace(LIT, sheet=None),
        flow,
        LightSheet(thickness_mm=1.0, offset_mm=22.0),
        Seeding(per_px=0.04),
        reflections=None,
        seed=3,
    )
    corrector = prepare(LIT.in_light_sheet()).corrector
    glass = corrector.status == NodeStatus.IN_GLASS
    discs = sum(np.pi * (one.radius_mm**2 - (one.centre_mm[2] - 22.0) ** 2) for one in CUT)
    assert glass.sum() * corrector.map.grid.pitch_mm**2 == pytest.approx(discs, rel=0.01)
    particles = camera.particles(0, 1e-3, 0.0)
    for light, places in zip(particles.light, particles.places_mm, strict=True):
        depth = [one.distance_mm(places) for one in BED]
        assert (light[np.min(depth, axis=0) < 0.0] == 0.0).all()
        assert (light > 0.0).sum() > 500
    first, second = (corrector(frame).astype(np.float64) for frame in camera.pair(0, 1e-3, 0.0))
    measured = evaluate_pair(first, second, corrector.map.recovered, threads=1)
    off = (
        np.stack((measured.u_px, measured.v_px))
        - np.array([0.9, 0.5])[:, None, None] / corrector.map.grid.pitch_mm
    )
    clear = (measured.flags == 0) & np.isfinite(off).all(axis=0)
    assert clear.sum() > 60
    assert np.median(np.hypot(*off[:, clear])) < 0.08


# The flow between balls has no divergence and no slip, and a bench puts it around its own balls.


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
