"""Very many random rays through windows, tubes, domes and liquids, against the renderer's optics.

They share no formula: the renderer takes the nearest root of every surface a hair ahead and asks what is beyond.
It runs in float64 as well and its hair has a length, so that a few rays in a hundred thousand differ; each of them
is given to a judge of 50 digits, who must find for the tracer.
"""

import numpy as np
import pytest

from ground.jit import kernel
from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.drawn_walls import aimed, drawn_walls
from tests.tracer.walls_reference import Walls, follow_walls, vector
from tracer.scene.scene import Scene
from tracer.strategies.trace import trace_from

LEVEL, CALM_MM, CALM_LIGHT = 0.05, 2e-6, 1e-6
RAYS = 25_000  # of a scene


@kernel
def through_walls(start, ways, world, out):  # type: ignore[no-untyped-def]
    """Plane point and light of each ray (N, 3), as the renderer has them."""
    for i in range(ways.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = to_plane(
            start[0], start[1], start[2], ways[i, 0], ways[i, 1], ways[i, 2], world
        )


def right(scene: Scene, start: np.ndarray, way: np.ndarray, ray: np.void) -> bool:
    """Whether the tracer's ray is that of 50 digits."""
    end = follow_walls(Walls(scene), vector(tuple(start.tolist())), vector(tuple(way.tolist())))
    if (end.status == "recovered") != (ray["status"] == 0):
        return False
    if end.status != "recovered":
        return True
    bound = (1.0 if abs(end.direction[2]) > LEVEL else 1e4) * (1e-9 if end.steepest < 0.99 else 1e-5)
    apart = max(abs(float(end.point[0]) - ray["x_mm"]), abs(float(end.point[1]) - ray["y_mm"]))
    return apart < bound and abs(float(end.passed) - ray["transmittance"]) < CALM_LIGHT


def compare(scenes: int, seed: int) -> tuple[int, int, int]:
    """Rays compared, judged by 50 digits, and found wrong."""
    rng, judged, wrong = np.random.default_rng(seed), 0, 0
    for _ in range(scenes):
        scene = drawn_walls(rng)
        tables, start = tables_of(scene, Pose(), None), np.array(scene.camera.position_mm)
        ways = np.ascontiguousarray(aimed(rng, scene, RAYS))
        rays = trace_from(scene, np.broadcast_to(start, ways.shape), ways).rays
        other = np.empty((RAYS, 3))
        through_walls(start, ways, tables.world, other)
        arrived, lands = other[:, 2] > 0.0, rays["status"] == 0
        apart = np.hypot(other[:, 0] - rays["x_mm"], other[:, 1] - rays["y_mm"])
        calm = np.abs(rays["direction"][:, 2]) > LEVEL
        same = (apart < CALM_MM) & (np.abs(other[:, 2] - rays["transmittance"]) < CALM_LIGHT)
        differ = (arrived != lands) | (arrived & lands & calm & ~same)
        for number in np.flatnonzero(differ):
            judged += 1
            wrong += not right(scene, start, ways[number], rays[number])
    return scenes * RAYS, judged, wrong


@pytest.mark.slow
def test_ten_million_rays() -> None:
    compared, judged, wrong = compare(400, 7)
    print(f"{compared} rays: {judged} differed and were judged by 50 digits, {wrong} of them wrong")
    assert compared >= 10_000_000
    assert wrong == 0
    assert judged < 1e-4 * compared
