"""Pairs of frames of a flow: particles go where the flow takes them, light is the paper's, bits repeat."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, maximum_filter

from sim.demo.scenes import at_size, demo_scene
from sim.flow.fields import Flow, LaminarChannel, Shear, Uniform, Vortex
from sim.flow.images import FlowCamera, render_pairs
from sim.flow.jet import Jet
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet, Seeding, advect
from tests.sim.flow.test_view import flow_scene
from tracer.errors import SceneError

DT_S = 500e-6


def test_particles_that_turn_in_a_vortex_keep_their_distance_to_its_axis():
    flow, rng = Flow(Vortex(core_mm=10.0, fastest_mm_s=2000.0)), np.random.default_rng(0)
    start = rng.uniform(-30.0, 30.0, (500, 3))
    end = advect(flow, start, 0.0, DT_S)
    radius = np.hypot(start[:, 0], start[:, 1])
    np.testing.assert_allclose(np.hypot(end[:, 0], end[:, 1]), radius, atol=1e-5)
    angle = np.arctan2(end[:, 1], end[:, 0]) - np.arctan2(start[:, 1], start[:, 0])
    speed = np.linalg.norm(flow.mean(start), axis=1)
    np.testing.assert_allclose(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi, speed * DT_S / radius, atol=2e-5)
    np.testing.assert_allclose(advect(flow, end, DT_S, -DT_S), start, atol=2e-5)


def test_light_of_a_tilted_sheet_and_its_second_pulse():
    sheet = LightSheet(1.0, 0.2, slope_x=0.01, energies=(1.0, 0.8), apart_mm=0.1)
    at = np.array([[0.0, 0.0, 0.15], [50.0, 0.0, 0.65], [0.0, 0.0, 0.25], [0.0, 0.0, 0.65]])
    np.testing.assert_allclose(sheet.light(at, 0), np.exp(-8.0 * np.array([0.0, 0.0, 0.01, 0.25])), rtol=1e-3)
    assert sheet.light(at, 1)[2] == pytest.approx(0.8)


@pytest.mark.parametrize("flow", [Flow(Uniform((300.0, 500.0, 0.0))), Flow(Shear((0.0, 400.0, 0.0)))])
def test_correlation_finds_what_the_flow_did_beside_and_behind_the_glass(flow):
    scene = at_size(demo_scene("two_spheres_500"), 512).with_bodies([])
    camera = FlowCamera(scene, flow, reflections=None, seeding=Seeding(0.05))
    first, second = (frame.astype(float) - 35.0 for frame in camera.pair(0, 4 * DT_S, 0.0))
    px_per_mm = 1.0 / camera.px_mm
    for row in (64, 300):
        for column in (80, 256, 400):
            window = np.s_[row : row + 48, column : column + 48]
            a, b = first[window] - first[window].mean(), second[window] - second[window].mean()
            plane = np.fft.fftshift(np.fft.ifft2(np.conj(np.fft.fft2(a)) * np.fft.fft2(b)).real)
            r, c = np.unravel_index(np.argmax(plane), plane.shape)
            part = plane[r - 1 : r + 2, c - 1 : c + 2]
            ln = np.log(np.maximum(part, 1e-9 * part.max()))
            dv = r - 24 + 0.5 * (ln[0, 1] - ln[2, 1]) / (ln[0, 1] + ln[2, 1] - 2.0 * ln[1, 1])
            du = c - 24 + 0.5 * (ln[1, 0] - ln[1, 2]) / (ln[1, 0] + ln[1, 2] - 2.0 * ln[1, 1])
            x, y = (column + 23.5 - 255.5) * camera.px_mm, (255.5 - row - 23.5) * camera.px_mm
            u, v, _ = flow.mean(np.array([[x, y, 0.0]]))[0] * 4 * DT_S * px_per_mm
            assert (du, dv) == pytest.approx((u, -v), abs=0.15)


def test_motion_out_of_the_sheet_loses_the_pair():
    scene = at_size(demo_scene("two_spheres_500"), 256).with_bodies([])

    def likeness(w_mm_s):
        camera = FlowCamera(scene, Flow(Uniform((0.0, 0.0, w_mm_s))), reflections=None)
        first, second = (frame.astype(float) for frame in camera.pair(0, DT_S, 0.0))
        return np.corrcoef(first.ravel(), second.ravel())[0, 1]

    assert likeness(0.0) > 0.9
    # Gaussian sheets 0.5 mm apart share exp(-4 (0.5/1)^2) of their light.
    assert likeness(1000.0) / likeness(0.0) == pytest.approx(np.exp(-1.0), abs=0.06)
    assert likeness(6000.0) < 0.05


def test_walls_hold_no_particles():
    scene = at_size(demo_scene("two_spheres_500"), 256).with_bodies([])
    camera = FlowCamera(scene, Flow(LaminarChannel(half_width_mm=20.0)), reflections=None)
    first, _ = camera.pair(0, DT_S, 0.0)
    wall = 20.0 / camera.px_mm
    assert first[:, : int(127.5 - wall) - 3].max() < 50
    assert first[:, 128 - 20 : 128 + 20].max() > 80


def test_light_is_the_paper_s():
    """12 bit, floor 30 to 40 counts, at most 320, 0.03 particles a pixel; balls shine in every frame."""
    scene = flow_scene(size=672)
    camera = FlowCamera(scene, Flow(Jet(), RandomModes(8.0)))
    first, second = camera.pair(3, DT_S, 0.3)
    for frame in (first, second):
        assert frame.dtype == np.uint16
        assert 30 <= np.percentile(frame, 5) < np.median(frame) <= 42
        assert 100 < np.percentile(frame, 99.99) < 320
    beside = first[:200, :200].astype(float) - 37.0
    smooth = gaussian_filter(beside, 0.7)
    peaks = (smooth == maximum_filter(smooth, 3)) & (smooth > 10.0)
    assert 0.012 < peaks.mean() < 0.045
    still, other = camera.pair(7, DT_S, 0.7, is_seeded=False)
    assert still.max() > 45  # the ring and the glint
    assert not np.array_equal(still, other)
    assert camera.dark(0).max() < 60


def test_a_pair_is_a_function_of_its_number(monkeypatch):
    monkeypatch.setenv("RTPIV_THREADS", "3")
    scene = flow_scene(size=200)
    flow = Flow(Jet(), RandomModes(8.0))
    pairs = list(render_pairs(scene, flow, dt_s=DT_S, count=3))
    monkeypatch.setenv("RTPIV_THREADS", "1")
    (again,) = render_pairs(scene, flow, dt_s=DT_S, count=1, first=2)
    for frame, same, other in zip(again, pairs[2], pairs[1], strict=True):
        np.testing.assert_array_equal(frame, same)
        assert not np.array_equal(frame, other)
    camera = FlowCamera(scene, flow, seed=1)
    (seeded,) = render_pairs(scene, flow, dt_s=DT_S, count=1, first=2, camera=camera)
    assert not np.array_equal(seeded[0], again[0])


def test_what_cannot_be_is_refused():
    with pytest.raises(SceneError, match="thickness_mm"):
        LightSheet(0.0)
    with pytest.raises(SceneError, match="per_px"):
        Seeding(-1.0)
    with pytest.raises(SceneError, match="particle_counts"):
        replace(FlowCamera(flow_scene(size=50), Flow(Uniform())), particle_counts=-1.0)
