"""The renderer's walls, blocks and balls out of round against the tracer's, which shares nothing with them."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer import drawn_walls, test_balls, test_blocks
from tests.tracer.scenes import camera_at
from tracer.bodies import Box
from tracer.bodies.block import rectangle
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, trace_from

LEVEL = 0.05
Rays = NDArray[np.float64]


def towards(rng: np.random.Generator, scene: Scene, count: int) -> Rays:
    """Directions (count, 3) from the camera to places among the bodies."""
    places = np.stack((*rng.uniform(-40.0, 40.0, (2, count)), rng.uniform(0.0, 60.0, count)), axis=1)
    ways = places - np.array(scene.camera.position_mm)
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def compare(scene: Scene, ways: Rays, least_light: float, skips: bool) -> tuple[int, int, int]:
    """Number of rays that agree, that arrive in one of both only, and that are skipped: totally reflected ones."""
    tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
    traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
    judged = other = skipped = 0
    for way, ray in zip(ways, traced, strict=True):
        x, y, light = to_plane(*start, *way, tables.world)
        if skips and ray["status"] == RayStatus.TIR:
            skipped += 1
        elif (light > 0.0) != (ray["status"] == RayStatus.RECOVERED):
            other += 1
        elif min(light, ray["transmittance"]) > least_light and abs(ray["direction"][2]) > LEVEL:
            np.testing.assert_allclose((x, y), (ray["x_mm"], ray["y_mm"]), rtol=0.0, atol=2e-6)
            assert light == pytest.approx(ray["transmittance"], abs=1e-6)
            judged += 1
    return judged, other, skipped


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "aim", "rays", "least_light", "bounds", "seed"),
    [
        # within a hair of a surface or rim either may be right
        (drawn_walls.drawn_walls, drawn_walls.aimed, 50, 0.0, (600, 2), 1),
        pytest.param(drawn_walls.drawn_walls, drawn_walls.aimed, 50, 0.0, (600, 2), 2, marks=pytest.mark.slow),
        (test_balls.drawn, test_balls.aimed, 30, 0.3, (300, 2), 3),
        # the renderer follows mirror images in blocks further
        (test_blocks.drawn_scene, towards, 50, 0.0, (500, 0), 1),
        pytest.param(test_blocks.drawn_scene, towards, 50, 0.0, (500, 0), 2, marks=pytest.mark.slow),
    ],
)
def test_rays_are_those_of_the_tracer(
    draw: Callable[[np.random.Generator], Scene], aim: Callable[[np.random.Generator, Scene, int], Rays],
    rays: int, least_light: float, bounds: tuple[int, int], seed: int,
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    scenes = (draw(rng) for _ in range(20))
    found = [compare(scene, aim(rng, scene, rays), least_light, aim is towards) for scene in scenes]
    judged, other, skipped = np.sum(found, axis=0)
    assert judged > bounds[0]
    assert other <= bounds[1]
    assert skipped < 50


@pytest.mark.slow
def test_a_plate_that_lies_on_the_board_is_seen_through() -> None:
    plate = Box("plate", rectangle(40.0, 30.0), 3.0, test_blocks.GLASS, (0.0, 0.0, 1.5))
    scene = Scene(camera_at((100.0, 30.0, 300.0), (0.0, 0.0, 0.0), 500.0, (64, 48)), (plate,))
    start = np.array(scene.camera.position_mm)
    ways = np.stack((*np.random.default_rng(1).uniform(-10.0, 10.0, (2, 40)), np.zeros(40)), axis=1) - start
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways)
    assert set(traced.branches.values()) == {("plate front-back",)}
    assert compare(scene, ways, 0.0, skips=False) == (40, 0, 0)
