"""Spheres that reach through the plane, against roots of quadratics in float64 and 50-digit optics."""

from collections.abc import Callable
from dataclasses import replace

import mpmath
import numba
import numpy as np
import pytest
from mpmath import mpf

from benchmarks.reference import follow_pixel
from benchmarks.scenes import aimed_pixels
from tests.loops import loop_over
from tests.tracer.balls_reference import follow_balls
from tests.tracer.scenes import ball, camera_at, hollowed, random_camera
from tests.tracer.second_formulation import numbered, second
from tracer.bodies import Body, Mesh, Rod, Sphere, Window
from tracer.errors import SceneError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import TargetPose, landings
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus, trace

GRAZE = 1e-9  # of R^2, and of R to the plane
STATUS = {
    "recovered": RayStatus.RECOVERED,
    "tir": RayStatus.TIR,
    "missed": RayStatus.MISSED_PLANE,
    "glass": RayStatus.IN_GLASS,
}


def crossing_scene(rng: np.random.Generator, cores: bool = False, most: int = 10) -> Scene:
    """Random spheres of different size, some in contact, whose centres lie on both sides of the plane or in it."""
    bodies: list[Body] = []
    wanted, bubbles = int(rng.integers(1, most + 1)), bool(rng.random() < 0.25)
    while len(bodies) < wanted:
        radius = float(10.0 ** rng.uniform(0.3, 1.5))
        n = float(
            rng.choice([1.0, 1.1, 1.33, 1.53] if bubbles else [1.0, 1.0 + 1e-6, 1.023, 1.33, 1.53, 1.9, 2.6])
        )
        centre = np.array([*rng.uniform(-45.0, 45.0, 2), rng.uniform(-1.2, 2.5) * radius])
        kind = rng.integers(5)
        if kind == 0:
            centre[2] = float(rng.choice([0.0, radius, 1e-3 - radius, radius - 1e-3, -radius]))
        elif kind == 1 and bodies:
            other = bodies[rng.integers(len(bodies))]
            way = rng.normal(size=3)
            reach = other.radius_mm + radius
            centre = np.array(other.centre_mm) + reach * way / np.linalg.norm(way)
        gaps = [np.linalg.norm(centre - np.array(b.centre_mm)) - b.radius_mm - radius for b in bodies]
        if all(gap > -1e-9 for gap in gaps):
            bodies.append(Sphere(f"b{len(bodies)}", tuple(map(float, centre)), radius, ConstantMedium(n)))
    if cores:
        bodies = hollowed(rng, bodies)
    return Scene(random_camera(rng, bodies), tuple(bodies), ambient=ConstantMedium(1.333 if bubbles else 1.0))


def pixels_of(where: Scene, rng: np.random.Generator, count: int) -> np.ndarray:
    """Pixels of a scene, half of them aimed at spheres."""
    height, width = where.camera.shape
    if where.spheres:
        return aimed_pixels(where, rng, count)
    return rng.uniform((-0.5, -0.5), (width - 0.5, height - 0.5), (count, 2))


def compare(count: int, seed: int, of_a_scene: int, second: Callable[..., None]) -> dict[str, float]:
    """Rays of each fate, rays on another way, and the largest difference of calm ones; half have cores."""
    rng, made = np.random.default_rng(seed), 0
    found = dict.fromkeys(("wrong", "worst_mm", "gas", "glass", "before", "unsure"), 0.0)
    while made < count:
        where = crossing_scene(rng, cores=made % (2 * of_a_scene) == 0)
        pixels = pixels_of(where, rng, of_a_scene)
        result, out = trace(where, pixels), np.empty((of_a_scene, 6))
        rays = result.rays
        second(np.array(where.camera.position_mm), where.camera.directions(pixels), where.sphere_table(), out)
        clear = (out[:, 3] > GRAZE) & (np.abs(out[:, 4]) > GRAZE)
        fate = np.where(out[:, 5] < 0.0, RayStatus.RECOVERED, RayStatus.MISSED_PLANE)
        fate = np.select([out[:, 2] == -1, out[:, 2] == -2], [RayStatus.TIR, RayStatus.IN_GLASS], fate)
        same = (fate == rays["status"]) & ((out[:, 2] < 0) | (out[:, 2] == numbered(where, result)))
        found["wrong"] += int((clear & ~same).sum())
        found["unsure"] += int((~clear).sum())
        calm = clear & same & (fate == RayStatus.RECOVERED) & (out[:, 4] > 0.3) & (out[:, 5] < -0.2)
        apart = np.hypot(out[calm, 0] - rays["x_mm"][calm], out[calm, 1] - rays["y_mm"][calm])
        found["worst_mm"] = max(found["worst_mm"], float(apart.max(initial=0.0)))
        found["gas"] += int((fate == RayStatus.RECOVERED).sum())
        found["glass"] += int((fate == RayStatus.IN_GLASS).sum())
        points = np.column_stack((out[:, :2], np.zeros(len(out))))
        near = [one.distance_mm(points) < 0.5 * one.radius_mm for one in where.spheres_in_plane]
        found["before"] += int((np.any(near, axis=0) & (fate == RayStatus.RECOVERED)).sum() if near else 0)
        made += of_a_scene
    return found


