"""Spheres with spheres in them: digits lost, what must be exactly as without, invariants, the three ways."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mpf

from benchmarks.reference import Glass, Vector, along, cross, dot, roots
from benchmarks.scenes import aimed_pixels
from rtpiv.analysis.views.field_of_view import field_of_view
from tests.slow_cases import one_in_three
from tests.tracer.scenes import HOLLOW, ball, camera_at, one_ray, random_scene, scene
from tracer.bodies import Core, Sphere
from tracer.errors import SceneError
from tracer.kernels.sphere import (
    SOLID,
)
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.branches import sphere_of
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.ray_path import ray_path
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus, trace, trace_from

EPSILON = 2.0**-52
RADIUS_MM, N, AWAY = 25.0, 1.53, 17.0
RATIOS = (1e-6, 0.5, 0.999, 1.0 - 1e-12)
INDICES = (1.0, 1.0 + 1e-12, 1.33, 1.53, 2.5)
SHARES = (1e-2, 1e-4, 1e-6, 1e-12)
FILM = 1e-9
WAYS = ("one", "one core", "one off core")


def impacts(ratio: float, n: float) -> list[tuple[float, float]]:
    """Impact parameters of a case [radii]: anywhere, about the core's edge, its critical angle and the rim.

    With each the distance of the nearest change of the way through [radii].
    """
    edges = [1.0, N * ratio, n * ratio]
    every = {0.0, 0.3, 0.6, 0.9} | {edge * (1.0 + s * side) for edge in edges for s in SHARES for side in (-1, 1)}
    return [(b, min(abs(b - edge) for edge in edges)) for b in sorted(every) if b <= 1.0 - 1e-12]


def way_out(numbers: tuple[list[float], ...]) -> tuple[tuple[mpf, ...], str] | None:
    """Foot point [radii] and direction after a sphere, and the way, exactly; None for a miss by rounding."""
    start, way, centre, (radius, n, core, n_core) = (tuple(mpf(x) for x in part) for part in numbers)
    glass = Glass("one", centre, radius, n, ((core, n_core),))
    length = mpmath.sqrt(dot(way, way))
    d: Vector = tuple(x / length for x in way)
    hit = roots(start, d, glass)
    inside = cross(along(start, hit[0], d), d, glass) if hit else None
    if inside is None:
        return None
    w = tuple(inside.o[k] - centre[k] for k in range(3))
    return (*(x / radius for x in along(w, -dot(w, inside.d), inside.d)), *inside.d), inside.name


def digits(
    ratio: float, n: float, impact: float, room: float, away: float = AWAY, tracer: Callable[..., Any] = one_ray
) -> tuple[float, float, set[str]]:
    """Worst digits lost, inherent digits, and ways met, over three random rays of a case.

    Inherent: one number of the ray or the centre moved by one unit in its last place; of a film also one of radii
    and indices, because its thickness is the difference of two of them.
    """
    rng = np.random.default_rng(3)
    table = np.array([[0.0, 0.0, 0.0, RADIUS_MM, N, 0.0, ratio * RADIUS_MM, n]])
    trail, ways = np.zeros(64, np.int32), set()
    lost, inherent, compared = 1e-2, 1e-2, 0
    sure = room > 100.0 * away * EPSILON
    for _ in range(12):
        way, side = rng.normal(size=3), rng.normal(size=3)
        way /= np.linalg.norm(way)
        side = np.cross(way, side)
        side /= np.linalg.norm(side)
        centre = 0.3 * away * RADIUS_MM * rng.normal(size=3)
        start = centre + RADIUS_MM * (impact * side - math.sqrt(away**2 - impact**2) * way)
        table[0, :3] = centre
        result = tracer(*start.tolist(), *way.tolist(), table=table, trail=trail)
        numbers = start.tolist(), way.tolist(), centre.tolist(), table[0, [3, 4, 6, 7]].tolist()
        exact = way_out(numbers)
        if exact is None or result[-1] != 1:
            assert not sure
            continue
        assert not sure or WAYS[trail[0]] == exact[1]
        ways.add(exact[1])
        if result[0] != RayStatus.MISSED_PLANE:  # upwards: `trace_ray` returns the foot point
            continue
        foot = [(mpf(float(p)) - c) / RADIUS_MM for p, c in zip(result[1:4], centre.tolist(), strict=True)]
        found = (*foot, *(mpf(float(x)) for x in result[4:7]))
        lost = max(lost, apart(found, exact[0]) / EPSILON)
        for part, number in enumerate(numbers if 1.0 - ratio < FILM else numbers[:3]):
            for k in range(len(number)):
                other = [list(each) for each in numbers]
                other[part][k] = float(np.nextafter(number[k], math.inf))
                moved = way_out(tuple(other))
                if moved is not None:
                    inherent = max(inherent, apart(moved[0], exact[0]) / EPSILON)
        compared += 1
        if compared == 3:
            break
    assert compared > 0 or not sure
    return math.log10(lost), math.log10(inherent), ways


@pytest.mark.parametrize(("ratio", "n"), one_in_three(RATIOS, INDICES))
def test_digits_lost(ratio: float, n: float) -> None:
    """Lost <= inherent + 1, wherever the ray goes."""
    ways, worst, most = set(), -math.inf, -math.inf
    with mpmath.workdps(60):
        for impact, room in impacts(ratio, n):
            lost, inherent, met = digits(ratio, n, impact, room)
            ways |= met
            worst, most = max(worst, lost - inherent), max(most, lost)
            assert lost <= inherent + 1.0, impact
    print(f"core {ratio:.13g} R, n {n:.13g}: {len(ways)} ways, lost at most {most:.1f}, {worst:+.1f} of inherent")
    assert ways == {WAYS[k] for k, there in enumerate((N * ratio < 1.0, True, n < N and n * ratio < 1.0)) if there}


def apart(one: tuple[mpf, ...], other: tuple[mpf, ...]) -> float:
    return float(max(abs(a - b) for a, b in zip(one, other, strict=True)))


@pytest.mark.parametrize(("n", "ratio"), [(1.0, 0.9), (1.33, 0.7), (1.0003, 0.999)])
def test_total_reflection_is_decided_to_the_last_digit(n: float, ratio: float) -> None:
    """At the core's critical angle and at its edge, by b alone."""
    where = Scene(camera_at((0.0, 0.0, 400.0)), (ball("one", 0.0, 0.0, 64.0, 32.0, N, (32.0 * ratio, n)),))
    edges = [(n, "one core", "one off core"), (N, "one off core", "one")]
    for (index, within, beyond), share, side in product(edges, (1e-14, 1e-12, 1e-9, 1e-6, 1e-3), (-1.0, 1.0)):
        b = index * ratio * 32.0 * (1.0 + side * share)
        if b < 32.0:
            result = trace_from(where, (b, 0.0, 200.0), (0.0, 0.0, -1.0))
            assert result.branches[int(result.rays["key"])] == (beyond if side > 0.0 else within,)
            assert result.rays["transmittance"] <= 1.0


