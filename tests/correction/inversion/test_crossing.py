"""The inverse where balls reach through the plane: against lines of sight, a second tracer, and areas of discs."""

from dataclasses import replace

import numpy as np
import pytest

from correction.grid import grid_of
from correction.maps.correction_map import build_correction_map, nodes_in_glass
from correction.node_status import NodeStatus
from tests.slow_cases import slow
from tests.tracer.scenes import ball, camera_at
from tests.tracer.second_formulation import second
from tests.tracer.test_crossing import crossing_scene
from tracer.harmonics import COUNT
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace

GRAZE_MM = 1e-6


def sight(scene: Scene, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mask of nodes (N, 2) whose line to the pinhole is free of spheres, and how close it comes to one [mm]."""
    start = np.column_stack((nodes, np.zeros(len(nodes))))
    way = np.array(scene.camera.position_mm) - start
    free, room = np.ones(len(nodes), bool), np.full(len(nodes), np.inf)
    for one in scene.spheres:
        w = np.array(one.centre_mm) - start
        along = np.clip((w * way).sum(axis=1) / (way**2).sum(axis=1), 0.0, 1.0)
        off = np.linalg.norm(w - along[:, None] * way, axis=1) - one.radius_mm
        free &= off > 0.0
        room = np.minimum(room, np.abs(off))
    return free, room


@pytest.mark.parametrize(
    "seed", [*range(2), *map(slow, range(2, 8))]
)  # few balls and many, with cores and without
def test_every_node_is_where_a_second_tracer_lands(seed: int) -> None:
    """To 1e-6 px of a straight view; nodes with a free line of sight are direct, no others; none in glass."""
    rng = np.random.default_rng(40 + seed)
    scene = crossing_scene(rng, cores=seed % 4 == 3, most=(4, 14)[seed % 2])
    scene = scene.with_camera(camera_at((20.0, 10.0, 260.0), (0.0, 0.0, 0.0), 420.0, (120, 120)))
    made = build_correction_map(scene, build_ray_map(scene))
    nodes = made.grid.nodes_mm()
    inside = np.zeros(made.grid.shape, bool)
    for one in scene.spheres:
        inside |= np.hypot(np.hypot(*(nodes - one.centre_mm[:2]).T).T, one.centre_mm[2]) < one.radius_mm
    np.testing.assert_array_equal(made.status == NodeStatus.IN_GLASS, inside)
    free, room = sight(scene, nodes.reshape(-1, 2))
    direct = (made.recovered & (made.branch[0] == 0)).ravel()
    places = scene.camera.project(np.concatenate((nodes, np.zeros((*inside.shape, 1))), axis=-1)).reshape(-1, 2)
    in_frame = ((places > 1e-6) & (places < np.array(scene.camera.sensor_px) - 1.0 - 1e-6)).all(axis=-1)
    asked = (room > GRAZE_MM) & in_frame & ~inside.ravel()
    np.testing.assert_array_equal(direct[asked], free[asked])
    seen = made.recovered
    out = np.empty((int(seen.sum()), 6))
    ways = scene.camera.directions(made.pixel[0][seen])
    second(np.array(scene.camera.position_mm), ways, scene.sphere_table(), out)
    assert (out[:, 2] >= 0).all()
    off = np.hypot(*(out[:, :2] - nodes[seen]).T) / made.grid.pitch_mm
    calm = (out[:, 3] > 1e-4) & (out[:, 4] > 0.3)
    assert off[calm].max() < 1e-6
    assert np.hypot(*(trace(scene, made.pixel[0][seen]).plane_mm - nodes[seen]).T).max() < 1e-4


def test_shares_are_those_of_discs_and_of_counted_rays() -> None:
    """Glass by the area of discs; what is seen through glass against a count of fine pixels around each node."""
    bodies = [ball("a", -14.0, 0.0, 3.0, 13.0), ball("b", 14.0, 0.0, -4.0, 13.0), ball("c", 0.0, 5.0, 27.0, 11.0)]
    scene = Scene(camera_at((0.0, 0.0, 400.0), focal_px=1600.0, sensor_px=(320, 320)), tuple(bodies))
    made = build_correction_map(scene, build_ray_map(scene))
    discs = np.pi * (13.0**2 - 3.0**2 + 13.0**2 - 4.0**2)
    glass = made.status == NodeStatus.IN_GLASS
    assert glass.sum() * made.grid.pitch_mm**2 == pytest.approx(discs, rel=5e-3)
    fine = build_ray_map(scene.coarser(1).with_camera(scene.camera.with_width(1280)))
    shown = np.zeros(made.grid.shape, bool)
    through = fine.recovered & (fine.branch != 0)
    places = np.rint(made.grid.to_px(fine.plane_mm[through]))
    column, row = places[((places >= 0.0) & (places < 320.0)).all(axis=-1)].astype(int).T
    shown[row, column] = True
    found = made.recovered & (made.branch[0] != 0)
    assert found.sum() > 100
    assert (found & ~shown).sum() < 0.03 * found.sum()  # nodes at the borders of pixels


def test_balls_out_of_round_mask_what_they_fill() -> None:
    """Asked of the bodies alone: kernels of the inverse of such balls are compiled by slow tests."""
    flat = (-200.0,) + (0.0,) * (COUNT - 1)
    uneven = replace(ball("flat", 0.0, 0.0, 19.8, 20.0), shape_um=flat)
    scene = Scene(camera_at((0.0, 0.0, 400.0), focal_px=1600.0, sensor_px=(160, 160)), (uneven,))
    grid = grid_of(scene.camera)
    assert nodes_in_glass(scene, grid) is None  # its sphere would cross, its surface does not
    inside = nodes_in_glass(scene.with_bodies([replace(uneven, centre_mm=(0.0, 0.0, 19.0))]), grid)
    assert inside is not None
    assert inside.sum() * grid.pitch_mm**2 == pytest.approx(np.pi * (20.0**2 - 19.45**2), rel=0.1)
