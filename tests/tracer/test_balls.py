"""Balls out of round: against 50 digits, the quadric of an ellipsoid, and differences of themselves."""

from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
import scipy
from mpmath import mpf
from numpy.typing import NDArray

from correction.grid import PlaneGrid
from correction.maps.correction_map import build_correction_map
from ground.errors import ConfigError
from tests.tracer.balls_reference import End, follow_balls
from tests.tracer.scenes import ball, camera_at
from tracer.bodies import Sphere
from tracer.errors import SceneError
from tracer.harmonics import COUNT, DEGREES, NAMES, of_ellipsoid, rotate_harmonics, to_polynomials, up_to, values
from tracer.light_sheet import LightSheet
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_priors, load_scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.ray_path import ray_path
from tracer.strategies.sensitivity import landings
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus, trace, trace_from

STATUS = {"recovered": RayStatus.RECOVERED, "tir": RayStatus.TIR, "missed": RayStatus.MISSED_PLANE}
CAMERA = camera_at((10.0, -15.0, 400.0), (0.0, 0.0, 10.0), 3000.0, (160, 120))
LEVEL = 0.05
Float64 = NDArray[np.float64]


def shape(rng: np.random.Generator, rms_um: float, degree: int = 6) -> tuple[float, ...]:
    found = rng.normal(0.0, rms_um / np.sqrt(up_to(degree)), COUNT)
    found[degree < DEGREES] = 0.0
    return tuple(found.tolist())


def drawn(rng: np.random.Generator) -> Scene:
    """Three balls, one of them a sphere and one perhaps of less index than the room; two nearly touch."""
    rms = float(rng.choice([1.0, 10.0, 30.0]))
    low = ball("low", *rng.uniform(-4.0, 4.0, 2), 15.3, 14.0, float(rng.choice([1.3, 1.5195, 1.9])))
    high = ball("high", *rng.uniform(-4.0, 4.0, 2), 60.0, 12.0, float(rng.choice([0.9, 1.5195, 1.9])))
    way = np.array(high.centre_mm) - np.array(low.centre_mm)
    place = np.array(low.centre_mm) + 20.4 * (way + rng.normal(0.0, 9.0, 3)) / np.linalg.norm(way)
    third = ball("round", 0.0, 0.0, 0.0, 6.0, 1.6)
    low, high = replace(low, shape_um=shape(rng, rms)), replace(high, shape_um=shape(rng, rms))
    room = ConstantMedium(1.0 if high.medium != ConstantMedium(0.9) else 1.2)
    if high.medium == ConstantMedium(0.9):
        high = replace(high, medium=ConstantMedium(1.0))
    try:
        bodies = (low, high, replace(third, centre_mm=tuple(place.tolist())))
        return Scene(CAMERA, bodies, ambient=room)
    except SceneError:
        return drawn(rng)


def aimed(rng: np.random.Generator, scene: Scene, count: int) -> Float64:
    """Directions to points in and around the balls, every third near the rim of one."""
    eye, ways = np.array(scene.camera.position_mm), []
    for k in range(count):
        one = scene.spheres[k % 3]
        centre = np.array(one.centre_mm)
        across = np.cross(eye - centre, rng.normal(size=3))
        reach = one.radius_mm * (rng.uniform(0.98, 1.0) if k % 3 == 0 else rng.uniform(0.0, 1.02))
        ways.append(centre + reach * across / np.linalg.norm(across) - eye)
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def unit(way: list[float]) -> tuple[mpf, mpf, mpf]:
    x, y, z = map(mpf, way)
    length = mpmath.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def judge(scenes: int, rays: int, seed: int) -> tuple[int, int]:
    """Follow random rays both ways; returns how many landed, and how many within 1 % of a rim."""
    rng, landed, grazing = np.random.default_rng(seed), 0, 0
    for _ in range(scenes):
        scene = drawn(rng)
        eye = scene.camera.position_mm
        ways = aimed(rng, scene, rays)
        traced = trace_from(scene, np.broadcast_to(np.array(eye), ways.shape), ways)
        for ray, way in zip(traced.rays, ways.tolist(), strict=True):
            end: End = follow_balls(scene, tuple(map(mpf, eye)), unit(way))
            assert RayStatus(ray["status"]) == STATUS[end.status], (scene, way)
            if end.status != "recovered":
                continue
            assert traced.branches[int(ray["key"])] == end.branch
            landed, grazing = landed + 1, grazing + (end.steepest > 0.99)
            level = 1.0 if abs(end.direction[2]) > LEVEL else 1e4
            bound = level * (1e-9 if end.steepest < 0.99 else 1e-5)
            off = mpmath.hypot(end.x - mpf(float(ray["x_mm"])), end.y - mpf(float(ray["y_mm"])))
            assert off < bound, (float(off), float(end.steepest), scene, way)
            assert abs(end.path - mpf(float(ray["path_mm"]))) < bound
            assert abs(end.passed - mpf(float(ray["transmittance"]))) < 1e-6
    return landed, grazing


