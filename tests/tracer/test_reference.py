"""The tracer against 50-digit textbook optics: random rays, contacts, no glass at all."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from benchmarks.reference import Glass, Seen, Vector, dot, follow, follow_pixel, snell
from benchmarks.scenes import PAPER, aimed_pixels
from tests.loops import loop_over
from tests.tracer.scenes import HOLLOW, TILTED, ball, camera_at, scene
from tracer.kernels.landing import STATE, trace_states
from tracer.kernels.rays import MAX_EVENTS
from tracer.kernels.world import RECOVERED, World
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.trace import NO_CELLS, NO_RODS, RayStatus, trace, trace_from

STATUS = {"recovered": RayStatus.RECOVERED, "tir": RayStatus.TIR, "missed": RayStatus.MISSED_PLANE}
REGIONS = {"clear": (0.0, 0.0), "centre": (0.0, 0.9), "rim": (0.9, 0.99), "last 1 %": (0.99, 1.0)}
BOUND_MM = {"clear": 1e-9, "centre": 1e-9, "rim": 1e-9, "last 1 %": 1e-5}
BOUND_PASSED = {"clear": 0.0, "centre": 1e-12, "rim": 1e-12, "last 1 %": 1e-6}
LEVEL = 0.05  # a ray less than 3 degrees from level lands up to kilometres away: judged by its conditioning


@dataclass
class Worst:
    """Largest error of a region [mm], and how many rays it had."""

    rays: int = 0
    error_mm: float = 0.0


def region(worst: float) -> str:
    if worst == 0.0:
        return "clear"
    return next(name for name, (low, high) in REGIONS.items() if low < worst <= high)


def distance_mm(one: Seen, x: float, y: float) -> float:
    return float(mpmath.hypot(one.x - mpf(x), one.y - mpf(y)))


def inherent_mm(where: Scene, pixel: tuple[float, float], seen: Seen) -> float:
    """How far the plane point moves when pixel or pinhole moves by one unit in the last place."""
    u, v = pixel
    eye = where.camera.position_mm
    moved = replace(where.camera, position_mm=(eye[0], eye[1], float(np.nextafter(eye[2], 0.0))))
    others = [
        follow_pixel(where, float(np.nextafter(u, 1e9)), v),
        follow_pixel(where, u, float(np.nextafter(v, 1e9))),
        follow_pixel(where.with_camera(moved), u, v),
    ]
    return sum(float(mpmath.hypot(other.x - seen.x, other.y - seen.y)) for other in others)


def compare(count: int, seed: int) -> Iterator[tuple[str, dict[str, Worst]]]:
    """Trace `count` rays over all scenes both ways; yields each scene with its worst errors."""
    names = (*PAPER, TILTED, HOLLOW)
    rng = np.random.default_rng(seed)
    for name in names:
        where = scene(name)
        pixels = aimed_pixels(where, rng, -(-count // len(names)))
        result = trace(where, pixels)
        table = {key: Worst() for key in REGIONS}
        for (u, v), ray in zip(pixels.tolist(), result.rays, strict=True):
            seen = follow_pixel(where, u, v)
            assert result.branches[int(ray["key"])] == seen.branch
            assert ray["status"] == STATUS[seen.status]
            if seen.status != "recovered":
                assert np.isnan(ray["x_mm"])
                assert np.isnan(ray["y_mm"])
                continue
            error = distance_mm(seen, float(ray["x_mm"]), float(ray["y_mm"]))
            if abs(seen.direction[2]) < LEVEL:
                assert error <= 10.0 * inherent_mm(where, (u, v), seen)
                continue
            place = region(float(seen.worst))
            assert abs(float(ray["path_mm"] - seen.path)) <= BOUND_MM[place]
            assert abs(float(ray["transmittance"] - seen.passed)) <= BOUND_PASSED[place]
            entry = table[place]
            entry.rays += 1
            entry.error_mm = max(entry.error_mm, error)
        yield name, table


def check(count: int, seed: int) -> None:
    for name, table in compare(count, seed):
        for key, worst in table.items():
            print(f"{name:16s} {key:9s} {worst.rays:6d} rays, largest error {worst.error_mm:.1e} mm")
            assert worst.rays > 0, (name, key)
            assert worst.error_mm <= BOUND_MM[key], (name, key)


def test_two_thousand_random_rays() -> None:
    check(2_000, seed=20)


@pytest.mark.slow
def test_two_hundred_thousand_random_rays() -> None:
    check(200_000, seed=21)


@pytest.mark.parametrize("name", [*PAPER, TILTED])
def test_without_power_the_glass_is_not_there(name: str) -> None:
    where = scene(name)
    clear = where.with_bodies([replace(body, medium=where.ambient) for body in where.spheres])
    pixels = aimed_pixels(where, np.random.default_rng(3), 20_000)
    seen, direct = trace(clear, pixels), trace(where.with_bodies([]), pixels)
    assert np.max(seen.rays["events"]) > 0
    assert np.all(seen.recovered)
    assert np.max(np.abs(seen.plane_mm - direct.plane_mm)) <= 1e-12
    np.testing.assert_allclose(seen.rays["transmittance"], 1.0, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(seen.rays["path_mm"], direct.rays["path_mm"], rtol=1e-14)


RADII_MM = (0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 5.0)


@pytest.mark.slow
@loop_over("name", ["one_sphere_250", "two_spheres_500", "three_spheres_500"])
@loop_over("radius_mm", RADII_MM)
def test_rays_along_a_contact_axis(name: str, radius_mm: float) -> None:
    """Entry radius down to 0: through the contact of sphere and sphere, and of sphere and plane."""
    where = scene(name)
    rng = np.random.default_rng(5)
    angle = rng.uniform(0.0, 2.0 * np.pi, 300)
    eye = where.camera.position_mm
    ways = np.stack((radius_mm * np.cos(angle), radius_mm * np.sin(angle), np.full(300, -eye[2])), axis=-1)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    result = trace_from(where, eye, ways)
    expected = tuple(body.name for body in sorted(where.spheres, key=lambda body: -body.centre_mm[2]))
    assert set(result.branches.values()) == {expected}
    assert np.all(result.recovered)
    for way, point in list(zip(ways.tolist(), result.plane_mm.tolist(), strict=True))[:20]:
        seen = follow(where, tuple(mpf(x) for x in eye), tuple(mpf(x) for x in way))
        assert seen.branch == expected
        assert distance_mm(seen, *point) <= 1e-12


def contact_scene(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Two spheres in contact along a random direction, and the contact point."""
    radius_a, radius_b = 10.0 ** rng.uniform(0.5, 1.5, 2)
    way = rng.normal(size=3)
    way[2] = -abs(way[2]) - 0.3
    way /= np.linalg.norm(way)
    lower = np.array([0.0, 0.0, radius_b + 20.0])
    upper = lower - (radius_a + radius_b) * way
    bodies = (ball("lower", *lower.tolist(), radius_b, 1.7), ball("upper", *upper.tolist(), radius_a, 1.5))
    return Scene(camera_at((0.0, 0.0, 4000.0)), bodies), upper + radius_a * way


