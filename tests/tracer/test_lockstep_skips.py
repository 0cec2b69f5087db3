"""What lockstep passes over without a look must change nothing: each skip off, each bound held."""

import numpy as np
import pytest

from tests.tracer.scenes import TILTED, ball, camera_at, random_bodies, random_camera, scene
from tests.tracer.test_lockstep import shrunk
from tracer.kernels.chain import (
    SKIP_LEFT_BEHIND,
    SKIP_SILHOUETTES,
    branch_number,
    glass_span,
    insert_span,
    place_row,
)
from tracer.lockstep import ALL_SKIPS, pack_chain, trace_lockstep
from tracer.ray_map import build_ray_map
from tracer.scene import Scene
from tracer.trace import pack_camera

SCENES = ("one_sphere_250", "two_spheres_500", "three_spheres_500", "pyramid_500", TILTED)


def traced(where: Scene, skips: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple]:
    shape = where.camera.shape
    arrays = np.empty((*shape, 2)), np.empty(shape, np.uint8), np.empty(shape, np.uint16)
    return (*arrays, trace_lockstep(where, *arrays, skips))


def some_scene(name: str) -> Scene:
    where = scene(name)
    return where.with_camera(shrunk(where.camera, 6.0))


def random_lockstep_scene(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    bodies = random_bodies(rng, (2, 4, 6, 8)[seed % 4])
    return Scene(shrunk(random_camera(rng, bodies), 4.0), tuple(bodies))


@pytest.mark.parametrize("where", [*map(some_scene, SCENES), *map(random_lockstep_scene, range(8))])
def test_every_skip_keeps_branches_and_points(where: Scene) -> None:
    """A pixel without glass may come from either formula of the direct view: rounding apart, nothing else is."""
    plane, status, branch, branches = traced(where, ALL_SKIPS)
    for skips in (0, SKIP_SILHOUETTES, SKIP_LEFT_BEHIND):
        other = traced(where, skips)
        assert np.array_equal(status, other[1])
        assert branches == other[3]
        assert np.array_equal(branch, other[2])
        if skips & SKIP_SILHOUETTES:
            assert plane.tobytes() == other[0].tobytes()
        glass = branch != 0
        assert plane[glass].tobytes() == other[0][glass].tobytes()
        far = 1.0 + (plane[~glass] ** 2).sum(axis=-1, keepdims=True)
        assert np.nanmax(np.abs(plane[~glass] - other[0][~glass]) / far, initial=0.0) < 1e-12


@pytest.mark.parametrize("where", [*map(some_scene, SCENES), *map(random_lockstep_scene, range(8))])
def test_silhouettes_hold_every_pixel_that_meets_glass_and_little_else(where: Scene) -> None:
    """Row intervals against the distance of every pixel's ray from the centre, asked one by one."""
    camera, balls = pack_camera(where.camera), pack_chain(where)
    height, width = where.camera.shape
    v, u = np.indices((height, width))
    ways = where.camera.directions(np.stack((u, v), axis=-1))
    flat = where.camera.lens.is_ideal
    x, y = (np.arange(width) - camera[13]) / camera[12], np.empty(width)
    for k, (cx, cy, cz, r2) in enumerate(balls[:, :4].tolist()):
        to_centre = np.array([cx, cy, cz]) - camera[:3]
        along = ways @ to_centre
        meets = (along > 0.0) & (((along[..., None] * ways - to_centre) ** 2).sum(-1) < r2 * (1.0 - 1e-12))
        for row in range(0, height, 7):
            place_row(row, flat, camera, x, y)
            low, high = glass_span(x, y, flat, camera, balls, k)
            columns = np.nonzero(meets[row])[0]
            if len(columns):
                assert low <= columns[0]
                assert columns[-1] < high
                assert (columns[0] - low) + (high - columns[-1]) < 8
            else:
                assert high - low < 8 + 0.02 * width  # a row that just misses


def test_bodies_outside_the_view_change_no_bit() -> None:
    """And they are not looked at: their silhouettes are empty in every row."""
    where = some_scene("two_spheres_500")
    outside = (ball("left", -400.0, 0.0, 30.0, 20.0), ball("behind", 0.0, 300.0, 480.0, 40.0))
    crowded = where.with_bodies((*where.bodies, *outside))
    one, other = build_ray_map(where), build_ray_map(crowded)
    assert one.plane_mm.tobytes() == other.plane_mm.tobytes()
    assert [one.branches[n] for n in one.branch.ravel()] == [other.branches[n] for n in other.branch.ravel()]
    camera, balls = pack_camera(crowded.camera), pack_chain(crowded)
    x, y = (np.arange(where.camera.shape[1]) - camera[13]) / camera[12], np.empty(where.camera.shape[1])
    for k, centre in enumerate(balls[:, :3].tolist()):
        if abs(centre[0]) + abs(centre[1]) > 100.0:
            for row in range(where.camera.shape[0]):
                place_row(row, True, camera, x, y)
                low, high = glass_span(x, y, True, camera, balls, k)
                assert low >= high


@pytest.mark.parametrize("name", SCENES[:4])
def test_arrays_of_an_earlier_map_are_written_in_full(name: str) -> None:
    where = some_scene(name)
    fresh, old = build_ray_map(where), build_ray_map(where)
    old.plane_mm[:], old.status[:], old.branch[:] = -1.0, 77, 777
    again = build_ray_map(where, old)
    assert again.plane_mm is old.plane_mm
    assert again.plane_mm.tobytes() == fresh.plane_mm.tobytes()
    assert np.array_equal(again.status, fresh.status)
    assert np.array_equal(again.branch, fresh.branch)
    wide = Scene(camera_at(sensor_px=(40, 30)), where.bodies)
    assert build_ray_map(wide, old).status.shape == (30, 40)


def test_branch_numbers() -> None:
    """Ascending trips have the number of their set; others and overlong ones are unknown."""
    assert branch_number(0) == 0
    assert branch_number(0x1) == 1
    assert branch_number(0x13) == 0b101
    assert branch_number(0x1248) == 0b10001011
    unknown = {branch_number(trip) for trip in (0x21, 0x11, 0x343, -1)}
    assert unknown == {1 << 15}


def test_joined_spans() -> None:
    """Against a line of booleans."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        spans, line, count = np.empty((9, 2), np.int64), np.zeros(60, bool), 0
        for _ in range(8):
            low = int(rng.integers(0, 50))
            high = low + int(rng.integers(1, 10))
            line[low:high] = True
            count = insert_span(spans, count, low, high)
        covered = np.zeros(60, bool)
        for low, high in spans[:count]:
            assert not covered[low:high].any()
            covered[low:high] = True
        assert np.array_equal(covered, line)
        assert np.all(np.diff(spans[:count].ravel()) > 0)
