"""What must hold for any arrangement and any camera."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.scenes import PAPER, aimed_pixels
from tests.loops import loop_over
from tests.tracer.scenes import NO_TRAIL, TILTED, ball, camera_at, flat, random_scene, scene
from tracer.bodies import Sphere
from tracer.kernels.rays import trace_rays, trace_to_plane, trace_trails
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import RayStatus, TraceResult, trace, trace_from, world_of

seeds = st.integers(0, 2**32 - 1)
some = settings(max_examples=40, deadline=None)


def rays_of(where: Scene, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return aimed_pixels(where, rng, count) if where.spheres else rng.uniform(0.0, 480.0, (count, 2))


def check_rays(result: TraceResult) -> None:
    """No NaN called recovered, nothing else called recovered, energy within bounds."""
    rays, good = result.rays, result.recovered
    assert np.all(np.isin(rays["status"], list(RayStatus)))
    for name in ("x_mm", "y_mm", "path_mm"):
        assert np.all(np.isfinite(rays[name][good]))
        assert np.all(np.isnan(rays[name][~good]))
    assert np.all((rays["transmittance"] >= 0.0) & (rays["transmittance"] <= 1.0))
    assert np.all(rays["transmittance"][~good] == 0.0)
    assert np.all(rays["path_mm"][good] > 0.0)
    assert set(np.unique(rays["key"]).tolist()) == set(result.branches)
    assert np.all((rays["events"] > 0) == (rays["key"] != 1))


def test_a_million_random_rays_on_random_scenes() -> None:
    rng = np.random.default_rng(0)
    statuses = np.zeros(len(RayStatus), dtype=np.int64)
    for number in range(100):
        where = random_scene(rng, most=12, cores=number % 2 == 1)
        result = trace(where, rays_of(where, rng, 10_000))
        check_rays(result)
        statuses += np.bincount(result.rays["status"], minlength=len(statuses))
    assert statuses.sum() == 1_000_000
    for status in (RayStatus.RECOVERED, RayStatus.TIR, RayStatus.MISSED_PLANE):
        assert statuses[status] > 1000  # each fate was met


@some
@given(seed=seeds)
def test_random_starts_and_directions(seed: int) -> None:
    """Rays from anywhere outside the bodies, upwards as well."""
    rng = np.random.default_rng(seed)
    where = random_scene(rng)
    starts = rng.uniform((-100.0, -100.0, 0.0), (100.0, 100.0, 150.0), (2000, 3))
    for body in where.bodies:
        starts = starts[np.linalg.norm(starts - np.array(body.centre_mm), axis=1) > body.radius_mm]
    ways = rng.normal(size=starts.shape)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    check_rays(trace_from(where, starts, ways))


def leaves_at(
    where: Scene, start: NDArray[np.float64], way: NDArray[np.float64]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Point and direction of the last straight piece, and the transmittance."""
    result = flat(trace_to_plane(tuple(start.tolist()), tuple(way.tolist()), world_of(where), NO_TRAIL))
    return np.array(result[1:4]), np.array(result[4:7]), float(result[8])


@some
@given(seed=seeds)
def test_reciprocity(seed: int) -> None:
    """The ray sent back from the plane point passes the pinhole, with the same losses and branch."""
    rng = np.random.default_rng(seed)
    where = random_scene(rng)
    pixels = rays_of(where, rng, 200)
    result = trace(where, pixels)
    eye = np.array(where.camera.position_mm)
    # Grazing rays and level ones multiply rounding; the reference tests judge those.
    chosen = result.recovered & (result.rays["transmittance"] > 0.7) & (result.rays["direction"][:, 2] < -0.1)
    for index in np.flatnonzero(chosen)[:60]:
        ray = result.rays[index]
        start = np.array([ray["x_mm"], ray["y_mm"], 0.0])
        point, way, passed = leaves_at(where, start, -ray["direction"])
        back = trace_from(where, start, -ray["direction"])
        assert passed == pytest.approx(float(ray["transmittance"]), abs=1e-7)
        assert tuple(reversed(back.branches[int(back.rays["key"])])) == result.branches[int(ray["key"])]
        assert np.linalg.norm(np.cross(eye - point, way)) <= 1e-7 * np.linalg.norm(eye)


