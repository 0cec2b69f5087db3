"""A sheet of light between balls: the simulator's rays end as the tracer's do, its frames are measured."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from correction.fitted.prepared import prepare
from correction.node_status import NodeStatus
from piv.correlation.pair import evaluate_pair
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.particles import LightSheet, Seeding
from sim.flow.view import ParticleView
from sim.renderer.kernels.rays import camera_ray, to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.scenes import ball, camera_at
from tracer.light_sheet import LightSheet as PlaneOfLight
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, trace

CAMERA = camera_at((0.0, 0.0, 500.0), focal_px=2200.0, sensor_px=(320, 320))
# The board hangs at z = 0 behind balls of different size; the sheet is at z = 22, and runs through three of them.
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