def same(one: Scene, other: Scene, pixels: np.ndarray, apart_mm: float = 0.0) -> None:
    """Two scenes show the same, but for names; bit for bit unless `apart_mm` is given."""
    a, b = trace(one, pixels).rays, trace(other, pixels).rays
    for field in ("status", "x_mm", "y_mm", "direction", "path_mm", "transmittance"):
        if apart_mm:
            np.testing.assert_allclose(a[field], b[field], rtol=1e-12, atol=apart_mm)
        else:
            np.testing.assert_array_equal(a[field], b[field])


def test_what_a_core_does_not_do() -> None:
    """A core of the same glass, beside every ray, or of no size, is not there."""
    solid = scene("two_spheres_500")
    near, far = solid.spheres
    pixels = aimed_pixels(solid, np.random.default_rng(4), 20_000)

    def filled(*cores: Core) -> Scene:
        return solid.with_bodies([replace(near, cores=cores), replace(far, cores=cores)])

    assert near.medium is not None
    glass = Core(20.0, near.medium)
    result = trace(filled(glass), pixels)
    assert {"core" in " ".join(names) for names in result.branches.values()} == {False, True}
    one, other = result.rays, trace(solid, pixels).rays
    for field in ("x_mm", "y_mm", "direction"):
        np.testing.assert_array_equal(one[field], other[field])
    np.testing.assert_allclose(one["path_mm"], other["path_mm"], rtol=1e-14)
    np.testing.assert_allclose(one["transmittance"], other["transmittance"], rtol=1e-14, atol=1e-15)
    same(filled(Core(1e-9, ConstantMedium(1.0))), solid, pixels)  # no pixel is aimed to a picometre
    small = filled(Core(12.0, ConstantMedium(1.0)))
    beside = [names for names in trace(small, pixels).branches.values() if "core" in " ".join(names)]
    assert beside  # and those that pass beside it keep their bits
    seen, plain = trace(small, pixels), trace(solid, pixels)
    names = np.array([" ".join(seen.branches[key]) for key in seen.rays["key"].tolist()])
    clear = np.char.find(names, "core") < 0
    assert 1000 < clear.sum() < len(pixels)
    np.testing.assert_array_equal(seen.rays["x_mm"][clear], plain.rays["x_mm"][clear])
    np.testing.assert_array_equal(seen.rays["path_mm"][clear], plain.rays["path_mm"][clear])