@some
@given(seed=seeds)
def test_the_order_of_the_bodies_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    where = random_scene(rng, most=5)
    camera = replace(
        where.camera, sensor_px=(48, 36), principal_px=(23.5, 17.5), focal_px=where.camera.focal_px / 13.0
    )
    where = where.with_camera(camera)
    shuffled = where.with_bodies([where.bodies[i] for i in rng.permutation(len(where.bodies))])
    assert shuffled.content_hash() == where.content_hash()
    one, two = build_ray_map(where), build_ray_map(shuffled)
    assert one.plane_mm.tobytes() == two.plane_mm.tobytes()
    assert one.status.tobytes() == two.status.tobytes()
    assert one.branch.tobytes() == two.branch.tobytes()
    assert one.branches == two.branches


@some
@given(seed=seeds)
def test_angular_momentum_about_a_sphere_is_kept(seed: int) -> None:
    """Bouguer: (p - c) x d is the same before and after; n b is the skew invariant."""
    rng = np.random.default_rng(seed)
    radius, n = 10.0 ** rng.uniform(-1.0, 2.0), 10.0 ** rng.uniform(-12.0, 0.5) + 1.0
    where = Scene(camera_at((0.0, 0.0, 900.0)), (ball("one", 0.0, 0.0, 250.0, radius, n),))
    table = where.sphere_table()
    for _ in range(20):
        way = rng.normal(size=3)
        way[2] = abs(
            way[2]
        )  # upwards: `trace_ray` then returns the foot point of the last piece, not a plane point
        way /= np.linalg.norm(way)
        side = np.cross(way, rng.normal(size=3))
        side /= np.linalg.norm(side)
        aside = radius * (1.0 - 10.0 ** rng.uniform(-12.0, 0.0))
        # From the foot point's neighbourhood: the start is exact to an ulp of the radius, not of the distance.
        start = np.array([0.0, 0.0, 250.0]) + aside * side - 1.5 * radius * way
        result = flat(trace_to_plane(tuple(start.tolist()), tuple(way.tolist()), world_of(where), NO_TRAIL))
        if result[-1] != 1 or result[6] < 0.0:
            continue
        before = np.cross(start - table[0, :3], way)
        after = np.cross(np.array(result[1:4]) - table[0, :3], np.array(result[4:7]))
        rounding = np.spacing(250.0) + 8.0 * np.spacing(radius)  # the point is returned in world coordinates
        assert np.max(np.abs(after - before)) <= 4.0 * rounding


@some
@given(seed=seeds)
def test_the_skewness_about_a_row_is_kept(seed: int) -> None:
    """Through any number of spheres on one axis, x dy - y dx stays what it was."""
    rng = np.random.default_rng(seed)
    bodies, top = [], 0.0
    for index in range(rng.integers(1, 6)):
        radius = float(10.0 ** rng.uniform(0.0, 1.5))
        top += radius + float(rng.choice([0.0, rng.uniform(0.0, 10.0)]))
        bodies.append(ball(f"b{index}", 0.0, 0.0, top, radius, float(rng.uniform(1.0, 2.2))))
        top += radius
    where = Scene(camera_at((0.0, 0.0, top + 100.0)), tuple(bodies))
    starts = np.column_stack((rng.normal(size=(300, 2)) * 3.0, np.full(300, top + 50.0)))
    ways = np.column_stack((rng.normal(size=(300, 2)) * 0.1, np.full(300, -1.0)))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    result = trace_from(where, starts, ways)
    good = result.recovered
    plane, last = result.plane_mm[good], result.rays["direction"][good]
    before = (starts[:, 0] * ways[:, 1] - starts[:, 1] * ways[:, 0])[good]
    after = plane[:, 0] * last[:, 1] - plane[:, 1] * last[:, 0]
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-12 * (1.0 + np.abs(plane).max(initial=0.0)))


def moved(where: Scene, matrix: NDArray[np.float64], scale: float) -> Scene:
    """The bodies turned about z (or mirrored) and scaled; the camera out of the way."""
    bodies = []
    for body in where.spheres:
        x, y, z = (scale * (matrix @ np.array(body.centre_mm))).tolist()
        bodies.append(replace(body, centre_mm=(x, y, z), radius_mm=scale * body.radius_mm))
    return replace(where, camera=camera_at((0.0, 0.0, 1e7)), bodies=tuple(bodies))