def check(count: int, seed: int, of_a_scene: int, second: Callable[..., None] = second) -> None:
    found = compare(count, seed, of_a_scene, second)
    print(found)
    assert found["wrong"] == 0
    assert found["worst_mm"] < 1e-6  # what a quadratic leaves of a far camera's digits
    assert min(found["gas"], found["glass"], found["before"]) > 0.02 * count  # of each some
    assert found["unsure"] < 0.02 * count


def test_four_thousand_rays() -> None:
    check(4_000, 0, 250)


@pytest.mark.slow
def test_two_million_rays() -> None:
    check(2_000_000, 1, 10_000, numba.njit(error_model="numpy")(second))


def at_fifty_digits(count: int, seed: int) -> int:
    """Compare rays, with cores or without, by status, branch and plane point; return how many lie in the gas."""
    rng, landed = np.random.default_rng(seed), 0
    for number in range(-(-count // 25)):
        where = crossing_scene(rng, cores=number % 2 == 1, most=6)
        pixels = pixels_of(where, rng, 25)
        result = trace(where, pixels)
        for (u, v), ray in zip(pixels.tolist(), result.rays, strict=True):
            seen = follow_pixel(where, u, v)
            assert ray["status"] == STATUS[seen.status]
            assert result.branches[int(ray["key"])] == seen.branch
            if seen.status == "recovered" and seen.worst < 0.99 and seen.direction[2] < -0.05:
                error = mpmath.hypot(seen.x - mpf(float(ray["x_mm"])), seen.y - mpf(float(ray["y_mm"])))
                assert error < 1e-9
                assert ray["path_mm"] == pytest.approx(float(seen.path), rel=1e-12)
                landed += 1
    return landed


def test_rays_at_fifty_digits() -> None:
    assert at_fifty_digits(500, 3) > 100


@pytest.mark.slow
def test_many_rays_at_fifty_digits() -> None:
    assert at_fifty_digits(100_000, 4) > 20_000


@loop_over("seed", range(6))
def test_a_sensor_has_the_bits_of_its_rays(seed: int) -> None:
    """Bundles, which trace whole sensors, end each ray as `trace` does; opaque spheres among them."""
    rng = np.random.default_rng(seed)
    where = crossing_scene(rng, most=30 if seed % 2 else 6)
    where = where.with_bodies(
        [replace(one, medium=None) if k % 5 == 4 else one for k, one in enumerate(where.spheres)]
    )
    if not where.spheres_in_plane:
        where = where.with_bodies([*where.bodies, ball("cut", 200.0, 0.0, 0.0, 30.0)])
    where = where.with_camera(where.camera.with_width(160))
    assert choose(where).kind is Kind.BUNDLES
    made = build_ray_map(where)
    height, width = where.camera.shape
    alone = trace(where, np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1))
    np.testing.assert_array_equal(alone.rays["status"], made.status)
    near = np.abs(alone.plane_mm).max(axis=-1) < 1e3  # beyond, level rays differ by their conditioning
    np.testing.assert_allclose(made.plane_mm[near], alone.plane_mm[near], rtol=0.0, atol=1e-8)
    names = [alone.branches[key] for key in alone.rays["key"].ravel().tolist()]
    assert names == [made.branches[number] for number in made.branch.ravel().tolist()]


VIEW = camera_at((60.0, -30.0, 400.0), (0.0, 0.0, 0.0), 900.0, (160, 160))


def test_spheres_behind_the_plane_change_nothing() -> None:
    front = ball("front", 3.0, 2.0, 12.0, 20.0), ball("beside", 45.0, 0.0, -2.0, 11.0)
    behind = ball("behind", 3.0, 2.0, -60.0, 30.0), ball("touching", -40.0, 0.0, -25.0, 25.0, None)
    plain, more = Scene(VIEW, front), Scene(VIEW, (*front, *behind))
    assert more.content_hash() == plain.content_hash()
    assert more.sphere_table().tolist() == plain.sphere_table().tolist()
    one, other = build_ray_map(plain), build_ray_map(more)
    np.testing.assert_array_equal(one.plane_mm, other.plane_mm)
    np.testing.assert_array_equal(one.branch, other.branch)


def test_a_micrometre_through_the_plane_is_a_disc() -> None:
    """A ball that grazes the plane fills a disc of radius sqrt(2 R h), whatever side its centre is on."""
    radius = np.sqrt(2.0 * 20.0 * 1e-3)
    behind = Scene(camera_at(focal_px=1e5, sensor_px=(120, 120)), (ball("ball", 0.0, 0.0, 1e-3 - 20.0, 20.0),))
    glass = build_ray_map(behind).status == RayStatus.IN_GLASS
    assert glass.sum() * 5e-3**2 == pytest.approx(np.pi * radius**2, rel=0.03)
    before = Scene(camera_at(focal_px=2e4, sensor_px=(160, 160)), (ball("ball", 0.0, 0.0, 20.0 - 1e-3, 20.0),))
    made = build_ray_map(before)
    assert np.hypot(*made.plane_mm[made.recovered].T).min() == pytest.approx(radius, rel=0.03)  # through a lens
    assert (made.status == RayStatus.IN_GLASS).sum() > 100
    touching = build_ray_map(before.with_bodies([ball("ball", 0.0, 0.0, 20.0 - 5e-7, 20.0)]))
    assert touching.recovered.all()


def test_uneven_balls_at_fifty_digits() -> None:
    """Balls out of round end rays where their own surface lies."""
    rng = np.random.default_rng(2)
    shape = tuple((rng.normal(size=45) * 20.0).tolist())
    uneven = replace(ball("uneven", 2.0, 1.0, 4.0, 20.0), shape_um=shape)
    where = Scene(VIEW, (uneven, ball("round", 20.0, -40.0, -3.0, 22.0)))
    pixels = aimed_pixels(where, rng, 40)
    rays, ways = trace(where, pixels).rays, where.camera.directions(pixels)
    for ray, way in zip(rays, ways.tolist(), strict=True):
        end = follow_balls(where, tuple(map(mpf, VIEW.position_mm)), tuple(map(mpf, way)))
        assert ray["status"] == STATUS[end.status]
        if end.status == "recovered":
            assert mpmath.hypot(end.x - mpf(float(ray["x_mm"])), end.y - mpf(float(ray["y_mm"]))) < 1e-7
    assert (rays["status"] == RayStatus.IN_GLASS).sum() > 5
    assert (rays["events"][rays["status"] == RayStatus.RECOVERED] == 0).sum() > 5


def test_derivatives_are_those_of_rays_that_end_in_the_gas() -> None:
    camera = camera_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), 900.0, (160, 160))
    where = Scene(camera, (ball("low", 3.0, -4.0, 2.0, 20.0), ball("high", 19.0, 9.0, 40.0, 18.0)))
    pixels = aimed_pixels(where, np.random.default_rng(3), 1000)
    found = landings(where, pixels)
    np.testing.assert_array_equal(found.status, trace(where, pixels).rays["status"])
    assert set(found.status) >= {RayStatus.RECOVERED, RayStatus.IN_GLASS}
    step, column = 1e-5, found.names.index("high.x")
    low, high = where.spheres
    moved = [
        trace(where.with_bodies([low, replace(high, centre_mm=(19.0 + off, 9.0, 40.0))]), pixels).plane_mm
        for off in (-step, step)
    ]
    slope = (moved[1] - moved[0]) / (2.0 * step)
    good = np.isfinite(slope).all(axis=-1) & found.recovered & (np.abs(slope).max(axis=-1) < 20.0)
    assert (np.abs(slope[good]).max(axis=-1) > 1e-3).sum() > 20
    np.testing.assert_allclose(found.rate[good][:, :, column], slope[good], atol=1e-4)