def ray_leaving_at(upper: Glass, leave: np.ndarray, inside: np.ndarray) -> tuple[Vector, Vector]:
    """Ray from far above that crosses a sphere along `inside` and leaves it at `leave` (on its surface)."""
    d = tuple(mpf(x) for x in inside.tolist())
    length = mpmath.sqrt(dot(d, d))
    back = tuple(-x / length for x in d)
    out = tuple(mpf(x) - c for x, c in zip(leave.tolist(), upper.centre, strict=True))
    chord = -2 * dot(out, back)
    entry = tuple(out[k] + chord * back[k] for k in range(3))
    normal = tuple(-e / mpmath.sqrt(dot(entry, entry)) for e in entry)
    refracted = snell(back, normal, upper.n)
    assert refracted is not None
    outwards = refracted[0]
    start = tuple(upper.centre[k] + entry[k] + 300 * outwards[k] for k in range(3))
    return start, tuple(-x for x in outwards)


@pytest.mark.slow
@loop_over("radius_mm", RADII_MM)
def test_rays_across_an_oblique_contact(radius_mm: float) -> None:
    """Rays that leave one sphere `radius_mm` beside its contact with the next, up to 35 degrees to its axis."""
    rng = np.random.default_rng(6)
    wrong = compared = 0
    for _ in range(40):
        where, contact = contact_scene(rng)
        upper = next(body for body in where.spheres if body.name == "upper")
        axis = (contact - np.array(upper.centre_mm)) / upper.radius_mm
        side = np.cross(axis, rng.normal(size=3))
        turn = min(radius_mm / upper.radius_mm, 0.2)
        leave = np.cos(turn) * axis + np.sin(turn) * side / np.linalg.norm(side)
        leave = np.array(upper.centre_mm) + upper.radius_mm * leave
        inside = axis + np.tan(np.deg2rad(35.0)) * rng.uniform() * np.cross(axis, rng.normal(size=3)) / 2.0
        glass = Glass("upper", tuple(mpf(x) for x in upper.centre_mm), mpf(upper.radius_mm), mpf(1.5))
        start, way = ray_leaving_at(glass, leave, inside)
        start64, way64 = [float(x) for x in start], [float(x) for x in way]
        result = trace_from(where, start64, way64)
        seen = follow(where, tuple(mpf(x) for x in start64), tuple(mpf(x) for x in way64))
        wrong += result.branches[int(result.rays["key"])] != seen.branch
        compared += "upper" in seen.branch
        if seen.status == "recovered" and seen.worst < 0.99:
            assert distance_mm(seen, *result.plane_mm.tolist()) <= 1e-9
    assert wrong == 0
    assert compared == 40


