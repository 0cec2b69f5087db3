"""Balls among opaque rods: lockstep, and anew what a rod may stop, against every ray by `trace_ray`."""

from dataclasses import replace

import numpy as np
import pytest

import tracer.strategies.ray_map as ray_map
from tests.tracer.scenes import ball, camera_at, random_bodies, random_camera, shrunk
from tracer.bodies import Body, Rod, Sphere
from tracer.scene.scene import Scene
from tracer.strategies.occluders import shadows_of, sides_of
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus, trace

STAND = (  # two balls in a row, a rod to carry each, as a new lab has them
    ball("near", 0.0, 0.0, 90.01, 20.0, 1.49),
    ball("far", 0.0, 0.0, 50.0, 20.0, 1.49),
    Rod("one", (0.0, -24.01, 50.0), (0.0, -84.01, 50.0), 4.0),
    Rod("two", (0.0, -24.01, 90.01), (0.0, -84.01, 90.01), 4.0),
)
VIEW = camera_at(focal_px=1300.0, sensor_px=(192, 192))


def trace_numbered(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> RayMap:
    """The map with every ray by itself."""
    with monkeypatch.context() as patch:
        patch.setattr(ray_map, "choose", lambda where: replace(choose(where), kind=Kind.RAYS))
        return build_ray_map(scene)


def check(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> RayMap:
    """Same branches and fates, places to rounding; a pixel within 1e-9 of a rim may fall on either side of it."""
    assert choose(scene).kind is Kind.OCCLUDERS
    made, single = build_ray_map(scene), trace_numbered(scene, monkeypatch)
    named, wanted = (np.array([" ".join(n) for n in m.branches], dtype=object)[m.branch] for m in (made, single))
    other = (named != wanted) | (made.status != single.status)
    assert other.sum() <= 1, f"{other.sum()} pixels on another branch"
    if not other.any():
        assert made.branches == single.branches
    good = made.recovered & ~other
    rays = trace(scene, np.stack(np.meshgrid(*map(np.arange, scene.camera.sensor_px)), axis=-1)).rays
    apart = np.abs(made.plane_mm - single.plane_mm)
    calm = good & (rays["transmittance"] > 0.5) & (rays["direction"][..., 2] < -0.1)
    assert np.max(apart[calm], initial=0.0) <= 1e-9
    assert np.max(apart[good] / (1.0 + np.hypot(*single.plane_mm[good].T)[:, None] ** 2), initial=0.0) <= 1e-6
    assert np.isnan(made.plane_mm[~made.recovered]).all()
    return made


def test_balls_on_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    made = check(Scene(VIEW, STAND), monkeypatch)
    assert set(made.branches) == {(), ("near",), ("near", "far")}
    stopped = made.status == RayStatus.BLOCKED
    assert 100 < np.count_nonzero(stopped) < 5000


@pytest.mark.parametrize(
    "rod",
    [
        Rod("before", (-30.0, 3.0, 130.0), (30.0, -3.0, 130.0), 2.0),
        Rod("between", (-30.0, 22.0, 66.0), (30.0, 23.0, 74.0), 1.5),
        Rod("behind", (-20.0, 2.0, 3.0), (20.0, -2.0, 5.0), 1.0),
        Rod("upright", (12.0, 30.0, 2.0), (13.0, 31.0, 400.0), 1.0),
        Rod("as high as the pinhole", (60.0, 0.0, 100.0), (150.0, 30.0, 505.0), 3.0),
        Rod("a ball", (3.0, 2.0, 8.0), (3.0, 2.0, 8.0), 4.0),
        Rod("touching", (20.5, 0.0, 50.0), (60.0, 0.0, 50.0), 0.5),
    ],
    ids=lambda rod: rod.name,
)
@pytest.mark.parametrize("position", [(0.0, 0.0, 500.0), (90.0, -140.0, 420.0)])
def test_a_rod_anywhere(rod: Rod, position: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    camera = camera_at(position, focal_px=1300.0, sensor_px=(160, 160))
    check(Scene(camera, (*STAND[:2], rod)), monkeypatch)


def test_a_rod_that_dips_below_a_light_sheet(monkeypatch: pytest.MonkeyPatch) -> None:
    """`trace_ray` stops rays that meet a body behind the plane: so must this, through glass as beside it."""
    rods = [Rod(f"low {y}", (-30.0, y, 0.1), (30.0, y, 0.1), 0.55) for y in (-18.0, -9.0, 9.0, 18.0)]
    scene = Scene(VIEW, (*STAND[:2], *rods), cut_mm=0.5)
    check(scene, monkeypatch)
    assert np.isinf(sides_of(scene, scene.other_tables()[0].rows)[..., 2]).all()


def test_a_rod_between_two_balls_and_seen_from_neither_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes part it from what is before the first ball and from what is behind the second, not from between."""
    bodies = ball("near", 0.0, 0.0, 140.0, 20.0, 1.2), ball("far", 0.0, 0.0, 30.0, 20.0, 1.2)
    made = check(
        Scene(VIEW, (*bodies, Rod("in the middle", (-40.0, 1.0, 85.0), (40.0, -1.0, 85.0), 3.0))), monkeypatch
    )
    near = made.branches.index(("near",))
    assert ((made.branch == near) & (made.status == RayStatus.BLOCKED)).sum() > 100


@pytest.mark.parametrize("seed", range(12))
def test_random_balls_among_random_rods(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    balls: list[Body] = random_bodies(rng, (0, 1, 2, 4)[seed % 4])
    rods: list[Body] = []
    while len(rods) < 1 + seed % 3:
        radius = float(rng.uniform(0.3, 3.0))
        start, end = rng.uniform((-50.0, -50.0, radius), (50.0, 50.0, 90.0), (2, 3)).tolist()
        rod = Rod(f"r{len(rods)}", tuple(start), tuple(end), radius)
        if all(rod.gap_to_ball_mm(one) > 0.0 for one in Sphere.among(balls)):
            rods.append(rod)
    camera = shrunk(random_camera(rng, [*balls, *rods]), 4.0)
    if camera.position_mm[2] > 90.0:
        check(Scene(camera, (*balls, *rods)), monkeypatch)


@pytest.mark.slow  # compiles ten seconds of kernels that no command calls
def test_maps_stored_as_float32_and_threads_have_the_same_fates() -> None:
    scene = Scene(VIEW, STAND)
    double, single = build_ray_map(scene), build_ray_map(scene, single=True)
    np.testing.assert_array_equal(double.status, single.status)
    np.testing.assert_array_equal(double.branch, single.branch)
    np.testing.assert_array_equal(double.plane_mm.astype(np.float32), single.plane_mm)


def test_most_rays_are_not_traced_twice() -> None:
    """Beside a ball that is carried from below, only the shadow and the ball's lower rim are in doubt."""
    scene = Scene(VIEW, STAND)
    rows = scene.other_tables()[0].rows
    sides, shadows = sides_of(scene, rows), shadows_of(scene, rows)
    assert np.isfinite(sides[1:, :, 2]).all()  # a plane parts each rod from each way
    assert (sides[1:, :, 2] < -19.9).all()
    assert (np.sqrt(shadows[:, 5]) < 1.3 * 4.0).all()  # half widths [mm] of rods of 4 mm: 500 / 410 nearer
    moved = scene.with_bodies([body.moved(lambda p: (p[0], p[1] + 0.003 * p[2], p[2] + 0.2)) for body in STAND])
    assert np.isfinite(sides_of(moved, moved.other_tables()[0].rows)[[1, 3], :, 2]).all()
