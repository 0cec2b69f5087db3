"""The renderer's boxes, plates, prisms and cuvettes against the tracer's, which shares nothing with them."""

import numpy as np
import pytest

from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.scenes import camera_at
from tests.tracer.test_blocks import GLASS, drawn_scene
from tracer.bodies import Box
from tracer.bodies.block import rectangle
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, trace_from


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_rays_through_blocks_are_those_of_the_tracer(seed: int) -> None:
    rng, judged, other = np.random.default_rng(seed), 0, 0
    for _ in range(20):
        scene = drawn_scene(rng)
        tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
        ways = np.stack((*rng.uniform(-40.0, 40.0, (2, 50)), rng.uniform(0.0, 60.0, 50)), axis=1) - start
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
        for way, ray in zip(ways, traced, strict=True):
            x, y, light = to_plane(*start, *way, tables.world)
            if ray["status"] == RayStatus.TIR:  # the renderer follows mirror images further
                other += 1
                continue
            assert (light > 0.0) == (ray["status"] == RayStatus.RECOVERED), (scene, way, ray["status"])
            if light > 0.0 and abs(ray["direction"][2]) > 0.05:
                np.testing.assert_allclose((x, y), (ray["x_mm"], ray["y_mm"]), rtol=0.0, atol=2e-6)
                assert light == pytest.approx(ray["transmittance"], abs=1e-6)
                judged += 1
    assert judged > 500
    assert other < 50


def test_a_plate_that_lies_on_the_board_is_seen_through() -> None:
    plate = Box("plate", rectangle(40.0, 30.0), 3.0, GLASS, (0.0, 0.0, 1.5))
    scene = Scene(camera_at((100.0, 30.0, 300.0), (0.0, 0.0, 0.0), 500.0, (64, 48)), (plate,))
    tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
    ways = np.stack((*np.random.default_rng(1).uniform(-10.0, 10.0, (2, 40)), np.zeros(40)), axis=1) - start
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways)
    assert set(traced.branches.values()) == {("plate front-back",)}
    for way, ray in zip(ways, traced.rays, strict=True):
        x, y, light = to_plane(*start, *way, tables.world)
        np.testing.assert_allclose((x, y), (ray["x_mm"], ray["y_mm"]), rtol=0.0, atol=1e-6)
        assert light == pytest.approx(ray["transmittance"], abs=1e-6)