@pytest.mark.slow
def test_random_rays_against_50_digits() -> None:
    landed, grazing = judge(scenes=2, rays=15, seed=3)
    assert landed > 15
    assert grazing > 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_many_random_rays_against_50_digits() -> None:
    landed, grazing = judge(scenes=60, rays=18, seed=4)
    assert landed > 500
    assert grazing > 60


def through_quadric(scene: Scene, semi_axes: Float64, rotation: Float64, ways: Float64) -> Float64:
    """Plane points (N, 2) behind one ellipsoid: stretched to the unit sphere, a quadratic, Snell's law."""
    (one,) = scene.spheres
    assert one.medium is not None
    stretch = rotation.T / semi_axes[:, None]
    n = one.medium.n(scene.wavelength_nm)
    at, d = np.array(scene.camera.position_mm) - np.array(one.centre_mm), ways
    points = np.broadcast_to(at, ways.shape)
    for entering in (True, False):
        w, e = points @ stretch.T, d @ stretch.T
        a, b, c = (np.sum(p * q, axis=1) for p, q in ((e, e), (w, e), (w, w)))
        root = np.sqrt(b * b - a * (c - 1.0))
        points = points + ((-b - root if entering else -b + root) / a)[:, None] * d
        normal = (points @ stretch.T) @ stretch
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) * (1.0 if entering else -1.0)
        ratio = 1.0 / n if entering else n
        cosine = -np.sum(normal * d, axis=1, keepdims=True)
        d = ratio * d + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal
    points = points + np.array(one.centre_mm)
    return np.asarray((points - points[:, 2:] / d[:, 2:] * d)[:, :2])


def rays_at_ellipsoids(balls: int, rays: int) -> tuple[int, float]:
    """How many rays went through, and the largest distance [mm] from where the quadric sends them."""
    rng, worst, count = np.random.default_rng(9), 0.0, 0
    camera = camera_at((0.0, 0.0, 300.0), (0.0, 0.0, 0.0), 5000.0, (64, 48))
    for _ in range(balls):
        semi_axes = 25.0 + rng.uniform(-0.03, 0.03, 3)
        rotation = scipy.spatial.transform.Rotation.random(random_state=rng).as_matrix()
        radius, shape_mm, _ = of_ellipsoid(semi_axes, rotation)
        one = Sphere("one", (0.0, 0.0, 40.0), radius, ConstantMedium(1.5195), (), tuple((1e3 * shape_mm).tolist()))
        scene = Scene(camera, (one,))
        radial, angle = 24.0 * np.sqrt(rng.uniform(0.0, 1.0, rays)), rng.uniform(0.0, 2.0 * np.pi, rays)
        ways = np.stack((radial * np.cos(angle), radial * np.sin(angle), np.full(rays, -260.0)), axis=1)
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        traced = trace_from(scene, np.broadcast_to(np.array([0.0, 0.0, 300.0]), ways.shape), ways)
        steep = np.abs(traced.rays["direction"][:, 2]) > 0.3
        off = np.linalg.norm(traced.plane_mm - through_quadric(scene, semi_axes, rotation, ways), axis=1)
        assert traced.recovered[steep].all()
        worst, count = max(worst, float(off[steep].max())), count + int(steep.sum())
    return count, worst


