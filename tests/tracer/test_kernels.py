"""Kernels one by one: derivatives against 50 digits, rods against a minimiser, losses by the textbook."""

import mpmath
import numpy as np
import pytest
from mpmath import mpf
from scipy.optimize import minimize_scalar

from benchmarks.reference import follow, pixel_direction
from benchmarks.scenes import PAPER, aimed_pixels
from tests.slow_cases import slow_but
from tests.tracer.scenes import HOLLOW, TILTED, ball, camera_at, random_scene, scene
from tracer.bodies import Rod, Sphere
from tracer.bodies.rod import meets_rod
from tracer.camera import Lens
from tracer.kernels.rays import (
    trace_pixel_tangents,
)
from tracer.kernels.sphere import transmittance
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, pack_camera, trace, trace_from, world_of


def exact_derivatives(where: Scene, u: float, v: float) -> np.ndarray:
    """d(x, y)/d(u, v) by central differences at 50 digits: the step's error is of order 1e-36."""
    eye = tuple(mpf(x) for x in where.camera.position_mm)
    step = mpf(10) ** -18
    columns = []
    for du, dv in ((step, 0), (0, step)):
        ahead = follow(where, eye, pixel_direction(where.camera, mpf(u) + du, mpf(v) + dv))
        behind = follow(where, eye, pixel_direction(where.camera, mpf(u) - du, mpf(v) - dv))
        columns.append([float((ahead.x - behind.x) / (2 * step)), float((ahead.y - behind.y) / (2 * step))])
    return np.array(columns).T


@pytest.mark.parametrize("name", slow_but([*PAPER, TILTED, HOLLOW], PAPER[-1], TILTED, HOLLOW))
def test_analytic_derivatives(name: str) -> None:
    """Lens terms, direction, every turn and the landing: 1e-8 of the matrix, rims excepted."""
    where = scene(name)
    camera, world = pack_camera(where.camera), world_of(where)
    eye = tuple(mpf(x) for x in where.camera.position_mm)
    compared = glass = 0
    for u, v in aimed_pixels(where, np.random.default_rng(5), 160).tolist():
        status, _, _, xu, xv, yu, yv, _, _, events = trace_pixel_tangents(u, v, camera, world)
        seen = follow(where, eye, pixel_direction(where.camera, u, v))
        if status != RayStatus.RECOVERED or seen.worst > 0.99 or abs(seen.direction[2]) < 0.05:
            continue
        compared += 1
        glass += events > 0
        exact = exact_derivatives(where, u, v)
        error = np.abs(np.array([[xu, xv], [yu, yv]]) - exact).max() / np.abs(exact).max()
        assert error <= 1e-8
    assert compared > 60
    assert glass > 20


def test_lens_terms_alone() -> None:
    """Each term by itself, without glass: derivatives and ideal coordinates."""
    for term in ("k1", "k2", "k3", "p1", "p2"):
        where = Scene(
            camera_at((10.0, -20.0, 300.0), (5.0, 5.0, 0.0), 2000.0, roll_rad=0.2, lens=Lens(**{term: 0.1}))
        )
        packed = pack_camera(where.camera)
        for u, v in ((0.0, 0.0), (2000.0, 100.0), (1007.5, 1007.5), (1500.0, 1900.0)):
            status, x, y, xu, xv, yu, yv, _, _, _ = trace_pixel_tangents(u, v, packed, world_of(where))
            assert status == RayStatus.RECOVERED
            np.testing.assert_allclose(
                [[xu, xv], [yu, yv]], exact_derivatives(where, u, v), rtol=1e-11, atol=1e-14
            )
            there = where.camera.project((x, y, 0.0))
            np.testing.assert_allclose(there, (u, v), atol=1e-8)


def nearest_on_ray(start: np.ndarray, way: np.ndarray, rod: np.ndarray) -> float:
    """Smallest distance of a half-line to a segment: convex in t, so a bounded minimiser finds it."""
    one, other = rod[:3], rod[3:6]
    axis = other - one

    def distance(t: float) -> float:
        point = start + t * way
        share = np.clip((point - one) @ axis / max(axis @ axis, 1e-300), 0.0, 1.0)
        return float(np.linalg.norm(point - one - share * axis))

    far = 10.0 * float(np.linalg.norm(start) + np.linalg.norm(one) + np.linalg.norm(other))
    found = minimize_scalar(distance, bounds=(0.0, far), method="bounded", options={"xatol": 1e-9})
    return min(float(found.fun), distance(0.0))


