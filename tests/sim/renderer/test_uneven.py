"""The renderer's balls out of round against the tracer's, which shares nothing with them."""

import numpy as np
import pytest

from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.test_balls import aimed, drawn
from tracer.strategies.trace import trace_from


def test_rays_through_balls_are_those_of_the_tracer() -> None:
    rng, judged, other = np.random.default_rng(3), 0, 0
    for _ in range(20):
        scene = drawn(rng)
        tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
        ways = aimed(rng, scene, 30)
        traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
        for way, ray in zip(ways, traced, strict=True):
            x, y, light = to_plane(*start, *way, tables.world)
            if (light > 0.0) != (ray["status"] == 0):
                other += 1  # within a hair of a rim
            elif min(light, ray["transmittance"]) > 0.3 and abs(ray["direction"][2]) > 0.05:
                np.testing.assert_allclose((x, y), (ray["x_mm"], ray["y_mm"]), rtol=0.0, atol=2e-6)
                assert light == pytest.approx(ray["transmittance"], abs=1e-6)
                judged += 1
    assert judged > 300
    assert other <= 2