def test_an_ellipsoid_is_its_quadric() -> None:
    count, worst = rays_at_ellipsoids(balls=5, rays=10_000)
    assert count > 40_000
    assert worst < 2e-9


def test_the_example_is_a_scene_with_free_shapes() -> None:
    path = Path(__file__).resolve().parents[2] / "examples" / "uneven_balls.yaml"
    upper, lower = load_scene(path).spheres
    assert upper.shape_um
    assert lower.shape_um[NAMES.index("S43")] == 0.5
    assert load_priors(path).sphere("upper").shape_mm()[up_to(4) - 1] > 0.0


def test_only_spheres_go_by_the_fast_ways() -> None:
    """Lockstep and bundles know no shapes: a ball out of round traced there would be a sphere, silently."""
    one = ball("one", 0.0, 0.0, 45.0, 14.0)
    for several in ([one], [one, *(ball(f"b{k}", 30.0 * k, 30.0, 20.0, 9.0) for k in range(1, 12))]):
        scene = Scene(CAMERA, tuple(several))
        assert choose(scene).kind is (Kind.LOCKSTEP if len(several) == 1 else Kind.BUNDLES)
        uneven = scene.with_bodies([replace(one, shape_um=(1.0,) + (0.0,) * 44), *several[1:]])
        assert choose(uneven).kind is Kind.RAYS


def test_a_shape_of_nothing_is_a_sphere() -> None:
    """Zeros are the sphere to the bit; a height of 1e-12 mm goes by the other kernel and does nothing."""
    round_ones = Scene(CAMERA, (ball("a", 0, 0, 45.0, 14.0, 1.5195), ball("b", 2.0, 1.0, 15.0, 14.0, 1.5195)))
    zeros = round_ones.with_bodies([replace(one, shape_um=(0.0,) * COUNT) for one in round_ones.spheres])
    assert zeros == round_ones
    nothing = round_ones.with_bodies([replace(one, shape_um=(1e-9,) + (0.0,) * 44) for one in round_ones.spheres])
    pixels = np.random.default_rng(1).uniform((20.0, 10.0), (140.0, 110.0), (500, 2))
    one, other = trace(round_ones, pixels), trace(nothing, pixels)
    np.testing.assert_array_equal(one.rays["status"], other.rays["status"])
    assert np.nanmax(np.abs(one.plane_mm - other.plane_mm)) < 1e-10
    assert set(one.branches.values()) == set(other.branches.values())


def test_harmonics_are_what_they_are_said_to_be() -> None:
    """Their mean square is 1, degrees 0 and 1 are not among them, and turning a ball turns its surface."""
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mean = values(directions).T @ values(directions) / len(directions)
    assert np.abs(mean - np.eye(COUNT)).max() < 0.1
    np.testing.assert_allclose(values([0.0, 0.0, 1.0])[NAMES.index("C20")], np.sqrt(5.0))
    np.testing.assert_allclose(values([0.6, 0.8, 0.0])[NAMES.index("S22")], np.sqrt(15.0) * 0.48)
    assert np.linalg.matrix_rank(to_polynomials()) == COUNT
    one, turn = rng.normal(size=COUNT), scipy.spatial.transform.Rotation.random(random_state=rng).as_matrix()
    np.testing.assert_allclose(
        values(directions @ turn.T) @ rotate_harmonics(one, turn), values(directions) @ one, atol=1e-12
    )


