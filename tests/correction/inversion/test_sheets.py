"""Sheets by runs against labelling by SciPy; block Newton against the careful one."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from correction.inversion.kernels.newton import solve_node
from correction.inversion.kernels.sheets import GLASS, RUN, SIGN, USEFUL, NodeScale, Sensor, join_runs, list_runs
from correction.maps.correction_map import MAX_MAGNIFICATION, MIN_MAGNIFICATION, build_correction_map
from tests.correction.small_scenes import SCENES, small_scene
from tests.slow_cases import slow_but
from tracer.bodies import Sphere
from tracer.kernels.rays import trace_pixel_tangents
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import pack_camera, world_of


@pytest.mark.parametrize("seed", range(5))
def test_runs_join_to_the_regions_that_labelling_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = ndimage.zoom(rng.integers(0, 4, (12, 14)), 5, order=0) + (rng.random((60, 70)) < 0.1)
    kinds = np.where(rng.random(kinds.shape) < 0.05, 0, kinds)
    kinds[:, [0, -1]] = 0
    branch, useful = (kinds // 2).astype(np.uint16), rng.integers(0, 2, kinds.shape) * USEFUL
    flags = np.where(kinds > 0, GLASS + kinds % 2 * SIGN + useful, 0).astype(np.uint8)
    counts = [(np.diff(row.astype(int), prepend=0) != 0)[row > 0].sum() for row in kinds]
    begin = np.concatenate(([0], np.cumsum(counts)))
    runs, parent = np.full((begin[-1], RUN), -1, np.int64), np.empty(begin[-1], np.int64)
    plane = rng.uniform(-40.0, 40.0, (len(flags), 2 * flags.shape[1]))
    sensor = Sensor(plane, branch, flags, np.zeros((50, 50), np.uint8))
    scale = NodeScale(np.array([-25.0, 25.0, 1.0]), np.array([49.0, 49.0]), 2.0, 1)
    list_runs(sensor, scale, 0, len(flags), begin, np.empty(flags.shape[1], np.int64), runs)
    join_runs(begin, runs, parent)
    sheet = np.zeros(flags.shape, int)
    for (row, first, last, kind, top, bottom), head in zip(runs.tolist(), parent.tolist(), strict=True):
        used = flags[row, first:last] & USEFUL > 0
        nodes = 25.0 - plane[row, 1::2][first:last][used]  # rows of nodes that useful pixels see
        reached = np.arange(50) >= nodes.min(initial=np.inf) - 2.0 * np.sqrt(2.0)
        reached &= np.arange(50) <= nodes.max(initial=-np.inf) + 2.0 * np.sqrt(2.0)
        assert np.all((np.flatnonzero(reached) >= top) & (np.flatnonzero(reached) <= bottom))
        assert reached.any() or top > bottom or bottom - top <= 2
        assert np.all(kinds[row, first:last] == kind)
        assert np.all(sheet[row, first:last] == 0)
        sheet[row, first:last] = head + 1
    assert np.array_equal(sheet > 0, kinds > 0)
    for kind in range(1, 6):
        labels, count = ndimage.label(kinds == kind, np.ones((3, 3)))
        pairs = set(zip(labels[kinds == kind].tolist(), sheet[kinds == kind].tolist(), strict=True))
        assert len(pairs) == count == len({head for _, head in pairs})


@pytest.mark.parametrize("name", SCENES)
def test_nodes_in_blocks_and_one_by_one_agree(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same map with the block Newton switched off: other arithmetic, same views."""
    scene = small_scene(name)
    ray_map = build_ray_map(scene)
    blocks = build_correction_map(scene, ray_map, layers=2)
    if (way := choose(scene)).kind is Kind.LOCKSTEP:
        monkeypatch.setattr("correction.maps.correction_map.choose", lambda _: replace(way, kind=Kind.BUNDLES))
    single = build_correction_map(scene, ray_map, layers=2)
    assert (blocks.status != single.status).sum() <= 2
    both = np.isfinite(blocks.pixel[..., 0]) & np.isfinite(single.pixel[..., 0]) & (blocks.branch == single.branch)
    assert both.sum() > 0.999 * np.isfinite(single.pixel[..., 0]).sum()
    assert np.abs(blocks.pixel - single.pixel)[both].max() < 1e-7
    assert np.allclose(blocks.jacobian[both], single.jacobian[both], rtol=1e-3, atol=1e-4)
    assert np.allclose(blocks.transmittance[both], single.transmittance[both], rtol=1e-5)


