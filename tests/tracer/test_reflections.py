"""Reflected branches: all light accounted for, the refracted branch unchanged, paths as textbook optics has."""

import math

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from tests.tracer.reference import Vector, along, dot, glasses, pixel_direction, roots, snell
from tests.tracer.scenes import PAPER, TILTED, aimed_pixels, ball, camera_at, random_scene, scene
from tracer.bodies import Rod
from tracer.errors import SceneError
from tracer.kernels.march import MAX_EVENTS
from tracer.kernels.tree import FRAME, FRAME_BODY, OUTSIDE, follow_tree
from tracer.media import ConstantMedium
from tracer.reflections import BRANCH, BranchTree, trace_branches
from tracer.scene import Scene
from tracer.status import RayStatus
from tracer.trace import trace

LANDED, ESCAPED, BLOCKED, DROPPED, GIVEN_UP = range(5)


def fresnel(incidence_rad: float, n: float) -> float:
    """Reflectance of unpolarised light by the sine and tangent laws (the kernels use neither)."""
    if incidence_rad == 0.0:
        return ((n - 1.0) / (n + 1.0)) ** 2
    t = math.asin(math.sin(incidence_rad) / n)
    s = (math.sin(incidence_rad - t) / math.sin(incidence_rad + t)) ** 2
    p = (math.tan(incidence_rad - t) / math.tan(incidence_rad + t)) ** 2
    return 0.5 * (s + p)


def one_ball(incidence_deg: float, n: float = 1.53) -> tuple[Scene, tuple[float, float]]:
    """A far camera above one ball, and the pixel whose ray meets it at an incidence."""
    where = Scene(camera_at((0.0, 0.0, 5000.0), focal_px=60_000.0), (ball("ball", 0.0, 0.0, 30.0, 10.0, n),))
    slope = math.tan(math.asin(10.0 * math.sin(math.radians(incidence_deg)) / 4970.0))
    centre = where.camera.principal_px
    return where, (centre[0] + 60_000.0 * slope, centre[1])


def weights(tree: BranchTree) -> dict[int, float]:
    """Light of each kind of event of a single ball's branches."""
    codes = tree.codes[tree.records["first"]][:, 1]
    return dict(zip(codes.tolist(), tree.records["transmittance"].tolist(), strict=True))


@pytest.mark.parametrize(("incidence_deg", "share"), [(50.0, 0.003), (70.0, 0.02), (80.0, 0.06)])
def test_two_inner_reflections(incidence_deg: float, share: float) -> None:
    """The published shares, to their printed digit; and the closed form to rounding."""
    where, pixel = one_ball(incidence_deg)
    found = weights(trace_branches(where, pixel, 1e-9))
    reflects = fresnel(math.radians(incidence_deg), 1.53)
    assert found[2] == pytest.approx((1.0 - reflects) ** 2 * reflects**2, rel=1e-9)
    assert found[2] == pytest.approx(share, rel=0.17)  # half a unit of the one digit printed
    assert found[0] == pytest.approx((1.0 - reflects) ** 2, rel=1e-9)


def test_grazing_reflection_outside() -> None:
    where, pixel = one_ball(80.0)
    assert weights(trace_branches(where, pixel, 1e-9))[OUTSIDE] == pytest.approx(0.39, abs=0.005)


@pytest.mark.parametrize("incidence_deg", [0.0, 1e-3, 20.0, 50.0, 70.0, 85.0, 89.5, 89.99])
@pytest.mark.parametrize("n", [1.0, 1.0 + 1e-6, 1.023, 1.53, 4.0])
def test_all_light_of_a_single_ball_is_accounted_for(incidence_deg: float, n: float) -> None:
    where, pixel = one_ball(incidence_deg, n)
    tree = trace_branches(where, pixel, 1e-12)
    assert tree.light.sum() == pytest.approx(1.0, abs=1e-12)
    assert tree.light[0, GIVEN_UP] == 0.0
    # Dropped: at most the child outside, and the geometric series of inner children from the first below 1e-12.
    reflects = fresnel(math.radians(incidence_deg), n)
    assert tree.light[0, DROPPED] <= 1e-12 + 1.001e-12 / (1.0 - reflects) + 1e-15
    followed = tree.light[0, LANDED] + tree.light[0, ESCAPED]
    assert followed == pytest.approx(1.0, abs=1e-9 + tree.light[0, DROPPED])
    assert tree.records["transmittance"].sum() == pytest.approx(tree.light[0, LANDED], rel=1e-14)


