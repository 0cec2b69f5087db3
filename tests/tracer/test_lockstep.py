"""The lockstep form of the tracer against single rays: same branch, status and plane point for every pixel."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from benchmarks.reference import follow_pixel
from benchmarks.scenes import PAPER, aimed_pixels
from ground.rows import run_rows
from tests.loops import loop_over
from tests.slow_cases import slow_but
from tests.tracer.scenes import TILTED, ball, camera_at, random_bodies, random_camera, scene, shrunk
from tracer.camera import Lens, look_at
from tracer.kernels.branches import branch_number
from tracer.kernels.chain import (
    BALL,
    SKIP_LEFT_BEHIND,
    SKIP_LONE,
    SKIP_SILHOUETTES,
    glass_span,
    insert_span,
    place_row,
)
from tracer.kernels.rays import trace_pixel_tangents, trace_rows
from tracer.scene.scene import Scene
from tracer.strategies.lockstep import (
    ALL_SKIPS,
    SKIP_MIRRORED,
    find_mirrors,
    lone_discs,
    pack_chain,
    trace_lockstep,
)
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus, pack_camera, trace, world_of


def check(where: Scene) -> RayMap:
    """Compare the ray map with single rays; a pixel within 1e-9 of a rim may fall on either side of it."""
    made = build_ray_map(where)
    height, width = where.camera.shape
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    rays = trace(where, pixels)
    named = np.array([" ".join(names) for names in made.branches], dtype=object)[made.branch]
    traced = np.array([" ".join(rays.branches[key]) for key in rays.rays["key"].ravel().tolist()], dtype=object)
    other = (named != traced.reshape(named.shape)) | (made.status != rays.rays["status"])
    assert other.sum() <= 1, f"{other.sum()} pixels on another branch"
    good = made.recovered & ~other
    assert np.all(np.isnan(made.plane_mm[~made.recovered]))
    calm = good & (rays.rays["transmittance"] > 0.5) & (rays.rays["direction"][..., 2] < -0.1)
    apart = np.abs(made.plane_mm - rays.plane_mm)
    assert np.max(apart[calm], initial=0.0) <= 1e-9
    assert np.max(apart[good] / (1.0 + np.hypot(*rays.plane_mm[good].T)[:, None] ** 2), initial=0.0) <= 1e-6
    return made


@pytest.mark.parametrize("name", PAPER)
def test_paper_scenes(name: str) -> None:
    where = scene(name)
    where = where.with_camera(shrunk(where.camera, 8.0))
    assert choose(where).kind is Kind.LOCKSTEP
    assert np.mean(check(where).recovered) > 0.6


def test_nothing_aligned_and_lens_terms() -> None:
    where = scene(TILTED)
    check(where.with_camera(shrunk(where.camera, 8.0)))


@pytest.mark.parametrize("name", slow_but([*PAPER, TILTED], PAPER[0], PAPER[-1], TILTED))
def test_whole_sensors_against_fifty_digits(name: str) -> None:
    """Pixels of the full map: centre 1e-12 mm, rim 1e-11, last 1 % 1e-5; bent scenes as the single rays."""
    where = scene(name)
    made = build_ray_map(where)
    height, width = where.camera.shape
    pixels = np.rint(aimed_pixels(where, np.random.default_rng(11), 700)).astype(int)
    pixels = np.clip(pixels, 0, (width - 1, height - 1))
    aligned = name not in ("pyramid_500", TILTED)
    bounds = {0.9: 1e-12 if aligned else 1e-9, 0.99: 1e-11 if aligned else 1e-9, 1.0: 1e-5}
    counted = dict.fromkeys(bounds, 0)
    for u, v in pixels.tolist():
        seen = follow_pixel(where, float(u), float(v))
        assert made.branches[made.branch[v, u]] == seen.branch
        assert (made.status[v, u] == RayStatus.RECOVERED) == (seen.status == "recovered")
        if seen.status != "recovered" or abs(seen.direction[2]) < 0.05:
            continue
        place = next(limit for limit in bounds if seen.worst <= limit)
        x, y = made.plane_mm[v, u].tolist()
        assert mpmath.hypot(seen.x - mpf(x), seen.y - mpf(y)) <= bounds[place]
        counted[place] += 1
    assert min(counted.values()) >= 5


@pytest.mark.parametrize("distance", [1e3, 1e6])
def test_far_cameras(distance: float) -> None:
    """A unit in the last place of a slanted direction, at that distance, is what the map may be off."""
    height = 25.0 * distance
    camera = camera_at((0.0, 0.0, height), focal_px=4.0 / 3.0 * height, sensor_px=(96, 96))
    where = Scene(camera, (ball("near", 0.0, 0.0, 25.0, 25.0), ball("far", 0.0, 0.0, 75.0, 25.0)))
    made = build_ray_map(where)
    for u, v in np.random.default_rng(1).integers(0, 96, (150, 2)).tolist():
        seen = follow_pixel(where, float(u), float(v))
        if seen.worst > 0.9:
            continue
        assert made.branches[made.branch[v, u]] == seen.branch
        x, y = made.plane_mm[v, u].tolist()
        assert mpmath.hypot(seen.x - mpf(x), seen.y - mpf(y)) <= 10.0 * height * 2.0**-52


@loop_over("seed", range(24))
def test_random_scenes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies = random_bodies(rng, (1, 2, 3, 5)[seed % 4])
    check(Scene(shrunk(random_camera(rng, bodies), 4.0), tuple(bodies)))


def test_a_lower_sphere_met_first() -> None:
    """A slanted camera sees the large sphere before the small one whose centre stands higher."""
    bodies = (ball("large", 0.0, 0.0, 50.0, 50.0), ball("small", 55.0, 0.0, 60.0, 5.0, 1.5))
    where = Scene(camera_at((-600.0, 0.0, 300.0), (20.0, 0.0, 60.0), 600.0, (160, 120)), bodies)
    check(where)


def test_a_sphere_between_two_that_the_straight_view_would_have_met_before() -> None:
    """Rays turned back by the first ball pass one that is nearer to the camera, then one that is farther."""
    bodies = (
        ball("turns", 0.0, 0.0, 100.0, 10.0, 5.0),
        ball("between", -32.0, 0.0, 65.0, 12.0, 1.1),
        ball("last", -67.0, 0.0, 26.0, 15.0, 1.1),
        ball("aside", 0.0, 400.0, 100.0, 15.0, 1.1),  # as high as the first: the chain is not stacked
    )
    where = Scene(camera_at((-60.0, 0.0, 116.0), (0.0, 0.0, 100.0), 400.0, (240, 240)), bodies)
    made = check(where)
    assert ("turns", "between", "last") in {made.branches[n] for n in np.unique(made.branch).tolist()}


def test_numbers_written_as_integers() -> None:
    """An integer in a scene is the same number; it must not become another type in a compiled kernel."""
    camera = camera_at((0.0, 0.0, 300.0), focal_px=150.0, sensor_px=(40, 30))
    whole = Scene(camera, (ball("a", 0, 0, 50, 50, 2), ball("b", 70, 0, 20, 20)))
    floats = Scene(camera, (ball("a", 0.0, 0.0, 50.0, 50.0, 2.0), ball("b", 70.0, 0.0, 20.0, 20.0)))
    assert build_ray_map(whole).plane_mm.tobytes() == build_ray_map(floats).plane_mm.tobytes()


def test_no_bodies() -> None:
    where = Scene(camera_at((3.0, 4.0, 300.0), (1.0, 2.0, 0.0), 150.0, (40, 30), lens=Lens(k1=0.01)))
    made = build_ray_map(where)
    assert made.branches[0] == ()
    assert np.all(made.branch == 0)
    assert np.all(made.recovered)


def test_a_camera_that_sees_above_the_horizon() -> None:
    bodies = (ball("one", 0.0, 0.0, 30.0, 30.0), ball("two", 61.0, 5.0, 25.0, 25.0))
    where = Scene(camera_at((-200.0, 0.0, 40.0), (0.0, 0.0, 45.0), 100.0, (160, 120)), bodies)
    made = check(where)
    assert np.mean(made.status == RayStatus.MISSED_PLANE) > 0.3


@pytest.mark.parametrize("name", ["two_spheres_500", "pyramid_500"])
def test_same_bits_for_any_threads(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    where = scene(name)
    where = where.with_camera(shrunk(where.camera, 6.0))
    made = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        each = build_ray_map(where)
        made.append((each.plane_mm.tobytes(), each.status.tobytes(), each.branch.tobytes()))
    assert len(set(made)) == 1


@pytest.mark.parametrize("block", [1, 7, 24, 1000])
@pytest.mark.parametrize("threads", [1, 2])
def test_same_bits_for_any_block(block: int, threads: int) -> None:
    where = scene("pyramid_500")
    where = where.with_camera(shrunk(where.camera, 12.0))
    packed, world = pack_camera(where.camera), world_of(where)
    outcomes = []
    for rows, many in ((24, 1), (block, threads)):
        plane = np.empty((*where.camera.shape, 2))
        status, key = np.empty(where.camera.shape, np.uint8), np.empty(where.camera.shape, np.int64)

        def work(
            first: int, last: int, outputs: tuple[np.ndarray, np.ndarray, np.ndarray] = (plane, status, key)
        ) -> None:
            trace_rows(packed, world, first, last, *outputs)

        run_rows(work, where.camera.shape[0], block=rows, threads=many)
        outcomes.append((plane.tobytes(), status.tobytes(), key.tobytes()))
    assert outcomes[0] == outcomes[1]


def test_tangents_go_with_the_map() -> None:
    """The ray with derivatives is the same ray."""
    where = scene(TILTED)
    packed, world = pack_camera(where.camera), world_of(where)
    pixels = np.random.default_rng(4).uniform(0.0, 1800.0, (2000, 2))
    rays = trace(where, pixels)
    for (u, v), ray in zip(pixels.tolist(), rays.rays, strict=True):
        status, x, y, *_, passed, key, events = trace_pixel_tangents(u, v, packed, world)
        assert (status, key, events) == (ray["status"], ray["key"], ray["events"])
        if status == RayStatus.RECOVERED:
            assert passed == pytest.approx(float(ray["transmittance"]), abs=1e-9)
            far = 1.0 + float(ray["x_mm"]) ** 2 + float(ray["y_mm"]) ** 2
            assert max(abs(x - ray["x_mm"]), abs(y - ray["y_mm"])) <= 1e-9 * far


# What lockstep passes over without a look must change nothing: each skip off, each bound held.


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


def mirrored_scene(seed: int) -> Scene:
    """Spheres on both mirrors, on one, and in fours, under a straight camera; odd and even sensors."""
    rng = np.random.default_rng(seed)
    bodies, top = [], 0.0
    for level in range(3):
        radius = float(rng.uniform(4.0, 9.0))
        aside = [float(rng.uniform(radius, 20.0)) if rng.random() < 0.5 else 0.0 for _ in range(2)]
        places = {(sx * aside[0], sy * aside[1]) for sx in (-1.0, 1.0) for sy in (-1.0, 1.0)}
        if len(bodies) + len(places) > 8:
            break
        index = float(rng.uniform(1.02, 1.9))
        bodies += [
            ball(f"{level}{x}{y}", x + 0.0, y + 0.0, top + radius, radius, index) for x, y in sorted(places)
        ]
        top += 2.0 * radius
    size = (161, 120) if seed % 2 else (160, 121)
    return Scene(camera_at((0.0, 0.0, top + 200.0), focal_px=700.0, sensor_px=size), tuple(bodies))


@loop_over(
    "where",
    [*map(some_scene, SCENES), *map(random_lockstep_scene, range(8)), *map(mirrored_scene, range(8))],
)
def test_no_skip_changes_a_bit(where: Scene) -> None:
    whole = traced(where, 0)
    for skips in (ALL_SKIPS, SKIP_SILHOUETTES, SKIP_LEFT_BEHIND, SKIP_MIRRORED, SKIP_SILHOUETTES | SKIP_LONE):
        skipped = traced(where, skips)
        assert skipped[3] == whole[3]
        for one, other in zip(skipped[:3], whole[:3], strict=True):
            assert one.tobytes() == other.tobytes()


def test_only_exact_mirrors_count() -> None:
    for seed in range(8):
        mirrors = find_mirrors(mirrored_scene(seed))
        assert mirrors.in_x
        assert mirrors.in_y
    where = mirrored_scene(0)
    body = where.spheres[0]
    x, y, z = body.centre_mm
    nudged = replace(body, centre_mm=(float(np.nextafter(x, -99.0)), y, z))
    assert not find_mirrors(where.with_bodies((nudged, *where.bodies[1:]))).in_x
    camera = where.camera
    for other in (
        replace(camera, principal_px=(camera.principal_px[0] + 1e-9, camera.principal_px[1])),
        replace(camera, position_mm=(1e-300, 0.0, camera.position_mm[2])),
        replace(camera, rotation=look_at(camera.position_mm, (1e-6, 0.0, 0.0))),
        replace(camera, lens=Lens(p1=1e-9)),
    ):
        assert not find_mirrors(where.with_camera(other)).in_x


@loop_over("where", [some_scene("pyramid_500"), *map(random_lockstep_scene, range(40, 48))])
def test_nothing_is_met_behind_a_lone_disc(where: Scene) -> None:
    """Rays aimed at discs of `lone_discs`, most of them near its rim, against where `trace_ray` takes them."""
    camera, balls, rng = pack_camera(where.camera), pack_chain(where), np.random.default_rng(5)
    eye, names = camera[:3], [body.name for body in sorted(where.spheres, key=lambda each: -each.centre_mm[2])]
    for k in range(len(balls)):
        axis = balls[k, :3] - eye
        length, turn = np.linalg.norm(axis), rng.uniform(0.0, 2.0 * np.pi, (400, 1))
        aside, across = np.linalg.svd(axis[None] / length)[2][1:]
        b = np.sqrt(lone_discs(camera, balls)[k, 3]) * (1.0 - 10.0 ** rng.uniform(-6.0, 0.0, (400, 1)))
        sine = b / length
        ways = np.sqrt(1.0 - sine**2) * axis / length + sine * (np.cos(turn) * aside + np.sin(turn) * across)
        found = trace(where, where.camera.project(eye + length * ways))
        for key, sequence in found.branches.items():
            if sequence and sequence[0] == names[k]:
                assert len(sequence) == 1, (names[k], sequence, (found.rays["key"] == key).sum())


def test_a_lone_disc_is_nearly_the_silhouette_of_a_ball_beside_others() -> None:
    """Lower balls of a pyramid touch their neighbours; the top one has the gap between them below it."""
    where = some_scene("pyramid_500")
    camera, balls = pack_camera(where.camera), pack_chain(where)
    shares = np.sqrt(lone_discs(camera, balls)[:, 3] / balls[:, 3])
    assert 0.7 < shares[0] < 0.8
    assert min(shares[1:]) > 0.99


@loop_over("where", [*map(some_scene, SCENES), *map(random_lockstep_scene, range(8))])
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
    balls = np.zeros((8, BALL))
    balls[:, 2] = (9.0, 8.0, 7.0, 7.0, 5.0, 4.0, 3.0, 2.0)
    assert branch_number(0, False, balls) == 0
    assert branch_number(0x1, True, balls) == 1
    assert branch_number(0x13, True, balls) == 0b101
    assert branch_number(0x34, False, balls) == 0b1100
    assert branch_number(0x1248, True, balls) == 0b10001011
    unknown = {branch_number(trip, False, balls) for trip in (0x21, 0x11, 0x343, -1)}
    assert unknown | {branch_number(0x34, True, balls)} == {1 << 15}


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