def test_a_bubble_of_no_thickness_is_a_bubble() -> None:
    """A ball of gas behind a film of glass as thin as the next number turns rays as the gas alone."""
    film = ball("film", 3.0, 2.0, 40.0, 25.0, 1.5, (25.0 * (1.0 - 1e-15), 1.333))
    gas = ball("film", 3.0, 2.0, 40.0, 25.0, 1.333)
    pixels = np.random.default_rng(1).uniform(900.0, 1100.0, (500, 2))
    rays = [trace(Scene(camera_at(), (body,)), pixels).rays for body in (film, gas)]
    np.testing.assert_allclose(rays[0]["x_mm"], rays[1]["x_mm"], rtol=0.0, atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_reversed_rays(seed: int) -> None:
    """The ray sent back passes the pinhole, by the same way through every core, with the same losses."""
    rng = np.random.default_rng(seed)
    where = random_scene(rng, cores=True)
    if not where.spheres:
        return
    result = trace(where, aimed_pixels(where, rng, 200))
    eye = np.array(where.camera.position_mm)
    chosen = result.recovered & (result.rays["transmittance"] > 0.7) & (result.rays["direction"][:, 2] < -0.1)
    for ray in result.rays[chosen][:60]:
        start = np.array([ray["x_mm"], ray["y_mm"], 0.0])
        back = trace_from(where, start, -ray["direction"])
        names = result.branches[int(ray["key"])]
        there = one_ray(*start.tolist(), *(-ray["direction"]).tolist(), table=where.sphere_table())
        assert back.branches[int(back.rays["key"])] == names[::-1]
        assert there[8] == pytest.approx(float(ray["transmittance"]), abs=1e-6)
        miss = np.cross(eye - np.array(there[1:4]), np.array(there[4:7]))
        assert np.linalg.norm(miss) <= 1e-5 * np.linalg.norm(eye)


def test_the_names_of_the_ways() -> None:
    where = scene(HOLLOW)
    names = where.event_names()
    assert len(set(names)) == len(names) == 7 * len(where.spheres)
    assert [names[5 * way + 4] for way in range(7)] == [
        "nested", "nested core", "nested off core", "nested core 2", "nested off core 2", "nested core 3",
        "nested off core 3",
    ]  # fmt: skip
    assert all(sphere_of(where, name).name == name.split()[0] for name in names)
    made = build_ray_map(where)
    assert {("drop",), ("drop core",), ("gas core",), ("gas off core",)} <= set(made.branches)


def test_only_solid_spheres_travel_the_fast_way() -> None:
    where = scene(HOLLOW)
    assert where.sphere_table().shape == (5, SOLID + 6)
    assert scene("pyramid_500").sphere_table().shape == (5, SOLID)
    hollow = Scene(camera_at(), (ball("one", 0.0, 0.0, 25.0, 25.0, 1.53, (20.0, 1.0)),))
    assert choose(hollow).kind is Kind.RAYS
    with pytest.raises(SceneError, match="field of view is for solid spheres"):
        field_of_view(hollow)


@pytest.mark.parametrize("core", [25.0, 26.0, 0.0, -1.0, math.nan])
def test_a_core_must_fit(core: float) -> None:
    with pytest.raises(SceneError, match="radius of a core must be"):
        ball("one", 0.0, 0.0, 25.0, 25.0, 1.53, (core, 1.0))


def test_what_else_a_core_cannot_be() -> None:
    with pytest.raises(SceneError, match="less than the 20 mm of what it is in"):
        ball("one", 0.0, 0.0, 25.0, 25.0, 1.53, (20.0, 1.0), (20.0, 1.5))
    with pytest.raises(SceneError, match="is opaque"):
        Sphere("one", (0.0, 0.0, 25.0), 25.0, None, (Core(20.0, ConstantMedium(1.0)),))
    with pytest.raises(SceneError, match=r"core of sphere 'one': n = 0\.5"):
        Scene(camera_at(), (ball("one", 0.0, 0.0, 25.0, 25.0, 1.53, (20.0, 0.5)),))
    hollow = ball("one", 0.0, 0.0, 25.0, 25.0, 1.53, (20.0, 1.0))
    with pytest.raises(SceneError, match="called like a way through 'one'"):
        Scene(camera_at(), (hollow, ball("one off core", 60.0, 0.0, 25.0, 25.0)))


def test_the_drawn_ray_is_the_traced_ray() -> None:
    """Its corners lie on the surfaces, and n times the length between them adds up to the optical path."""
    where = scene(HOLLOW)
    pixels = aimed_pixels(where, np.random.default_rng(6), 400)
    result = trace(where, pixels)
    met = set()
    for pixel, ray in zip(pixels, result.rays, strict=True):
        names = result.branches[int(ray["key"])]
        if ray["status"] != RayStatus.RECOVERED or len(names) != 1:
            continue
        met.add(names)
        corners, body = ray_path(where, pixel), sphere_of(where, names[0])
        off = np.linalg.norm(corners[1:-1] - np.array(body.centre_mm), axis=1)
        layers = [(body.radius_mm, body.medium), *((core.radius_mm, core.medium) for core in body.cores)]
        radii = np.array([radius for radius, _ in layers])
        surface = np.abs(off[:, None] - radii).argmin(axis=1)
        np.testing.assert_allclose(off, radii[surface], rtol=1e-9)
        np.testing.assert_allclose(corners[-1, :2], (ray["x_mm"], ray["y_mm"]), atol=1e-7)
        n = [medium.n(where.wavelength_nm) for _, medium in layers]
        inner = [n[min(a, b)] for a, b in pairwise(surface.tolist())]
        along = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        assert along @ [where.n_ambient, *inner, where.n_ambient] == pytest.approx(ray["path_mm"], rel=1e-9)
    assert len(met) > 5