@loop_over(
    "matrix, scale, exact",
    [
        (np.eye(3), 2.0**10, True),
        (np.eye(3), 2.0**-10, True),
        (np.diag((-1.0, 1.0, 1.0)), 1.0, True),
        (np.diag((-1.0, -1.0, 1.0)), 1.0, True),
        (np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 1.0, False),
        (np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]), 1.0, False),
        (np.eye(3), 3.7, False),
    ],
)
@loop_over("name", ["two_spheres_500", "pyramid_500", TILTED])
def test_moved_scenes(name: str, matrix: NDArray[np.float64], scale: float, exact: bool) -> None:
    """Turned, mirrored and scaled scenes give turned, mirrored and scaled maps; bits where arithmetic allows."""
    where = scene(name)
    smaller = [replace(body, radius_mm=body.radius_mm - 1e-6) for body in where.spheres]  # overlaps scale as well
    where = where.with_bodies(smaller)
    ways = where.camera.directions(aimed_pixels(where, np.random.default_rng(9), 4000))
    eye = np.array(where.camera.position_mm)
    here = trace_from(where, eye, ways)
    there = trace_from(moved(where, matrix, scale), scale * (matrix @ eye), ways @ matrix.T)
    wanted = scale * here.plane_mm @ matrix[:2, :2].T
    calm = here.recovered & (here.rays["transmittance"] > 0.5) & (here.rays["direction"][:, 2] < -0.1)
    if exact:
        np.testing.assert_array_equal(there.plane_mm, wanted)
        np.testing.assert_array_equal(there.rays["status"], here.rays["status"])
    else:
        assert np.mean(there.rays["status"] != here.rays["status"]) <= 1e-3  # rounding at rims
        np.testing.assert_allclose(there.plane_mm[calm], wanted[calm], rtol=0.0, atol=1e-9 * scale)


def test_bubbles_reflect_totally_from_the_critical_angle_on() -> None:
    water = ConstantMedium(1.333)
    where = Scene(camera_at((0.0, 0.0, 400.0)), (ball("bubble", 0.0, 0.0, 30.0, 20.0, 1.0),), ambient=water)
    shares = np.array([0.0, 0.5, 0.75, 1.0 / 1.333 - 1e-9, 1.0 / 1.333 + 1e-9, 0.8, 0.99, 1.0 - 1e-9, 1.0 + 1e-9])
    starts = np.column_stack((20.0 * shares, np.zeros((len(shares), 1)), np.full(len(shares), 200.0)))
    result = trace_from(where, starts, np.tile((0.0, 0.0, -1.0), (len(shares), 1)))
    assert result.rays["status"].tolist()[:3] == [RayStatus.RECOVERED] * 3
    assert result.rays["status"].tolist()[4:8] == [RayStatus.TIR] * 4
    assert result.rays["events"].tolist()[8] == 0
    # Just below the critical angle the ray turns by nearly 2 (90 deg - 48.6 deg) and still gets through.
    assert result.rays["status"].tolist()[3] == RayStatus.RECOVERED
    assert 0.0 < result.rays["transmittance"][3] < 0.01


@some
@given(seed=seeds)
def test_an_opaque_sphere_stops_exactly_the_rays_that_crossed_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    where = random_scene(rng)
    if not where.bodies:
        return
    dark = where.bodies[rng.integers(len(where.bodies))]
    assert isinstance(dark, Sphere)
    bodies = [replace(body, medium=None) if body is dark else body for body in where.bodies]
    pixels = rays_of(where, rng, 2000)
    clear, shaded = trace(where, pixels), trace(where.with_bodies(bodies), pixels)
    crossed = np.array([dark.name in clear.branches[key] for key in clear.rays["key"].tolist()])
    assert np.all(shaded.rays["status"][crossed] == RayStatus.BLOCKED)
    assert shaded.rays[~crossed]["x_mm"].tobytes() == clear.rays[~crossed]["x_mm"].tobytes()
    np.testing.assert_array_equal(shaded.rays["status"][~crossed], clear.rays["status"][~crossed])


def test_one_ray_is_traced_by_the_kernel_of_many() -> None:
    """What numba would compile anew for: a broadcast origin of one ray, directions that may not be written."""
    where = scene(PAPER[0])
    pixels = np.array([[700.0, 900.0], [20.0, 20.0]])
    many = trace(where, pixels)
    directions = where.camera.directions(pixels[:1])
    directions.flags.writeable = False
    for one in (trace(where, pixels[:1]), trace_from(where, where.camera.position_mm, directions)):
        assert one.rays[0] == many.rays[0]
    for traced in (trace_rays, trace_trails):
        assert all(kind.mutable for kinds in traced.signatures for kind in kinds[:2])