def test_rods_against_a_minimiser() -> None:
    rng = np.random.default_rng(6)
    met = 0
    for _ in range(400):
        start, rod = rng.normal(size=3) * 60.0, np.array([*rng.normal(size=6) * 30.0, rng.uniform(1.0, 15.0)])
        way = 0.5 * (rod[:3] + rod[3:6]) - start + 20.0 * rng.normal(size=3)
        way /= np.linalg.norm(way)
        if rng.random() < 0.1:
            rod[3:6] = rod[:3]  # a ball
        if rng.random() < 0.1:
            rod[3:6] = rod[:3] + 30.0 * way  # parallel to the ray
        distance = nearest_on_ray(start, way, rod)
        if abs(distance - rod[6]) < 1e-6:
            continue
        t = meets_rod(tuple(start.tolist()), tuple(way.tolist()), rod)
        assert np.isfinite(t) == (distance < rod[6])
        if np.isfinite(t):
            met += 1
            assert t >= 0.0
            point = start + t * way
            axis = rod[3:6] - rod[:3]
            share = np.clip((point - rod[:3]) @ axis / max(axis @ axis, 1e-300), 0.0, 1.0)
            assert np.linalg.norm(point - rod[:3] - share * axis) == pytest.approx(distance, abs=1e-6)
    assert met > 40


def test_a_rod_without_length_is_an_opaque_ball() -> None:
    rng = np.random.default_rng(0)
    blocked = 0
    for _ in range(12):
        where = random_scene(rng)
        if not where.bodies:
            continue
        stand_in = where.spheres[0]
        rod = Rod(stand_in.name, stand_in.centre_mm, stand_in.centre_mm, stand_in.radius_mm)
        dark = ball(stand_in.name, *stand_in.centre_mm, stand_in.radius_mm, None)
        pixels = aimed_pixels(where, rng, 3000)
        one, two = (trace(where.with_bodies([body, *where.bodies[1:]]), pixels) for body in (rod, dark))
        same = one.rays["status"] == two.rays["status"]
        assert np.mean(~same) <= 1e-3  # rounding at the very rim
        assert one.plane_mm[same].tobytes() == two.plane_mm[same].tobytes()
        blocked += int(np.sum(one.rays["status"] == RayStatus.BLOCKED))
    assert blocked > 2000


def test_rods_before_between_and_behind() -> None:
    """A rod stops exactly the straight pieces that meet it, wherever along the path it stands."""
    upper, lower = ball("upper", 0.0, 0.0, 140.0, 20.0), ball("lower", 0.0, 0.0, 30.0, 20.0)
    camera, start, way = camera_at((0.0, 0.0, 500.0)), (4.0, 0.0, 400.0), (0.0, 0.0, -1.0)

    def at_height(z_mm: float, *bodies: Sphere) -> float:
        """Where the ray is at a height after these bodies: back from its plane point."""
        ray = trace_from(Scene(camera, bodies), start, way).rays
        return float(ray["x_mm"] + z_mm * ray["direction"][0] / ray["direction"][2])

    for z_mm, x_mm in ((200.0, 4.0), (80.0, at_height(80.0, upper)), (4.0, at_height(4.0, upper, lower))):
        for aside, status in ((0.0, RayStatus.BLOCKED), (1.9, RayStatus.BLOCKED), (2.1, RayStatus.RECOVERED)):
            rod = Rod("rod", (x_mm + aside, -30.0, z_mm), (x_mm + aside, 30.0, z_mm), 2.0)
            ray = trace_from(Scene(camera, (upper, lower, rod)), start, way).rays
            assert ray["status"] == status, (z_mm, aside)
    behind = Rod("rod", (4.0, -30.0, 450.0), (4.0, 30.0, 450.0), 2.0)
    assert trace_from(Scene(camera, (upper, lower, behind)), start, way).recovered


def test_fresnel_at_normal_incidence_and_at_the_brewster_angle() -> None:
    """R = ((n-1)/(n+1))^2 head on; at tan i = n one polarisation passes whole."""
    n = 1.53
    assert transmittance(1.0, 1.0, n) == pytest.approx(1.0 - ((n - 1.0) / (n + 1.0)) ** 2, rel=1e-15)
    cos_i = 1.0 / np.hypot(1.0, n)
    cos_t = n / np.hypot(1.0, n)
    r_s = (cos_i - n * cos_t) / (cos_i + n * cos_t)
    assert transmittance(cos_i, cos_t, n) == pytest.approx(1.0 - r_s**2 / 2.0, rel=1e-15)


def test_reference_itself_at_hand_made_angles() -> None:
    """The judge is judged: one ball, closed form r_o of a ray parallel to the axis."""
    n, radius, height = 1.53, 25.0, 10.0
    where = Scene(camera_at((0.0, 0.0, 500.0)), (ball("one", 0.0, 0.0, 25.0, radius, n),))
    seen = follow(where, (mpf(height), mpf(0), mpf(400)), (mpf(0), mpf(0), mpf(-1)))
    i, t = mpmath.asin(height / radius), mpmath.asin(height / (mpf(n) * radius))
    delta = 2 * (i - t)
    # Leaves at polar angle i - delta behind the centre ... measured from the axis, on the far side.
    across, along = radius * mpmath.sin(2 * t - i), radius * mpmath.cos(2 * t - i)
    expected = across - (radius - along) * mpmath.tan(delta)
    assert abs(seen.x - expected) < mpf(10) ** -14