def test_glass_in_water_and_water_in_glass() -> None:
    """Only the ratio of indices bends; the optical path takes both."""
    bodies = (ball("bead", 3.0, -4.0, 31.0, 30.0, 1.52),)
    where = Scene(camera_at((10.0, 5.0, 300.0)), bodies, ambient=ConstantMedium(1.333))
    result = trace(where, [(1000.0, 900.0), (1100.0, 1200.0), (40.0, 30.0)])
    for (u, v), ray in zip([(1000.0, 900.0), (1100.0, 1200.0), (40.0, 30.0)], result.rays, strict=True):
        seen = follow_pixel(where, u, v)
        assert distance_mm(seen, float(ray["x_mm"]), float(ray["y_mm"])) <= 1e-12
        assert ray["path_mm"] == pytest.approx(float(seen.path), rel=1e-14)
        np.testing.assert_allclose(ray["direction"], [float(x) for x in seen.direction], atol=1e-14)


# Rays that rounding calls a hit and the corrected foot point a miss: they pass, with derivatives as well.


N = 1.5


def grazing(rng: np.random.Generator) -> tuple[list[float], np.ndarray]:
    """Numbers of a ray that touches a sphere to rounding, and the sphere."""
    radius = float(10.0 ** rng.uniform(-1.0, 2.0))
    away = radius * float(10.0 ** rng.uniform(0.5, 5.0))
    d, side, centre = rng.normal(size=(3, 3))
    d /= np.linalg.norm(d)
    side = np.cross(d, side)
    side /= np.linalg.norm(side)
    centre *= radius
    p = centre + radius * side * (1.0 + rng.uniform(-1.0, 1.0) * 1e-16 * away / radius) - away * d
    return [*p.tolist(), *d.tolist()], np.array([[*centre, radius, N, 0.0]])


@pytest.mark.slow
def test_tangents_pass() -> None:
    """At 50 digits they miss, or bring less than 1e-11 of their light through; none is totally reflected."""
    trail, state = np.empty(MAX_EVENTS, np.int32), np.empty((MAX_EVENTS, STATE))
    rng, found, missed = np.random.default_rng(0), 0, 0
    with mpmath.workdps(50):
        while found < 60:
            numbers, table = grazing(rng)
            radius = float(table[0, 3])
            status, _, d_behind, _, events = trace_states(
                tuple(numbers[:3]), tuple(numbers[3:]), World(table, *NO_CELLS, NO_RODS), trail, state
            )
            if events == 0 or state[0, 7] < radius * radius:
                continue
            found += 1
            assert status == RECOVERED
            assert list(d_behind) == numbers[3:]
            w = [mpf(x) - mpf(float(c)) for x, c in zip(numbers[:3], table[0, :3], strict=True)]
            d = list(map(mpf, numbers[3:]))
            along = sum(a * b for a, b in zip(w, d, strict=True))
            cosine2 = 1 - (sum(a * a for a in w) - along**2 / sum(b * b for b in d)) / mpf(radius) ** 2
            missed += cosine2 <= 0
            assert cosine2 <= 0 or (4 * mpmath.sqrt(cosine2)) ** 2 < 1e-11  # T < 4 cos i at each surface
    assert missed > 5
