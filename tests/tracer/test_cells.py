"""Many spheres: the walk through cells finds what asking every sphere finds, bit for bit."""

from pathlib import Path

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from tests.tracer.scenes import ball, camera_at, random_bodies
from tracer.bodies import Rod
from tracer.kernels.rays import trace_rows
from tracer.kernels.rooms import ONE_ROOM
from tracer.kernels.world import World, next_in_bed, next_sphere
from tracer.scene.scene import Scene
from tracer.strategies import beds
from tracer.strategies import trace as tracing
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import NO_CELLS, NO_RODS, pack_camera, sort_into_cells, trace


def bed(kind: str, seed: int = 0, rod: bool = True) -> Scene:
    """Touching cubic packing (faces of cells on contacts), or a random packing with opaque balls and a rod."""
    rng = np.random.default_rng(seed)
    if kind == "cubic":
        centres = 10.0 * np.stack(np.meshgrid(*3 * [np.arange(5)]), axis=-1).reshape(-1, 3) + (-20.0, -20.0, 5.0)
        bodies = [ball(f"s{i}", *map(float, centre), 5.0, 1.05) for i, centre in enumerate(centres)]
    else:
        bodies = random_bodies(rng, 40)
        bodies = [ball(b.name, *b.centre_mm, b.radius_mm, None) if i % 9 == 0 else b for i, b in enumerate(bodies)]
        bodies += [Rod("rod", (-90.0, 0.0, 150.0), (90.0, 5.0, 150.0), 1.0)] * rod
    top = max(body.highest_mm for body in bodies)
    camera = camera_at((15.0, -9.0, top + 150.0), (2.0, 1.0, 0.0), 90.0, (120, 90), 0.2)
    return Scene(camera, tuple(bodies))


@pytest.mark.parametrize(("kind", "seed"), [("cubic", 0), *(("random", seed) for seed in range(4))])
def test_rows_have_the_same_bits_as_asking_every_sphere(kind: str, seed: int) -> None:
    where = bed(kind, seed, rod=False)  # with one, rows that nothing else asks for would be compiled
    height, width = where.camera.shape
    camera, spheres = pack_camera(where.camera), where.sphere_table()
    results = []
    for grid in (sort_into_cells(spheres), NO_CELLS):
        arrays = (
            np.empty((height, width, 2)),
            np.empty((height, width), np.uint8),
            np.empty((height, width), np.int64),
        )
        trace_rows(camera, World(spheres, *grid, NO_RODS), 0, height, *arrays)
        results.append(arrays)
    for one, other in zip(*results, strict=True):
        assert one.tobytes() == other.tobytes()
    assert len(np.unique(results[0][2])) > 20


@pytest.mark.parametrize("kind", ["cubic", "random"])
def test_single_rays_go_through_cells_too(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number of a ray, and the names of its way, bit for bit."""
    where = bed(kind)
    pixels = np.random.default_rng(2).uniform(0.0, 90.0, (3000, 2))
    through_cells = trace(where, pixels)
    monkeypatch.setattr(tracing, "FEW", 10_000)
    asking_all = trace(where, pixels)
    assert through_cells.rays.tobytes() == asking_all.rays.tobytes()
    assert through_cells.branches == asking_all.branches
    assert through_cells.rays["events"].max() > 2


@pytest.mark.parametrize(("kind", "seed"), [("cubic", 0), ("random", 5)])
def test_rays_from_anywhere_meet_the_same_sphere(kind: str, seed: int) -> None:
    """Starts outside, inside and on faces of cells; directions along axes, along faces, and any."""
    where = bed(kind, seed)
    spheres = where.sphere_table()
    frame, begin, items = sort_into_cells(spheres)
    rng = np.random.default_rng(seed)
    met = 0
    for case in range(4000):
        start = rng.uniform((-80.0, -80.0, -40.0), (80.0, 80.0, 120.0))
        way = rng.normal(size=3)
        if case % 4 == 1:
            way = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        if case % 4 == 2:
            start = frame[:3] + frame[3] * rng.integers(-1, 6, 3)
            way[rng.integers(3)] = 0.0
        if case % 4 == 3:
            start = start * 1e6
            way = spheres[rng.integers(len(spheres)), :3] - start
        way = way / np.linalg.norm(way)
        last = int(rng.integers(-1, len(spheres)))
        expected = next_sphere(tuple(start), tuple(way), last, spheres, 0, ONE_ROOM.home)
        cells = frame, begin, items
        assert next_in_bed(tuple(start), tuple(way), last, spheres, cells, 0, ONE_ROOM.home) == expected
        met += expected[0] >= 0
    assert met > 1000


def test_every_sphere_is_listed_in_every_cell_it_reaches() -> None:
    spheres = bed("random", 3).sphere_table()
    frame, begin, items = sort_into_cells(spheres)
    count = frame[4:].astype(int)
    rng = np.random.default_rng(1)
    for number, (x, y, z, radius) in enumerate(spheres[:, :4].tolist()):
        inside = rng.normal(size=(200, 3))
        inside *= (radius * rng.uniform(size=(200, 1)) ** (1.0 / 3.0)) / np.linalg.norm(
            inside, axis=1, keepdims=True
        )
        i, j, k = np.floor((inside + np.array([x, y, z]) - frame[:3]) / frame[3]).astype(int).T
        for cell in set(((k * count[1] + j) * count[0] + i).tolist()):
            assert number in items[begin[cell] : begin[cell + 1]]


@pytest.mark.slow
def test_more_branches_than_short_numbers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The same map with longer numbers, all the way to the correction map, and back from the disk."""
    where = bed("cubic")
    short = build_ray_map(where)
    first = build_correction_map(where, short)
    monkeypatch.setattr(beds, "SHORT_NUMBERS", 4)
    long = build_ray_map(where, short)
    assert long.branch.dtype == np.uint32
    assert np.array_equal(long.branch, build_ray_map(where).branch)
    assert long.branches == build_ray_map(where).branches
    assert len(long.branches) > 20
    made = build_correction_map(where, long, out=first)
    assert np.array_equal(made.pixel, first.pixel, equal_nan=True)
    assert np.array_equal(made.branch, first.branch)
    for each in (long, made):
        each.save(tmp_path / "map")
        assert np.array_equal(type(each).load(tmp_path / "map").branch, each.branch)


def test_radii_that_a_fit_makes_negative_sort_as_their_squares() -> None:
    """Hypotheses of a fit of many balls try any number: no box of cells may be of negative size."""
    spheres = bed("random", rod=False).sphere_table()
    wrong = spheres.copy()
    wrong[:, 3] *= -1.0
    for right, found in zip(sort_into_cells(spheres), sort_into_cells(wrong), strict=True):
        np.testing.assert_array_equal(found, right)