@pytest.mark.parametrize("threshold", [0.5, 0.1, 1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("name", [*PAPER, TILTED])
def test_shares_add_up_for_any_threshold(name: str, threshold: float) -> None:
    where = scene(name)
    tree = trace_branches(where, aimed_pixels(where, np.random.default_rng(1), 3000), threshold)
    np.testing.assert_allclose(tree.light.sum(axis=1), 1.0, atol=1e-13)
    assert np.all(tree.light >= 0.0)
    assert np.all(tree.records["transmittance"] >= threshold)
    assert np.all(np.isfinite(tree.records["x_mm"]) & np.isfinite(tree.records["y_mm"]))
    landed = np.bincount(tree.records["pixel"], tree.records["transmittance"], len(tree.light))
    np.testing.assert_allclose(landed, tree.light[:, LANDED], atol=1e-13)


@pytest.mark.parametrize("name", [*PAPER, TILTED])
def test_the_refracted_branch_is_the_traced_one(name: str) -> None:
    where = scene(name)
    pixels = aimed_pixels(where, np.random.default_rng(2), 3000)
    tree, rays = trace_branches(where, pixels, 1e-7), trace(where, pixels)
    chosen = np.flatnonzero(tree.refracted)
    pixel = tree.records["pixel"][chosen]
    assert np.all(np.diff(pixel) > 0)  # at most one a pixel
    missing = np.setdiff1d(np.flatnonzero(rays.recovered), pixel)
    assert np.all(rays.rays["transmittance"][missing] < 1e-7)
    for axis in ("x_mm", "y_mm"):
        np.testing.assert_allclose(tree.records[axis][chosen], rays.rays[axis][pixel], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        tree.records["transmittance"][chosen], rays.rays["transmittance"][pixel], atol=1e-12
    )
    for record, index in list(zip(chosen.tolist(), pixel.tolist(), strict=True))[::50]:
        assert tree.branch(record) == rays.branches[int(rays.rays["key"][index])]


def replay(where: Scene, pixel: tuple[float, float], codes: list[tuple[int, int]]) -> tuple[mpf, mpf, mpf] | None:
    """Plane point and light of a branch, by vector reflection and refraction at surface points; None near rims."""
    balls = glasses(where)
    o: Vector = tuple(mpf(x) for x in where.camera.position_mm)
    d = pixel_direction(where.camera, *pixel)
    light, worst = mpf(1), mpf(0)

    def unit(v: Vector) -> Vector:
        length = mpmath.sqrt(dot(v, v))
        return tuple(x / length for x in v)

    def mirrored(v: Vector, normal: Vector) -> Vector:
        return tuple(v[k] - 2 * dot(v, normal) * normal[k] for k in range(3))

    for body, kind in codes:
        glass = balls[body]
        hit = roots(o, d, glass)
        if hit is None:
            return None
        o = along(o, hit[0], d)
        normal = unit(tuple(o[k] - glass.centre[k] for k in range(3)))
        worst = max(worst, mpmath.sqrt(max(mpf(0), 1 - dot(d, normal) ** 2)))
        if worst > 0.99:
            return None
        refracted = snell(d, normal, 1 / glass.n)
        if kind == OUTSIDE:
            light *= 1 - (refracted[1] if refracted else 0)
            d = mirrored(d, normal)
            continue
        assert refracted is not None
        d, passes = refracted
        for _ in range(kind + 1):
            o = along(o, -2 * dot(d, tuple(o[k] - glass.centre[k] for k in range(3))), d)
            normal = unit(tuple(glass.centre[k] - o[k] for k in range(3)))
            d_inside, d = d, mirrored(d, normal)
        leaves = snell(d_inside, normal, glass.n)
        assert leaves is not None
        d = leaves[0]
        light *= passes**2 * (1 - passes) ** kind
    t = -o[2] / d[2]
    return (*along(o, t, d)[:2], light) if abs(d[2]) > 0.05 else None


@pytest.mark.parametrize("name", ["one_sphere_250", "two_spheres_500", "pyramid_500", TILTED])
def test_branches_against_textbook_optics(name: str) -> None:
    """Paths with reflections, replayed event by event with 50 digits."""
    where = scene(name)
    rng = np.random.default_rng(8)
    pixels = aimed_pixels(where, rng, 3000)
    tree = trace_branches(where, pixels, 1e-5)
    reflected = np.flatnonzero(~tree.refracted & (tree.records["events"] > 0))
    compared = 0
    for record in rng.choice(reflected, 2500, replace=False):
        entry = tree.records[record]
        codes = tree.codes[entry["first"] : entry["first"] + entry["events"]].tolist()
        seen = replay(where, tuple(pixels[entry["pixel"]].tolist()), codes)
        if seen is None:
            continue
        compared += 1
        error = mpmath.hypot(seen[0] - mpf(float(entry["x_mm"])), seen[1] - mpf(float(entry["y_mm"])))
        assert error <= 1e-8, codes
        assert entry["transmittance"] == pytest.approx(float(seen[2]), rel=1e-9)
    assert compared > 80


def test_names_of_branches() -> None:
    where, pixel = one_ball(70.0)
    tree = trace_branches(where, pixel, 1e-2)
    names = {tree.branch(index) for index in range(len(tree.records))}
    assert names == {("ball",), ("ball outside",), ("ball 2 inside",)}


def test_total_reflection_is_followed() -> None:
    """A bubble sends all light outside from its critical angle on; refraction only loses it."""
    where, pixel = one_ball(70.0, 1.0)
    where = Scene(where.camera, where.bodies, ambient=ConstantMedium(1.333))
    assert trace(where, pixel).rays["status"] == RayStatus.TIR
    tree = trace_branches(where, pixel)
    assert [tree.branch(index) for index in range(len(tree.records))] == [("ball outside",)]
    assert tree.records["transmittance"][0] == pytest.approx(1.0, abs=1e-15)


def test_opaque_bodies_block_every_branch() -> None:
    where, pixel = one_ball(70.0)
    post = Rod("post", (0.0, 0.0, 10.0), (0.0, 0.0, 12.0), 8.0)
    free, blocked = trace_branches(where, pixel), trace_branches(where.with_bodies([*where.bodies, post]), pixel)
    assert free.light[0, BLOCKED] == 0.0
    assert blocked.light[0, BLOCKED] > 0.1
    assert blocked.light.sum() == pytest.approx(1.0, abs=1e-14)


def between_mirrors() -> Scene:
    """A camera on the axis between two balls of n = 10, looking down: each reflects two thirds."""
    upper, lower = ball("upper", 0.0, 0.0, 160.0, 10.0, 10.0), ball("lower", 0.0, 0.0, 30.0, 10.0, 10.0)
    return Scene(camera_at((0.0, 0.0, 100.0)), (upper, lower))


def test_light_caught_between_spheres_is_given_up_not_followed_forever() -> None:
    where = between_mirrors()
    centre = [where.camera.principal_px]
    tree = trace_branches(where, centre, 1e-12)
    bounced = ((10.0 - 1.0) / (10.0 + 1.0)) ** (2 * MAX_EVENTS)
    assert tree.light[0, GIVEN_UP] >= bounced > 1e-12
    assert tree.status.tolist() == [RayStatus.TOO_MANY_EVENTS]
    assert tree.records["events"].max() <= MAX_EVENTS
    assert tree.light.sum() == pytest.approx(1.0, abs=1e-11)
    assert trace_branches(where, centre, 1e-6).light[0, GIVEN_UP] == 0.0


@pytest.mark.parametrize("steps", [1, 2, 7, 50, 300])
def test_light_left_when_the_steps_are_used_up_is_counted(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    where = between_mirrors()
    monkeypatch.setattr("tracer.kernels.tree.MAX_STEPS", steps)
    light, nothing = np.zeros(5), np.zeros((0, 2), np.int32)
    found, _ = follow_tree.py_func(
        *(0.0, 0.0, 100.0, 0.0, 0.0, -1.0, where.sphere_table(), where.rod_table(), 1e-9, 0, False),
        *(np.empty((MAX_EVENTS, FRAME)), np.empty((MAX_EVENTS, FRAME_BODY), np.int32)),
        *(np.empty((MAX_EVENTS, 2), np.int32), light, nothing, nothing, 0, 0),
    )
    assert found <= steps
    assert light[GIVEN_UP] > 0.0
    assert light.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_random_scenes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    where = random_scene(rng)
    tree = trace_branches(where, rng.uniform(0.0, 480.0, (500, 2)), 1e-4)
    np.testing.assert_allclose(tree.light.sum(axis=1), 1.0, atol=1e-12)
    assert np.all(np.isfinite(tree.records["x_mm"]))


def test_same_bits_for_any_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    where = scene("pyramid_500")
    pixels = aimed_pixels(where, np.random.default_rng(3), 9000)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        tree = trace_branches(where, pixels, 1e-3)
        results.append((tree.records.tobytes(), tree.codes.tobytes(), tree.light.tobytes()))
    assert len(set(results)) == 1


def test_compiled_and_interpreted_agree() -> None:
    where, pixel = one_ball(60.0)
    direction = where.camera.directions(pixel)
    outcomes = []
    for function in (follow_tree, follow_tree.py_func):
        light, records, codes = np.zeros(5), np.zeros(50, BRANCH), np.zeros((200, 2), np.int32)
        count = function(
            *(
                *where.camera.position_mm,
                *direction.tolist(),
                where.sphere_table(),
                where.rod_table(),
                1e-6,
                0,
                True,
            ),
            *(np.empty((MAX_EVENTS, FRAME)), np.empty((MAX_EVENTS, FRAME_BODY), np.int32)),
            *(np.empty((MAX_EVENTS, 2), np.int32), light, records.view(np.recarray), codes, 0, 0),
        )
        outcomes.append((count, light, records["x_mm"].copy(), records["transmittance"].copy(), codes))
    assert outcomes[0][0] == outcomes[1][0]
    for one, other in zip(outcomes[0][1:], outcomes[1][1:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("threshold", [0.0, -1.0, 1.1, math.nan, 1e-13])
def test_threshold_out_of_range(threshold: float) -> None:
    where, pixel = one_ball(60.0)
    with pytest.raises(SceneError, match="min_transmittance"):
        trace_branches(where, pixel, threshold)


def test_no_pixels_and_no_bodies() -> None:
    empty = Scene(camera_at())
    assert len(trace_branches(empty, np.empty((0, 2))).records) == 0
    tree = trace_branches(empty, [(3.0, 4.0)])
    assert tree.branch(0) == ()
    assert tree.refracted.tolist() == [True]
    np.testing.assert_array_equal(tree.light, [[1.0, 0.0, 0.0, 0.0, 0.0]])
