"""Which nodes are seen past all glass: shadows taken whole against every single line of sight."""

from dataclasses import replace

import numpy as np
import pytest

from correction.grid import PlaneGrid
from correction.inversion.invert import Inversion
from correction.node_status import NodeStatus
from tests.tracer.scenes import camera_at
from tracer.bodies import Sphere
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.strategy import choose

GLASS = ConstantMedium(1.5)
GRID = PlaneGrid((-40.0, 38.0), 0.41, (187, 203))


def bed(seed: int, count: int) -> list[Sphere]:
    """Balls of 0.5 to 12 mm between plane and camera, none in another; a few beside the camera or above it."""
    rng = np.random.default_rng(seed)
    placed: list[Sphere] = []
    for _ in range(400):
        radius = float(np.exp(rng.uniform(np.log(0.5), np.log(12.0))))
        low, high = (60.0, 320.0) if len(placed) % 7 == 6 else (radius, 150.0)
        reach = 15.0 if len(placed) < 3 else 60.0
        centre = rng.uniform((-reach, -reach, low), (reach, reach, high))
        away = [np.linalg.norm(np.subtract(centre, other.centre_mm)) - other.radius_mm for other in placed]
        if np.linalg.norm(centre - EYE) > 1.01 * radius and all(gap > 1.01 * radius for gap in away):
            placed.append(Sphere(f"b{len(placed)}", tuple(centre.tolist()), radius, GLASS))
        if len(placed) == count:
            break
    return placed


EYE = np.array([11.0, -6.0, 200.0])


def meets(ball: Sphere, nodes_mm: np.ndarray) -> np.ndarray:
    """Whether the line of sight of each node meets a ball: distance of its centre from the ray (h, w)."""
    way = np.concatenate((nodes_mm, np.zeros((*nodes_mm.shape[:2], 1))), axis=-1) - EYE
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    to_ball = np.array(ball.centre_mm) - EYE
    along = way @ to_ball
    aside = np.linalg.norm(to_ball - along[..., None] * way, axis=-1)
    return np.asarray((along > 0.0) & (aside < ball.radius_mm))


def direct_status(scene: Scene) -> np.ndarray:
    """Status of the nodes after the direct view, before any glass is asked."""
    inversion = Inversion(choose(scene), build_ray_map(scene), GRID, 1, (0.5, 16.0), None, skip=True)
    inversion.direct()
    return inversion.status


@pytest.mark.parametrize("count", [1, 3, 40])
@pytest.mark.parametrize("seed", [1, 2])
def test_every_line_of_sight_is_judged_as_if_it_were_alone(seed: int, count: int) -> None:
    scene = Scene(camera_at(tuple(EYE.tolist()), (0.0, 0.0, 0.0), 150.0, (160, 150)), tuple(bed(seed, count)))
    hidden = np.any([meets(ball, GRID.nodes_mm()) for ball in scene.spheres], axis=0)
    status = direct_status(scene)
    on_sensor = status != NodeStatus.OUT_OF_FRAME
    assert hidden[on_sensor].any()
    np.testing.assert_array_equal(hidden[on_sensor], status[on_sensor] == NodeStatus.RIM)


@pytest.mark.parametrize("seed", [3, 4])
def test_opaque_balls_in_a_bed_are_not_glass(seed: int) -> None:
    balls = [replace(ball, medium=None) if k % 3 == 0 else ball for k, ball in enumerate(bed(seed, 40))]
    scene = Scene(camera_at(tuple(EYE.tolist()), (0.0, 0.0, 0.0), 150.0, (160, 150)), tuple(balls))
    nodes = GRID.nodes_mm()
    nearest, first = np.full(GRID.shape, np.inf), np.full(GRID.shape, -1)
    for k, ball in enumerate(balls):
        far = np.linalg.norm(
            np.subtract(ball.centre_mm, EYE)
        )  # disjoint balls: the nearer tangent length is first
        tangent = np.sqrt(far**2 - ball.radius_mm**2)
        met = meets(ball, nodes)
        nearer = met & (tangent < nearest)
        nearest[nearer], first[nearer] = tangent, k
    status = direct_status(scene)
    on_sensor = status != NodeStatus.OUT_OF_FRAME
    wanted = np.where(
        first < 0, NodeStatus.RECOVERED, np.where(first % 3 == 0, NodeStatus.BLOCKED, NodeStatus.RIM)
    )
    np.testing.assert_array_equal(status[on_sensor], wanted[on_sensor])
    assert set(np.unique(status[on_sensor])) == {NodeStatus.RECOVERED, NodeStatus.BLOCKED, NodeStatus.RIM}
