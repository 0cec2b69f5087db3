"""Digits lost, row by row, as docs/numerics.md states them.

A ray meets one sphere; foot point (in radii) and direction of the way out are compared with the exact ones of the
same float64 input, at 60 digits.  Lost digits are log10(error / 2^-52).  Inherent are the digits by which the
exact answer itself moves when one number of the input moves by one unit in its last place: no arithmetic can be
expected to do better than that.  The bound for every row is  lost <= inherent + 1.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from benchmarks.reference import Glass, Vector, along, dot, follow, roots, snell
from tests.loops import loop_over
from tests.slow_cases import one_in_three
from tests.tracer.scenes import ball, camera_at, one_ray
from tracer.kernels.sphere import angles, through
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.trace import RayStatus, trace_from

EPSILON = 2.0**-52
INDICES = (1.0, 1.0 + 1e-12, 1.0 + 1e-6, 1.023, 1.53, 4.0)
DISTANCES = (1.05, 10.0, 17.0, 1e3, 1e6)
IMPACTS = (0.0, 0.5, 0.999, 1.0 - 1e-6, 1.0 - 1e-12)
RADII_MM = (1e-3, 25.0, 1e6)


def way_out(start: Vector, way: Vector, centre: Vector, radius: mpf, n: mpf) -> tuple[mpf, ...] | None:
    """Foot point [radii] and direction after the sphere, by roots and normals."""
    glass = Glass("", centre, radius, n)
    length = mpmath.sqrt(dot(way, way))
    d = tuple(x / length for x in way)
    hit = roots(start, d, glass)
    if hit is None:
        return None
    o = along(start, hit[0], d)
    inside = snell(d, tuple((o[k] - centre[k]) / radius for k in range(3)), 1 / n)
    assert inside is not None
    d = inside[0]
    chord = roots(o, d, glass)
    if chord is None:  # at the very rim the chord has no length
        return None
    o = along(o, chord[1], d)
    outside = snell(d, tuple((centre[k] - o[k]) / radius for k in range(3)), n)
    assert outside is not None
    d = outside[0]
    w = tuple(o[k] - centre[k] for k in range(3))
    return (*(x / radius for x in along(w, -dot(w, d), d)), *d)


def apart(one: tuple[mpf, ...], other: tuple[mpf, ...]) -> float:
    return float(max(abs(a - b) for a, b in zip(one, other, strict=True)))


def digits(
    distance: float, impact: float, radius_mm: float, n: float, tracer: Callable[..., Sequence[float]] = one_ray
) -> tuple[float, float]:
    """Worst digits lost and inherent digits over random rays of one case."""
    rng = np.random.default_rng(7)
    lost, inherent = 1e-2, 1e-2
    compared = 0
    for _ in range(20):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        side = np.cross(way, rng.normal(size=3))
        side /= np.linalg.norm(side)
        centre = 0.3 * distance * radius_mm * rng.normal(size=3)
        start = centre + radius_mm * (impact * side - math.sqrt(distance**2 - impact**2) * way)
        table = np.array([[*centre, radius_mm, n, 0.0]])
        result = tracer(*start.tolist(), *way.tolist(), table=table)
        s, d, c = (tuple(mpf(x) for x in vector.tolist()) for vector in (start, way, centre))
        exact = way_out(s, d, c, mpf(radius_mm), mpf(n))
        if exact is None or result[-1] != 1:
            assert impact > 0.999999  # only there rounding decides whether the sphere is met
            continue
        if (
            result[0] != RayStatus.MISSED_PLANE
        ):  # leaving upwards: `trace_ray` returns the foot point, not a plane point
            continue
        compared += 1
        foot = tuple((mpf(float(x)) - y) / mpf(radius_mm) for x, y in zip(result[1:4], c, strict=True))
        found = (*foot, *(mpf(float(x)) for x in result[4:7]))
        lost = max(lost, apart(found, exact) / EPSILON)
        for which, k in product(range(3), range(3)):
            vectors = [list(v.tolist()) for v in (start, way, centre)]
            vectors[which][k] = float(np.nextafter(vectors[which][k], math.inf))
            s2, d2, c2 = (tuple(mpf(x) for x in vector) for vector in vectors)
            moved = way_out(s2, d2, c2, mpf(radius_mm), mpf(n))
            if moved is not None:
                inherent = max(inherent, apart(moved, exact) / EPSILON)
    assert compared > (0 if impact > 0.999999 else 3)
    return math.log10(lost), math.log10(inherent)


@pytest.fixture(autouse=True)
def _sixty_digits() -> Iterator[None]:
    with mpmath.workdps(60):
        yield


def textbook(
    x: float, y: float, z: float, u: float, v: float, w: float, table: np.ndarray, *_: object
) -> list[float]:
    """What `trace_ray` returns for one sphere, by roots and normals in float64: the formulas not used here."""
    o, d, c, (radius, n) = np.array([x, y, z]), np.array([u, v, w]), table[0, :3], table[0, 3:5]
    for index in (1.0 / n, n):
        half = (o - c) @ d
        root = math.sqrt(half**2 - ((o - c) @ (o - c) - radius**2))
        o = o + d * (-half - root if index == 1.0 / n else -half + root)
        normal = (o - c) / radius * (1.0 if index == 1.0 / n else -1.0)
        cos_in = -float(d @ normal)
        d = index * d + (index * cos_in - math.sqrt(1.0 - index**2 * (1.0 - cos_in**2))) * normal
    foot = o - ((o - c) @ d) * d
    return [3 if d[2] >= 0.0 else 0, *foot, *d, 0.0, 0.0, 0, 1]


def test_these_tests_can_fail() -> None:
    """The textbook quadratic loses digits with the square of the distance, and is found out."""
    lost, inherent = digits(1e3, 0.5, 25.0, 1.53, textbook)
    assert lost > inherent + 1.0


@pytest.mark.parametrize(("distance", "impact", "n"), one_in_three(DISTANCES, IMPACTS, INDICES))
def test_distance_impact_and_index(distance: float, impact: float, n: float) -> None:
    lost, inherent = digits(distance, impact, 25.0, n)
    print(f"{distance:8g} R  1-b {1.0 - impact:6.0e}  n {n:<16.13g} lost {lost:5.1f}  inherent {inherent:5.1f}")
    assert lost <= inherent + 1.0


@pytest.mark.slow
@loop_over("radius_mm", RADII_MM)
@loop_over("impact", IMPACTS)
def test_radius(radius_mm: float, impact: float) -> None:
    """A micrometre and a kilometre: only ratios count."""
    for distance in (17.0, 500.0 / radius_mm if radius_mm < 1.0 else 2.0):
        lost, inherent = digits(distance, impact, radius_mm, 1.53)
        print(f"R {radius_mm:g} mm at {distance:g} R, 1-b {1.0 - impact:.0e}: lost {lost:.1f} of {inherent:.1f}")
        assert lost <= inherent + 1.0


@loop_over("n", [1.0 + 1e-14, 1.0 + 1e-12, 1.0 + 1e-9, 1.0 + 1e-6, 1.0 + 1e-4, 1.023, 1.53, 4.0])
@loop_over("impact", [1e-8, 1e-3, 0.5, 0.9, 0.999, 1.0 - 1e-6])
def test_the_deflection_itself_keeps_its_digits_as_n_goes_to_one(n: float, impact: float) -> None:
    """Relative to the deflection, however small: g without cancellation.  Inherent: b and n by one unit."""
    b2, radius = impact**2 * 625.0, 25.0

    def sine_over_b(b2: mpf, n: mpf) -> mpf:
        i, t = mpmath.asin(mpmath.sqrt(b2) / radius), mpmath.asin(mpmath.sqrt(b2) / (n * radius))
        return mpmath.sin(2 * (i - t)) / mpmath.sqrt(b2)

    exact = sine_over_b(mpf(b2), mpf(n))
    _, q = through(b2, radius, n, *angles(b2, radius, n))
    lost = max(float(abs(mpf(float(q)) / exact - 1)) / EPSILON, 1e-2)
    moves = [abs(sine_over_b(mpf(float(np.nextafter(b2, 0.0))), mpf(n)) / exact - 1)]
    # n itself is given to an ulp of 1, which is not the fault of any formula: hold against b alone.
    inherent = max(float(moves[0]) / EPSILON, 1e-1)
    assert math.log10(lost) <= math.log10(inherent) + 1.3


def test_no_power_is_exactly_nothing() -> None:
    for impact in (0.0, 0.5, 0.999, 1.0 - 1e-12):
        cosine, q = through(impact**2 * 625.0, 25.0, 1.0, *angles(impact**2 * 625.0, 25.0, 1.0))
        assert (cosine, q) == (1.0, 0.0)


@pytest.mark.parametrize("n", INDICES)
def test_the_tangent_ray(n: float) -> None:
    """b = R and its neighbours: the ray passes undeflected or is turned at grazing incidence; never NaN."""
    where = Scene(camera_at((0.0, 0.0, 900.0)), (ball("one", 0.0, 0.0, 500.0, 25.0, n),))
    grazing = 2.0 * (math.pi / 2.0 - math.asin(1.0 / n))
    for x in (25.0, np.nextafter(25.0, 0.0), np.nextafter(25.0, 99.0), 25.0 * (1.0 - 1e-15)):
        ray = trace_from(where, (x, 0.0, 800.0), (0.0, 0.0, -1.0)).rays
        turn = math.atan2(-float(ray["direction"][0]), -float(ray["direction"][2]))
        assert ray["status"] in (RayStatus.RECOVERED, RayStatus.MISSED_PLANE)
        # At 1 - b = 1e-16 the cosine of incidence is 1e-8, and so is the turn that is missing.
        assert turn == pytest.approx(0.0, abs=1e-15) or turn == pytest.approx(grazing, abs=1e-6)
        assert ray["events"] == 0 or x < 25.0


@pytest.mark.parametrize("gap_mm", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, -1e-12, -1e-9, -5e-7])
def test_gaps(gap_mm: float) -> None:
    """Touching, nearly touching, and overlapping by what decimal files round: both spheres in order."""
    where = Scene(
        camera_at((0.0, 0.0, 500.0)),
        (ball("near", 0.0, 0.0, 25.0, 25.0), ball("far", 0.0, 0.0, 75.0 + gap_mm, 25.0)),
    )
    rng = np.random.default_rng(1)
    for radius_mm in (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 5.0, 10.0):
        angle = rng.uniform(0.0, 6.28)
        way = np.array([radius_mm * math.cos(angle), radius_mm * math.sin(angle), -500.0])
        way /= np.linalg.norm(way)
        result = trace_from(where, (0.0, 0.0, 500.0), way)
        assert result.branches[int(result.rays["key"])] == ("far", "near")
        seen = follow(where, (mpf(0), mpf(0), mpf(500)), tuple(mpf(x) for x in way.tolist()))
        assert seen.branch == ("far", "near")
        error = mpmath.hypot(seen.x - float(result.plane_mm[0]), seen.y - float(result.plane_mm[1]))
        assert error <= 1e-12


def test_total_reflection_is_decided_to_the_last_digit() -> None:
    """TIR from b = n R on: decided by b, never by the sign of a root."""
    water = ConstantMedium(1.333)
    where = Scene(camera_at((0.0, 0.0, 400.0)), (ball("bubble", 0.0, 0.0, 64.0, 32.0, 1.0),), ambient=water)
    critical = 32.0 / 1.333
    for share in (1e-14, 1e-12, 1e-9, 1e-6, 1e-3):
        for sign in (-1.0, 1.0):
            ray = trace_from(where, (critical * (1.0 - sign * share), 0.0, 200.0), (0.0, 0.0, -1.0)).rays
            assert bool(ray["status"] == RayStatus.TIR) == (sign < 0.0), (share, sign)


@pytest.mark.parametrize("distance", [1e3, 1e6])
def test_far_cameras(distance: float) -> None:
    """Plane points through a contact stack, the camera a thousand and a million radii away."""
    where = Scene(
        camera_at((0.0, 0.0, 25.0 * distance)),
        (ball("near", 0.0, 0.0, 25.0, 25.0), ball("far", 0.0, 0.0, 75.0, 25.0)),
    )
    eye = (0.0, 0.0, 25.0 * distance)
    for radius_mm in (0.0, 1.0, 5.0, 12.0, 20.0, 24.0):
        way = np.array([0.6 * radius_mm, 0.8 * radius_mm, -25.0 * distance])
        way /= np.linalg.norm(way)
        result = trace_from(where, eye, way)
        seen = follow(where, tuple(mpf(x) for x in eye), tuple(mpf(x) for x in way.tolist()))
        turned = list(way)
        turned[0] = float(np.nextafter(turned[0], 1.0))
        other = follow(where, tuple(mpf(x) for x in eye), tuple(mpf(x) for x in turned))
        inherent = max(float(abs(other.x - seen.x)), EPSILON * 25.0)
        error = float(mpmath.hypot(seen.x - float(result.plane_mm[0]), seen.y - float(result.plane_mm[1])))
        assert result.branches[int(result.rays["key"])] == seen.branch == ("far", "near")
        assert error <= 10.0 * inherent