def test_a_target_behind_all_spheres_is_seen_through_them() -> None:
    """The plane does not stop rays that are asked for another one."""
    where = Scene(VIEW, (ball("cut", 0.0, 0.0, 5.0, 20.0),))
    pixels = aimed_pixels(where, np.random.default_rng(5), 200)
    board = landings(where, pixels, TargetPose((0.0, 0.0, -30.0)))
    lifted = where.with_camera(replace(VIEW, position_mm=(60.0, -30.0, 430.0)))
    lifted = lifted.with_bodies([ball("cut", 0.0, 0.0, 35.0, 20.0)])
    np.testing.assert_allclose(board.point_mm, trace(lifted, pixels).plane_mm, atol=1e-9)


def test_what_cannot_cross_is_refused_in_one_sentence() -> None:
    glass = ConstantMedium(1.5)
    for body in (
        Rod("post", (0.0, 0.0, -10.0), (0.0, 0.0, 10.0), 3.0),
        Window("pane", (0.0, 0.0, 2.0), (0.0, 0.0, 1.0), 5.0, 30.0, glass),
    ):
        with pytest.raises(SceneError, match=f"a {body.kind} may touch z = 0, not cross it"):
            Scene(VIEW, (body,))
    assert not Mesh.may_cross_plane.fget(object())  # type: ignore[attr-defined]
    with pytest.raises(SceneError, match="the camera is inside body 'far too large'"):
        Scene(VIEW, (ball("far too large", 0.0, 0.0, 0.0, 500.0),))
