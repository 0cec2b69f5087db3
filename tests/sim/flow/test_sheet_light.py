"""Particles lit by a sheet that bodies bend: against the even sheet, by hand, and against the traced light."""

from dataclasses import replace

import numpy as np
import pytest

from correction.fitted.prepared import prepare
from correction.node_status import NodeStatus
from sim.flow.fields import Flow, Uniform
from sim.flow.images import FlowCamera
from sim.flow.particles import LightSheet, Seeding
from sim.flow.sheet_light import trace_sheet
from tests.sim.flow.test_inside_a_bed import CUT, LIT
from tests.tracer.scenes import ball, camera_at
from tracer.light_sheet import LightSheet as PlaneOfLight
from tracer.light_sheet import SheetSource
from tracer.scene.scene import Scene
from tracer.strategies.light_map import trace_light

LEFT = SheetSource(180.0, 90.0)
AREA = np.array([(-20.0, -20.0), (20.0, 20.0)])
SHEET = LightSheet(1.2, 3.0, 0.05, -0.08, (1.0, 0.7), 0.3)


def points(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform((-18.0, -18.0, 0.0), (18.0, 18.0, 6.0), (4000, 3))


@pytest.mark.parametrize("pulse", [0, 1])
def test_without_bodies_it_is_the_even_sheet(pulse):
    found = trace_sheet(Scene(camera_at(), ()), SHEET, [LEFT], AREA)
    off = found.light(points(1), pulse) - SHEET.light(points(1), pulse)
    assert np.abs(off).max() < 0.02
    assert abs(off.mean()) < 1e-3


def test_a_gaussian_fan_spreads_as_it_goes():
    source = SheetSource(180.0, 20.0, gaussian=True, fan_deg=20.0, power=2.0)
    found = trace_sheet(Scene(camera_at(), ()), LightSheet(1.0), [source], AREA)
    x, y = points(2)[:, :2].T
    apex = 10.0 / np.tan(np.deg2rad(10.0))
    wide = 1.0 + x / apex
    expected = 2.0 * np.exp(-8.0 * (y / wide / 20.0) ** 2) / wide * np.sqrt(1.0 + (y / (apex + x)) ** 2)
    light = found.light(np.column_stack((x, y, 0.0 * x)), 0)
    assert np.abs(light - expected).max() < 0.03
    assert light.sum() == pytest.approx(expected.sum(), rel=1e-3)


@pytest.mark.slow
def test_an_opaque_ball_leaves_a_shadow_of_its_width():
    body = ball("steel", -8.0, 2.0, 3.0, 5.0, None)
    found = trace_sheet(Scene(camera_at(), (body,)), LightSheet(0.4, 3.0), [LEFT], AREA)
    y = np.linspace(-6.0, 10.0, 400)
    light = found.light(np.column_stack((np.full(400, 10.0), y, np.full(400, 3.0))), 0)
    assert light[np.abs(y - 2.0) < 4.7].max() < 1e-9
    assert light[np.abs(y - 2.0) > 5.2].min() > 0.9
    assert found.light(np.array([(-13.03, 2.0, 3.0)]), 0) == pytest.approx(1.0, abs=0.1)  # before its glass


def test_brightness_and_height_are_those_of_the_traced_light():
    """The tracer follows tubes of light: 10 % and 0.05 mm where a quarter of the light or more is, for 95 %."""
    sheet = PlaneOfLight(22.0, thickness_mm=1.0, sources=(LEFT,))
    x, y = np.meshgrid(np.arange(-20.0, 20.1, 1.0), np.arange(20.0, -20.1, -1.0))
    traced = trace_light(replace(LIT, sheet=sheet).in_light_sheet(), sheet, (-20.0, 20.0), 0.25, (161, 161))
    found = trace_sheet(LIT, LightSheet(1.0, 22.0), [LEFT], AREA)
    z = np.linspace(20.0, 24.0, 81)
    places = np.stack(np.broadcast_arrays(x[..., None], y[..., None], z), axis=-1)
    light = found.light(places.reshape(-1, 3), 0).reshape(*x.shape, 81)
    sums = light.sum(axis=-1)
    brightness, height = sums * 0.05 / np.sqrt(np.pi / 8.0), (light @ (z - 22.0)) / np.maximum(sums, 1e-9)
    clear = (traced.brightness[::4, ::4] > 0.25) & (
        np.min([b.distance_mm(places[:, :, 40]) for b in CUT], 0) > 1.0
    )
    assert clear.sum() > 200
    relative = np.abs(brightness[clear] / traced.brightness[::4, ::4][clear] - 1.0)
    high = np.abs(height - traced.height_mm[::4, ::4])[clear]
    print(clear.sum(), np.quantile(relative, [0.5, 0.95]), np.quantile(high, [0.5, 0.95]))
    assert np.quantile(relative, 0.95) < 0.10
    assert np.quantile(high, 0.95) < 0.05


@pytest.mark.slow
def test_frames_are_dark_where_the_light_does_not_come():
    scene = replace(LIT, sheet=PlaneOfLight(22.0, thickness_mm=1.0, sources=(LEFT,)))
    camera = FlowCamera(
        scene,
        Flow(Uniform((900.0, -500.0, 0.0))),
        LightSheet(1.0, 22.0),
        Seeding(per_px=0.04),
        reflections=None,
        seed=3,
    )
    status = prepare(scene.in_light_sheet()).corrector.status
    everything = prepare(LIT.in_light_sheet()).corrector
    frames = [everything(frame) for frame in camera.pair(0, 1e-3, 0.0)]
    for frame in frames:
        dark, lit, bright = (
            frame[status == one] for one in (NodeStatus.DARK, NodeStatus.RECOVERED, NodeStatus.OVERLIT)
        )
        assert min(len(dark), len(lit), 30 * len(bright)) > 9000
        assert dark.mean() < 35.5  # 35 counts without light
        assert lit.mean() > 39.0
        assert bright.mean() > 45.0
        assert dark.std() < 0.25 * lit.std()
