"""The lockstep form of the tracer against single rays: same branch, status and plane point for every pixel."""

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from benchmarks.reference import follow_pixel
from benchmarks.scenes import PAPER, aimed_pixels
from ground.rows import run_rows
from tests.loops import loop_over
from tests.tracer.scenes import TILTED, ball, camera_at, random_bodies, random_camera, scene, shrunk
from tracer.camera import Lens
from tracer.kernels.rays import trace_pixel_tangents, trace_rows
from tracer.scene.scene import Scene
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


@pytest.mark.parametrize("name", [*PAPER, TILTED])
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
