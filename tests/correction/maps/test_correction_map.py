"""The inverse map: exact, complete, with a reason for every node that is missing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.grid import PlaneGrid, grid_of
from correction.maps.correction_map import CorrectionMap, build_correction_map
from correction.node_status import NodeStatus
from ground.errors import MapFileError
from tests.correction.small_scenes import SCENES, small_scene
from tests.loops import loop_over
from tracer.bodies import Rod, Sphere
from tracer.camera import Lens
from tracer.errors import StaleMap
from tracer.media import ConstantMedium
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import trace

ARRAYS = ("status", "pixel", "jacobian", "weight", "transmittance", "branch")
FLOATS = ("pixel", "jacobian")


@cache
def inverted(name, **options):
    scene = small_scene(name)
    return scene, build_correction_map(scene, build_ray_map(scene), **options)


@pytest.mark.parametrize("name", SCENES)
def test_every_recovered_node_is_seen_by_its_pixel(name):
    """Trace the stored pixels forwards again: they must land on their nodes, by the stored branch."""
    scene, cmap = inverted(name, layers=3)
    nodes = cmap.grid.nodes_mm()
    for layer in range(cmap.layers):
        seen = np.isfinite(cmap.pixel[layer, ..., 0])
        if not seen.any():
            continue
        result = trace(scene, cmap.pixel[layer][seen])
        assert result.recovered.all()
        off_mm = np.abs(result.plane_mm - nodes[seen]).max(axis=-1)
        j = cmap.jacobian[layer][seen].astype(float)
        off_px = off_mm / cmap.grid.pitch_mm * np.abs(j).sum(axis=-1)
        assert off_px.max() < 1e-6
        names = [result.branches[key] for key in result.rays["key"]]
        assert names == [cmap.branches[number] for number in cmap.branch[layer][seen]]
        assert np.allclose(result.rays["transmittance"], cmap.transmittance[layer][seen], rtol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_jacobian_is_the_derivative_of_the_stored_pixels(name):
    """Differences of neighbouring nodes on one branch, at nodes where the map bends little."""
    _, cmap = inverted(name)
    u = cmap.pixel[0]
    branch = np.where(cmap.recovered, cmap.branch[0], 65535)
    same = (branch[1:-1, 2:] == branch[1:-1, 1:-1]) & (branch[1:-1, :-2] == branch[1:-1, 1:-1])
    ahead, behind = u[1:-1, 2:] - u[1:-1, 1:-1], u[1:-1, 1:-1] - u[1:-1, :-2]
    bend = np.abs(ahead - behind).max(axis=-1)
    usable = same & cmap.recovered[1:-1, 1:-1] & (bend < 0.005)
    assert usable.sum() > 1000
    slope = 0.5 * (ahead + behind)[usable]
    stored = cmap.jacobian[0][1:-1, 1:-1][usable][:, [0, 2]]
    assert np.abs(slope - stored).max() < 0.005


@pytest.mark.parametrize("name", SCENES)
def test_nothing_that_the_pixels_surround_is_missing(name):
    """A node inside the plane triangle of three neighbouring pixels of one branch must be recovered."""
    scene, cmap = inverted(name)
    ray_map = build_ray_map(scene)
    branch = np.where(ray_map.recovered, ray_map.branch.astype(int), -1)
    together = (
        (branch[:-1, :-1] >= 0) & (branch[:-1, :-1] == branch[1:, :-1]) & (branch[:-1, :-1] == branch[:-1, 1:])
    )
    rows, columns = np.nonzero(together)
    corner = cmap.grid.to_px(ray_map.plane_mm[rows, columns])
    right = cmap.grid.to_px(ray_map.plane_mm[rows, columns + 1]) - corner
    below = cmap.grid.to_px(ray_map.plane_mm[rows + 1, columns]) - corner
    sides = np.stack((right, below), axis=-1)
    stretch = np.linalg.svd(sides, compute_uv=False)
    node = np.rint(corner + (right + below) / 3.0)
    plain = (stretch.max(axis=1) < 1.6) & (stretch.min(axis=1) > 0.2)
    where = np.linalg.solve(sides[plain], (node - corner)[plain][..., None])[..., 0]
    inside = (where > 0.1).all(axis=1) & (where.sum(axis=1) < 0.9)
    node = node[plain][inside].astype(int)
    node = node[((node >= 1) & (node < np.array(cmap.grid.shape[::-1]) - 1)).all(axis=1)]
    assert len(node) > 500
    assert (cmap.status[node[:, 1], node[:, 0]] == NodeStatus.RECOVERED).all()


def test_the_direct_view_is_the_ideal_camera():
    scene = small_scene("two_spheres_500").with_bodies(())
    cmap = build_correction_map(scene, build_ray_map(scene))
    rows, columns = np.indices(cmap.grid.shape)
    assert cmap.recovered.all()
    assert np.abs(cmap.pixel[0] - np.stack((columns, rows), axis=-1)).max() < 1e-9
    assert np.allclose(cmap.jacobian[0], [1, 0, 0, 1], atol=1e-6)


def test_lens_terms_are_undone():
    scene = small_scene("two_spheres_500").with_bodies(())
    lens = Lens(k1=0.4, k2=-0.2, p1=0.01, p2=-0.02)
    bent = scene.with_camera(replace(scene.camera, lens=lens))
    cmap = build_correction_map(bent, build_ray_map(bent))
    nodes = np.concatenate((cmap.grid.nodes_mm(), np.zeros((*cmap.grid.shape, 1))), axis=-1)
    expected = bent.camera.project(nodes)
    assert np.abs(cmap.pixel[0] - expected)[cmap.recovered].max() < 1e-7
    outside = ((expected < 0) | (expected > np.array(scene.camera.sensor_px) - 1)).any(axis=-1)
    assert (cmap.status[outside] == NodeStatus.OUT_OF_FRAME).all()


def test_weights_sum_to_one_and_the_direct_view_comes_first():
    _, cmap = inverted("pyramid_500", layers=3)
    total = cmap.weight.sum(axis=0)
    assert np.allclose(total[cmap.recovered], 1.0, atol=1e-6)
    assert (total[~cmap.recovered] == 0.0).all()
    assert (np.diff(cmap.weight, axis=0)[:, cmap.recovered] <= 1e-7).all()
    direct_anywhere = ((cmap.branch == 0) & (cmap.weight > 0)).any(axis=0)
    assert (cmap.branch[0][direct_anywhere] == 0).all()


def test_more_layers_do_not_change_the_best_view():
    _, one = inverted("pyramid_500")
    _, three = inverted("pyramid_500", layers=3)
    assert np.array_equal(one.status, three.status)
    assert np.array_equal(one.pixel[0], three.pixel[0], equal_nan=True)


@loop_over("layers", [1, 2])
@loop_over("name", SCENES)
def test_views_that_cannot_be_among_the_best_are_left_out_and_no_bit_changes(name, layers):
    _, some = inverted(name, layers=layers)
    _, every = inverted(name, layers=layers, skip=False)
    for array in ARRAYS:
        assert np.array_equal(getattr(some, array), getattr(every, array), equal_nan=array in FLOATS)


def test_reasons():
    """A rod blocks, a ball hides its rim, a small grid leaves the frame."""
    scene = small_scene("one_sphere_500")
    rod = Rod("support", (-60.0, 0.0, 200.0), (-60.0, 30.0, 200.0), 4.0)
    scene = scene.with_bodies((*scene.bodies, rod))
    wide = grid_of(scene.camera)
    wide = PlaneGrid((wide.origin_mm[0] - 20.0, wide.origin_mm[1]), wide.pitch_mm, wide.shape)
    cmap = build_correction_map(scene, build_ray_map(scene), wide)

    def status_at(x, y):
        column, row = np.rint(wide.to_px(np.array([x, y]))).astype(int)
        return NodeStatus(cmap.status[row, column])

    distance = 500.0 / 300.0
    assert status_at(-60.0 * distance * 0.6, 0.0) is NodeStatus.RECOVERED
    assert status_at(-60.0 * 500.0 / 300.0 + 31.0, 5.0) is NodeStatus.RECOVERED
    assert status_at(0.0, 0.0) is NodeStatus.RECOVERED
    assert status_at(0.0, 40.0) in (NodeStatus.RIM, NodeStatus.LOW_MAGNIFICATION)
    assert status_at(wide.origin_mm[0] + 1.0, 0.0) is NodeStatus.OUT_OF_FRAME


def test_an_opaque_ball_blocks_and_a_rod_too():
    scene = small_scene("one_sphere_500")
    ball = replace(scene.bodies[0], medium=None)
    rod = Rod("support", (30.0, -40.0, 150.0), (30.0, -20.0, 150.0), 3.0)
    for body, x, y in ((ball, 0.0, 10.0), (rod, 30.0 / 0.7, -30.0 / 0.7)):
        blocked = scene.with_bodies((body,))
        cmap = build_correction_map(blocked, build_ray_map(blocked))
        column, row = np.rint(cmap.grid.to_px(np.array([x, y]))).astype(int)
        assert cmap.status[row, column] == NodeStatus.BLOCKED


def test_off_axis_glass_of_other_index_and_tilted_camera():
    _, cmap = inverted("tilted_pair")
    assert cmap.behind_glass.sum() > 500
    assert np.isfinite(cmap.pixel[0][cmap.recovered]).all()
    assert np.isnan(cmap.pixel[0][~cmap.recovered]).all()


def test_index_one_is_the_identity():
    scene = small_scene("two_spheres_500")
    air = tuple(replace(body, medium=ConstantMedium(1.0)) for body in scene.bodies if isinstance(body, Sphere))
    clear = scene.with_bodies(air)
    cmap = build_correction_map(clear, build_ray_map(clear))
    rows, columns = np.indices(cmap.grid.shape)
    seen = cmap.recovered
    assert seen.mean() > 0.99
    assert np.abs(cmap.pixel[0] - np.stack((columns, rows), axis=-1))[seen].max() < 1e-9


def test_stored_maps_come_back_and_foreign_ones_are_refused(tmp_path):
    scene, cmap = inverted("two_spheres_500", layers=2)
    path = tmp_path / "map.npz"
    cmap.save(path)
    back, kept = CorrectionMap.load(path), cmap.as_stored()
    for name in ARRAYS:
        assert np.array_equal(getattr(back, name), getattr(kept, name), equal_nan=name in FLOATS)
    assert (back.grid, back.branches, back.sensor_px) == (cmap.grid, cmap.branches, cmap.sensor_px)
    back.check(scene)
    other = small_scene("one_sphere_500")
    with pytest.raises(StaleMap, match="belongs to scene"):
        back.check(other)
    with pytest.raises(StaleMap):
        build_correction_map(other, build_ray_map(scene))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(MapFileError, match="damaged"):
        CorrectionMap.load(path)
    ray_map = build_ray_map(scene)
    ray_map.save(path)
    with pytest.raises(MapFileError, match="holds a ray map"):
        CorrectionMap.load(path)


@loop_over(
    "name, value",
    [
        ("status", 77),
        ("branch", 60000),
        ("pixel", np.nan),
        ("pixel", np.inf),
        ("pixel", -0.001),
        ("pixel", 335.001),
        ("jacobian", np.nan),
        ("jacobian", -np.inf),
        ("weight", np.nan),
        ("weight", -1.0),
        ("weight", 0.5),
        ("transmittance", np.nan),
        ("transmittance", 1.5),
    ],
)
def test_a_stored_map_with_a_value_that_no_map_has_is_refused(tmp_path, name, value):
    _, cmap = inverted("two_spheres_500")
    array = getattr(cmap, name).copy()
    row, column = np.argwhere(cmap.recovered)[100]
    if name == "status":
        array[row, column] = value
    else:
        array[0, row, column] = value
    path = tmp_path / "map.npz"
    replace(cmap, **{name: array}).save(path)
    with pytest.raises(MapFileError, match="make the map again"):
        CorrectionMap.load(path)


@pytest.mark.parametrize("sensor_px", [(336, 300), (0, 336), (-5, -5)])
def test_a_stored_map_of_a_sensor_that_its_pixels_leave_is_refused(tmp_path, sensor_px):
    _, cmap = inverted("two_spheres_500")
    path = tmp_path / "map.npz"
    replace(cmap, sensor_px=sensor_px).save(path)
    with pytest.raises(MapFileError, match=r"make (the map|it) again"):
        CorrectionMap.load(path)


def test_same_bits_for_any_number_of_threads(monkeypatch):
    maps = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        maps.append(inverted.__wrapped__("pyramid_500")[1])
    for other in maps[1:]:
        assert np.array_equal(maps[0].pixel, other.pixel, equal_nan=True)
        assert np.array_equal(maps[0].status, other.status)