@pytest.mark.slow
def test_derivatives_are_those_of_the_rays() -> None:
    """By the pixel, by where the ball stands, its radius and n, and by every harmonic."""
    rng = np.random.default_rng(7)
    low, high = ball("low", 1.0, 2.0, 15.3, 14.0, 1.5195), ball("high", 0.0, 0.0, 46.0, 14.0, 1.6)
    low, high = replace(low, shape_um=shape(rng, 20.0)), replace(high, shape_um=shape(rng, 20.0))
    scene = Scene(CAMERA, (low, high))
    pixels = rng.uniform((40.0, 20.0), (120.0, 100.0), (40, 2))
    here = landings(scene, pixels)
    assert landings(scene, pixels[:0]).rate.shape == (0, *here.rate.shape[1:])

    def moved(**changes: object) -> Scene:
        return scene.with_bodies([low, replace(high, **changes)])

    def check(rate: Float64, ahead: Scene, back: Scene, step: float) -> None:
        one, other = landings(ahead, pixels), landings(back, pixels)
        same = here.recovered & (one.key == here.key) & (other.key == here.key)
        assert same.sum() > 20
        numeric = (one.point_mm - other.point_mm) / (2.0 * step)
        size = 0.01 + np.abs(numeric).max(axis=1, keepdims=True)
        assert (np.abs(numeric - rate) < 1e-5 * size)[same].all()

    x, y, z = high.centre_mm
    step = 1e-5
    for axis, name in enumerate("xyz"):
        ends = [tuple(v + s * step * (k == axis) for k, v in enumerate((x, y, z))) for s in (1, -1)]
        check(here.columns([f"high.{name}"])[:, :, 0], *(moved(centre_mm=end) for end in ends), step)
    check(here.columns(["high.radius"])[:, :, 0], *(moved(radius_mm=14.0 + s * step) for s in (1, -1)), step)
    check(
        here.columns(["high.n"])[:, :, 0],
        *(moved(medium=ConstantMedium(1.6 + s * step)) for s in (1, -1)),
        step,
    )
    for term in range(COUNT):
        ends = []
        for s in (1, -1):
            heights = np.array(high.shape_um)
            heights[term] += s * 1e3 * step
            ends.append(moved(shape_um=tuple(heights.tolist())))
        check(here.columns([f"high.{NAMES[term]}"])[:, :, 0], *ends, step)
    for k in range(2):
        one, other = (landings(scene, pixels + s * step * np.eye(2)[k]) for s in (1, -1))
        same = here.recovered & (one.key == here.key) & (other.key == here.key)
        numeric = (one.point_mm - other.point_mm) / (2.0 * step)
        assert (np.abs(numeric - here.pixel_rate[:, :, k]) < 1e-5 * (0.01 + np.abs(numeric)))[same].all()


@pytest.mark.slow
def test_a_map_is_inverted_and_drawn() -> None:
    """Each node's pixel sees the node, by the tangents of rays; corners of a ray stand on the surface."""
    rng = np.random.default_rng(5)
    one = replace(ball("one", 0.0, 2.0, 7.0, 6.0, 1.6), shape_um=shape(rng, 10.0))
    camera = camera_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), 2600.0, (160, 120))
    scene = Scene(camera, (one,))
    ray_map = build_ray_map(scene)
    assert set(ray_map.branches) == {(), ("one",)}
    found = build_correction_map(scene, ray_map, PlaneGrid((-9.0, 7.0), 0.5, (29, 37)))
    behind = found.recovered & found.behind_glass
    assert behind.sum() > 40
    back = trace(scene, found.pixel[0][found.recovered]).plane_mm
    np.testing.assert_allclose(back, found.grid.nodes_mm()[found.recovered], rtol=0.0, atol=1e-9)
    corners = ray_path(scene, found.pixel[0][behind][0])
    assert len(corners) == 4
    np.testing.assert_allclose(one.distance_mm(corners[1:3]), 0.0, atol=1e-12)


