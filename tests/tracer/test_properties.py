"""What must hold for any arrangement and any camera."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.scenes import PAPER, aimed_pixels
from tests.loops import loop_over
from tests.tracer.scenes import HOLLOW, TILTED, camera_at, random_scene, scene
from tracer.bodies import Sphere
from tracer.kernels.rays import trace_rays, trace_trails
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.trace import RayStatus, TraceResult, trace, trace_from

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


def moved(where: Scene, matrix: NDArray[np.float64], scale: float) -> Scene:
    """The bodies turned about z (or mirrored) and scaled; the camera out of the way."""
    bodies = []
    for body in where.spheres:
        x, y, z = (scale * (matrix @ np.array(body.centre_mm))).tolist()
        cores = tuple(replace(core, radius_mm=scale * core.radius_mm) for core in body.cores)
        bodies.append(replace(body, centre_mm=(x, y, z), radius_mm=scale * body.radius_mm, cores=cores))
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
@loop_over("name", ["two_spheres_500", "pyramid_500", TILTED, HOLLOW])
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
