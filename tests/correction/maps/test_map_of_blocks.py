"""Correction maps through and beside boxes, cuvettes and prisms, against the renderer's own optics."""

import numpy as np
import pytest

from correction.maps.correction_map import CorrectionMap, build_correction_map
from correction.node_status import NodeStatus
from rtpiv.analysis.through_glass import through_glass
from sim.renderer.kernels.rays import to_plane
from sim.renderer.patterns import Pose
from sim.renderer.render import tables_of
from tests.tracer.scenes import camera_at
from tests.tracer.test_blocks import GLASS, WATER
from tracer.bodies import Body, Box, Prism, Sphere
from tracer.bodies.block import UNTURNED, rectangle, rotate_axes
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map

# Kernels of the inverse compile for a minute; the rays are held by tests/tracer/test_blocks.py
pytestmark = pytest.mark.slow
TILT = rotate_axes(UNTURNED, (0.09, 0.25, 0.1))
BOX = Box("box", rectangle(30.0, 22.0), 20.0, GLASS, (-18.0, 11.0, 30.0), TILT)
CUVETTE = Box("cuvette", rectangle(34.0, 26.0), 20.0, GLASS, (14.0, -13.0, 30.0), TILT, 1.25, WATER)
PRISM = Prism("prism", ((-12.0, -9.0), (14.0, -9.0), (-12.0, -2.0)), 18.0, GLASS, (14.0, 16.0, 20.0), TILT)
TANK = Box("tank", rectangle(80.0, 60.0), 50.0, GLASS, (0.0, 0.0, 10.0), UNTURNED, 3.0, WATER)


def map_of(*bodies: Body, side: float = 0.0) -> tuple[Scene, CorrectionMap]:
    scene = Scene(camera_at((side, 20.0, 400.0), (0.0, 0.0, 0.0), 1200.0, (180, 140)), bodies)
    return scene, build_correction_map(scene, build_ray_map(scene))


def errors_px(scene: Scene, found: CorrectionMap) -> np.ndarray:
    """Where the renderer's rays of the map's pixels land, off their nodes [corrected px]; every third of them."""
    tables, nodes = tables_of(scene, Pose(), None), found.grid.nodes_mm()[found.recovered][::3]
    pixels = found.pixel[0][found.recovered][::3]
    eye, errors = np.array(scene.camera.position_mm), []
    for node, way in zip(nodes, scene.camera.directions(pixels), strict=True):
        x, y, light = to_plane(*eye, *way, tables.world)
        errors.append(np.hypot(*(np.array((x, y)) - node)) if light > 0.0 else np.nan)
    return np.array(errors) / found.grid.pitch_mm


@pytest.mark.parametrize(
    ("bodies", "side", "least"),
    [
        ((BOX, CUVETTE, PRISM), 0.0, 0.7),
        ((CUVETTE,), 230.0, 0.75),  # 30 degrees aside
        ((TANK, Sphere("ball", (5.0, 0.0, 15.0), 6.0, GLASS)), 60.0, 0.9),  # the plane runs through it
    ],
)
def test_map_is_that_of_the_renderer(bodies: tuple[Body, ...], side: float, least: float) -> None:
    scene, found = map_of(*bodies, side=side)
    assert found.recovered.mean() > least
    errors = errors_px(scene, found)
    assert np.isfinite(errors).all()
    assert errors.max() < 1e-6
    ways = {found.branches[number] for number in np.unique(found.branch[0][found.recovered])}
    assert len(ways) > 1


def test_edges_are_a_reason_of_their_own() -> None:
    scene, found = map_of(BOX)
    hidden = found.status == NodeStatus.EDGE
    assert 0.02 < hidden.mean() < 0.2
    assert not np.isin(found.status, (NodeStatus.RIM, NodeStatus.FOLD)).any()
    outline = through_glass(scene, found.grid, found.recovered)
    assert outline is not None
    lost_mm2, hidden_mm2 = outline.hidden_mm2 - outline.recovered_mm2, hidden.sum() * found.grid.pitch_mm**2
    assert 0.95 * lost_mm2 < hidden_mm2 <= 1.001 * lost_mm2  # the rest is seen beside the sensor


def test_nodes_in_a_box_that_the_plane_cuts_are_inside_a_body() -> None:
    cut = Box("box", rectangle(20.0, 16.0), 30.0, GLASS, (4.0, 2.0, 5.0), TILT)
    scene, found = map_of(cut, side=150.0)
    inside = found.status == NodeStatus.IN_GLASS
    assert inside.mean() > 0.02
    errors = errors_px(scene, found)
    assert np.isfinite(errors).all()
    assert errors.max() < 1e-6