def test_scene_files_hold_shapes(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    one = replace(ball("one", 0.0, 2.0, 27.0, 25.0, 1.6), shape_um=shape(rng, 5.0))
    scene = Scene(CAMERA, (one, ball("two", 0.0, 2.0, 90.0, 25.0, 1.6)))
    (tmp_path / "scene.yaml").write_text(dump_scene(scene))
    again = load_scene(tmp_path / "scene.yaml")
    assert again.bodies == scene.bodies
    assert again.content_hash() == scene.content_hash()
    assert again.content_hash() != scene.with_bodies([replace(one, shape_um=()), scene.bodies[1]]).content_hash()
    assert scene.with_bodies(scene.bodies[::-1]).content_hash() == scene.content_hash()


FILE = """
camera: {focal_px: 6000.0, sensor_px: [64, 48], position_mm: [0, 0, 500]}
bodies:
  - {name: front, kind: sphere, centre_mm: [0, 0, 30], radius_mm: 25.0, material: {n: 1.5}, MORE}
"""


def written(folder: Path, more: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(FILE.replace("MORE", more))
    return path


def test_an_ellipsoid_is_written_by_its_semi_axes(tmp_path: Path) -> None:
    path = written(tmp_path, "shape: {semi_axes_mm: [25.02, 25.0, 24.98], rotation_deg: [0, 90, 0]}")
    (one,) = load_scene(path).spheres
    ends = one.radius_towards_mm(np.eye(3))
    np.testing.assert_allclose(ends, [24.98, 25.0, 25.02], atol=1e-9)
    np.testing.assert_allclose(one.highest_mm, 30.0 + 25.02, atol=1e-9)
    np.testing.assert_allclose(one.lowest_mm, 30.0 - 25.02, atol=1e-9)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("shape: {harmonics_um: {C70: 1.0}}", "there is no C70"),
        ("shape: {harmonics_um: {C11: 1.0}}", "degree 1 moves the ball, which centre_mm does"),
        ("shape: {harmonics_um: {C20: 1.0}, semi_axes_mm: [25, 25, 25]}", "a ball has one shape"),
        ("shape: {harmonics_um: {C66: 2000.0}}", "may have dents"),
        ("shape: {harmonics_um: {C20: .nan}}", "finite"),
        ("shape: {semi_axes_mm: [26.0, 25.0, 24.0]}", "only balls nearly round"),
        ("shape: {semi_axes_mm: [20.2, 20.1, 20.0]}", "give their mean"),
        ("shape: {harmonics_um: {C20: 1.0}}, core: {radius_mm: 9.0, material: air}", "has no core here"),
        ("shape: {harmonics_um: {C20: 1.0}, rotation_deg: [0, 0, 1]}", "rotation_deg turns semi_axes_mm"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, more: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as refused:
        load_scene(written(tmp_path, more))
    assert all(problem.line == 4 for problem in refused.value.problems)


def test_balls_may_touch_where_they_are_thin_and_not_where_they_are_thick() -> None:
    """Contact is that of the surfaces, not of the spheres around them; the plane counts as well."""
    flat = (-20.0,) + (0.0,) * (COUNT - 1)  # shorter along z by 20 sqrt 5 um
    thin = 2e-2 * np.sqrt(5.0)
    high = replace(ball("high", 0.0, 0.0, 75.0 - 3.0 * thin, 25.0, 1.5), shape_um=flat)
    low = replace(ball("low", 0.0, 0.0, 25.0 - thin, 25.0, 1.5), shape_um=flat)
    Scene(CAMERA, (high, low))
    with pytest.raises(SceneError, match="overlap"):
        Scene(CAMERA, (replace(high, centre_mm=(0.0, 0.0, 75.0 - 3.0 * thin - 1e-4)), low))
    assert not Scene(CAMERA, (low,)).spheres_in_plane
    assert Scene(CAMERA, (replace(low, centre_mm=(0.0, 0.0, 25.0 - thin - 1e-4)),)).spheres_in_plane


def test_a_tilted_light_sheet_turns_the_shape() -> None:
    rng = np.random.default_rng(8)
    one = replace(ball("one", 0.0, 2.0, 30.0, 25.0, 1.6), shape_um=shape(rng, 50.0))
    scene = Scene(CAMERA, (one,), sheet=LightSheet(z_mm=0.3, tilt_x_deg=2.0, tilt_y_deg=-3.0))
    (moved,) = scene.in_light_sheet().spheres
    points = np.array(one.centre_mm) + rng.normal(size=(20, 3)) * 20.0
    assert scene.sheet is not None
    there = np.array([scene.sheet.place(tuple(point)) for point in points.tolist()])
    np.testing.assert_allclose(moved.distance_mm(there), one.distance_mm(points), atol=1e-10)
    shifted = one.moved(lambda at: (at[0] + 0.1, at[1], at[2] - 0.3))
    assert shifted.shape_um == one.shape_um