def packed_bed(columns: int) -> Scene:
    """Body-centred cubic spheres, matched to 1.023: thousands of small sheets that bend by their own size."""
    pitch = 100.0 / columns
    radius = 0.49 * np.sqrt(0.75) * pitch
    places = np.concatenate([np.argwhere(np.ones((columns,) * 3)) + corner for corner in (0.0, 0.5)])
    centres = (places - columns / 2.0 + 0.25) * pitch + np.array([0.0, 0.0, 51.0 + radius])
    glass = ConstantMedium(1.023)
    balls = [Sphere(f"s{k}", tuple(map(float, c)), float(radius), glass) for k, c in enumerate(centres)]
    return small_scene("pyramid_500", 252).with_bodies(balls)


@pytest.mark.slow
def test_hardly_a_node_is_missing_to_which_its_neighbour_leads() -> None:
    """Careful Newton from the view of the node beside it: what it finds lies between the last pixels and the rim.

    In scenes of a few balls it finds nothing; here sheets are a few pixels wide and bend by as much.
    """
    scene = packed_bed(6)
    ray_map = build_ray_map(scene)
    found = build_correction_map(scene, ray_map)
    tables = pack_camera(scene.camera), world_of(scene)
    nodes, pitch = found.grid.nodes_mm(), found.grid.pitch_mm
    edge, tried = np.array(scene.camera.sensor_px) - 1.0, 0
    height, width = found.status.shape
    missing = set()
    for row, column in np.argwhere(~found.recovered).tolist():
        for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            i, j = row + down, column + right
            if not (0 <= i < height and 0 <= j < width and found.behind_glass[i, j]):
                continue
            view = found.jacobian[0, i, j].astype(float).reshape(2, 2)
            u, v = found.pixel[0, i, j] - view @ (right, down)
            _, _, _, au, av, bu, bv, _, key, _ = trace_pixel_tangents(*found.pixel[0, i, j], *tables)
            sign = np.sign(au * bv - av * bu)
            done, u, v, au, av, bu, bv, _ = solve_node(*nodes[row, column], u, v, key, sign, tables)
            tried += 1
            if done and 0.0 <= u <= edge[0] and 0.0 <= v <= edge[1]:
                low, high = np.linalg.svd(pitch * np.linalg.inv([[au, av], [bu, bv]]), compute_uv=False)[::-1]
                # Nearer to the limits the pixel itself may be beyond them, and not worth a start.
                if low > 1.2 * MIN_MAGNIFICATION and high < 0.8 * MAX_MAGNIFICATION:
                    missing.add((row, column))
    assert tried > 1000
    assert len(missing) < 0.0025 * found.recovered.sum()  # 0.0020 on writing


@pytest.mark.parametrize("name", slow_but(SCENES, "two_spheres_500", "hollow_pair"))
def test_derivatives_are_those_of_the_stored_pixel_to_what_float32_holds(name: str) -> None:
    """The last step is not traced again: what it leaves in Jacobian and transmittance is bounded by its size."""
    scene = small_scene(name)
    made = build_correction_map(scene, build_ray_map(scene), layers=2)
    tables = pack_camera(scene.camera), world_of(scene)
    seen = np.isfinite(made.pixel[..., 0]) & (made.branch != 0)
    off, dim = [], []
    for (u, v), stored, light in zip(made.pixel[seen], made.jacobian[seen], made.transmittance[seen], strict=True):
        _, _, _, *slopes, passed, _, _ = trace_pixel_tangents(u, v, *tables)
        exact = np.linalg.inv(np.array(slopes).reshape(2, 2)) * [1.0, -1.0] * made.grid.pitch_mm
        off.append(np.abs(exact.ravel() - stored).max() / np.abs(exact).max())
        dim.append(abs(light - passed))
    assert np.quantile(off, 0.95) < 1.2e-7
    assert np.quantile(off, 0.99) < 4e-7
    assert max(off) < 1e-5  # at rims, where derivatives change by their own size within a few pixels
    assert max(dim) < 1e-6


def test_a_map_needs_little_more_memory_than_it_holds() -> None:
    scene = small_scene("two_spheres_500", 1512)
    ray_map = build_ray_map(scene)
    build_correction_map(scene, ray_map)
    tracemalloc.start()
    made = build_correction_map(scene, ray_map)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held / made.status.size < 43.5
    assert peak / made.status.size < 48.0


def test_arrays_of_an_earlier_map_are_written_in_full() -> None:
    scene = small_scene("pyramid_500", 200)
    ray_map = build_ray_map(scene)
    fresh, old = (build_correction_map(scene, ray_map, layers=2) for _ in range(2))
    for name in ("status", "pixel", "jacobian", "weight", "transmittance", "branch"):
        getattr(old, name)[...] = 3
    again = build_correction_map(scene, ray_map, layers=2, out=old)
    assert again.pixel is old.pixel
    for name in ("status", "pixel", "jacobian", "weight", "transmittance", "branch"):
        assert np.array_equal(
            getattr(again, name), getattr(fresh, name), equal_nan=name in ("pixel", "jacobian")
        ), name
