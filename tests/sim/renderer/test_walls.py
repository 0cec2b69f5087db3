"""The renderer's windows, tubes and domes against the tracer's, which shares nothing with them."""

import numpy as np
import pytest

from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.drawn_walls import aimed, drawn_walls
from tracer.strategies.trace import trace_from

LEVEL = 0.05


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_rays_through_walls_are_those_of_the_tracer(seed: int) -> None:
    rng, judged, other = np.random.default_rng(seed), 0, 0
    for _ in range(20):
        scene = drawn_walls(rng)
        tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
        ways = aimed(rng, scene, 50)
        traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
        for way, ray in zip(ways, traced, strict=True):
            x, y, light = to_plane(*start, *way, tables.world)
            if (light > 0.0) != (ray["status"] == 0):
                other += 1  # light that a sliver of glass within a hair of a surface lets through or not
                continue
            if light > 0.0 and abs(ray["direction"][2]) > LEVEL:
                np.testing.assert_allclose(
                    (x, y), (ray["x_mm"], ray["y_mm"]), rtol=0.0, atol=2e-6
                )  # grazing: a root of a quadratic
                assert light == pytest.approx(ray["transmittance"], abs=1e-6)
                judged += 1
    assert judged > 600
    assert other <= 2
