"""Windows, tubes and domes, alone and in one another, balls before, behind and inside: against 50 digits."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from correction.grid import PlaneGrid
from correction.maps.correction_map import build_correction_map
from rtpiv.analysis.views.field_of_view import field_of_view
from tests.loops import loop_over
from tests.tracer.drawn_walls import (
    AIR_CAMERA,
    GLASS,
    WATER,
    aimed,
    among_all_kinds,
    dome,
    drawn_walls,
    seen,
    tube,
    window,
)
from tests.tracer.scenes import camera_at, flat, halves
from tests.tracer.walls_reference import Walls, follow_walls, unit, vector
from tracer.bodies import Body, Sphere, Window
from tracer.errors import SceneError
from tracer.kernels.dome import cross_dome, dome_rates, leave_dome
from tracer.kernels.rooms import IN, OFF, OUT, THROUGH
from tracer.kernels.tube import cross_tube, leave_tube, tube_rates
from tracer.kernels.window import cross_window, window_rates
from tracer.kernels.world import ENTERED, KINDS, MOST_NUMBERS, OFF_INSIDE
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.ray_map import build_ray_map
from tracer.strategies.sensitivity import CAMERA, SPHERE, TARGET, Landings, TargetPose, landings, landings_through
from tracer.strategies.trace import RayStatus, trace, trace_from, world_from

STATUS = {
    "recovered": RayStatus.RECOVERED,
    "tir": RayStatus.TIR,
    "missed": RayStatus.MISSED_PLANE,
    "blocked": RayStatus.BLOCKED,
}
LEVEL = 0.05  # a ray less than 3 degrees from level lands far away, and rounding with it


def judge(scenes: int, rays: int, seed: int, both: bool) -> int:
    """Follow random rays through random scenes both ways; returns how many landed."""
    rng, landed = np.random.default_rng(seed), 0
    for _ in range(scenes):
        scene = drawn_walls(rng, both)
        start = np.array(scene.camera.position_mm)
        ways = aimed(rng, scene, rays)
        traced = trace_from(scene, np.broadcast_to(start, ways.shape), ways)
        walls = Walls(scene)
        for ray, way in zip(traced.rays, ways.tolist(), strict=True):
            end = follow_walls(walls, vector(tuple(start.tolist())), vector(tuple(way)))
            assert RayStatus(ray["status"]) == STATUS[end.status], (scene, way)
            if end.status != "recovered":
                continue
            landed += 1
            level = 1.0 if abs(end.direction[2]) > LEVEL else 1e4
            bound = level * (1e-9 if end.steepest < 0.99 else 1e-5)
            assert (
                mpmath.hypot(end.point[0] - mpf(float(ray["x_mm"])), end.point[1] - mpf(float(ray["y_mm"])))
                < bound
            )
            assert abs(end.path - mpf(float(ray["path_mm"]))) < bound
            assert abs(end.passed - mpf(float(ray["transmittance"]))) < 1e-6
            names = (re.sub("( off)? core$", "", name) for name in traced.branches[int(ray["key"])])
            assert tuple(names) == end.branch
    return landed


def test_random_rays_against_50_digits() -> None:
    assert judge(scenes=12, rays=12, seed=11, both=True) > 100


@pytest.mark.slow
def test_many_random_rays_against_50_digits() -> None:
    assert judge(scenes=150, rays=20, seed=12, both=False) > 2_000


@pytest.mark.slow
def test_derivatives_are_those_of_the_rays() -> None:
    rng, step, judged = np.random.default_rng(5), 1e-5, 0
    for _ in range(20):
        scene = drawn_walls(rng)
        scene = scene.with_camera(replace(scene.camera, focal_px=2000.0))
        pixels = rng.uniform(-200.0, 250.0, (20, 2))
        here, eye = landings(scene, pixels), np.array(scene.camera.position_mm)

        def seen(pixel: int | None, place: int | None, by: float, scene: Scene = scene) -> Landings:
            moved = pixels + by * np.eye(2)[pixel] if pixel is not None else pixels  # noqa: B023
            at = eye + by * np.eye(3)[place] if place is not None else eye  # noqa: B023
            camera = replace(scene.camera, position_mm=tuple(at.tolist()))
            return landings(scene.with_camera(camera), moved)

        rates = [(here.pixel_rate[:, :, k], (k, None)) for k in range(2)]
        rates += [(here.columns([f"camera.{name}"])[:, :, 0], (None, k)) for k, name in enumerate("xyz")]
        for rate, what in rates:
            same, differences = here.recovered, []
            for by in (step, 0.5 * step):
                ahead, back = seen(*what, by), seen(*what, -by)
                same = same & (ahead.key == here.key) & (back.key == here.key) & ahead.recovered & back.recovered
                differences.append((ahead.point_mm - back.point_mm) / (2.0 * by))
            numeric = (4.0 * differences[1] - differences[0]) / 3.0  # Richardson: some rays bend steeply
            size = 0.01 + np.abs(numeric).max(axis=1, keepdims=True)
            assert (np.abs(numeric - rate) < 2e-6 * size)[same].all()
            judged += int(same.sum())
    assert judged > 1000


@pytest.mark.slow
def test_landing_points_follow_every_row() -> None:
    """Columns of all walls of drawn scenes at once, backwards, against differences of the rays."""
    rng, step, judged = np.random.default_rng(6), 1e-5, 0
    for _ in range(6):
        scene = drawn_walls(rng)
        scene = scene.with_camera(replace(scene.camera, focal_px=2000.0))
        pixels = rng.uniform(-200.0, 250.0, (40, 2))
        here, tables = landings(scene, pixels), scene.other_tables()
        calm = here.recovered & (np.abs(here.pixel_rate).max(axis=(1, 2)) < 5.0)  # others: noise
        place, called = len(CAMERA) + len(SPHERE) * len(scene.spheres), iter(scene.others)
        for number, table in enumerate(tables):
            parts = KINDS[type(table)].numbers
            for which in range(len(table.rows)):
                name = next(called).name
                assert here.names[place : place + len(parts)] == tuple(f"{name}.{part}" for part in parts)
                for k in range(len(parts)):
                    move = np.zeros_like(table.rows)
                    move[which, k] = 1.0
                    if 3 <= k < 6:  # the direction stays one of length 1
                        move[which, 3:6] -= table.rows[which, k] * table.rows[which, 3:6]
                    seen = []
                    for by in (step, -step):
                        moved = [*tables]
                        moved[number] = type(table)(table.rows + by * move)
                        world = world_from(scene.sphere_table(), tuple(moved), scene.rooms())
                        seen.append(landings_through(scene.camera, world, pixels, TargetPose()))
                    same = calm & (seen[0].key == here.key) & (seen[1].key == here.key)
                    same &= seen[0].recovered & seen[1].recovered
                    numeric = (seen[0].point_mm - seen[1].point_mm) / (2.0 * step)
                    rate = here.rate[:, :, place : place + len(parts)] @ move[which]
                    size = 0.1 + np.abs(numeric).max(axis=1, keepdims=True)
                    assert (np.abs(numeric - rate) < 2e-6 * size)[same].all()
                    judged += int((same & (numeric != 0.0).any(axis=1)).sum())
                place += len(parts)
        assert here.names[place:] == tuple(f"target.{part}" for part in TARGET)
        world = world_from(scene.sphere_table(), tables, scene.rooms())
        less = landings_through(scene.camera, world, pixels, TargetPose(), by_walls=False)
        first = len(CAMERA) + len(SPHERE) * len(scene.spheres)
        without = np.concatenate((here.rate[:, :, :first], here.rate[:, :, place:]), axis=2)
        np.testing.assert_array_equal(less.rate, without)
        assert len(less.names) == less.rate.shape[2]
    assert judged > 1000


def behind(cross: Callable[..., tuple[float, ...]], ray: np.ndarray, row: np.ndarray) -> tuple[int, np.ndarray]:
    """Fate, and point and direction behind a wall (6,)."""
    fate, *numbers = cross(*halves(ray), row)
    return int(fate), np.array(flat(numbers)[:6])


@pytest.mark.parametrize(
    ("what", "cross", "rates", "eye", "way"),
    [
        ("window", cross_window, window_rates, (30.0, -20.0, 400.0), IN),
        ("tube", cross_tube, tube_rates, (8.0, 10.0, 400.0), IN),
        ("tube", cross_tube, tube_rates, (8.0, 48.3, 400.0), THROUGH),
        ("tube", cross_tube, tube_rates, (8.0, 45.6, 400.0), OFF),
        ("tube", leave_tube, tube_rates, (8.0, 10.0, 20.0), OUT),
        ("dome", cross_dome, dome_rates, (8.0, 10.0, 400.0), IN),
        ("dome", cross_dome, dome_rates, (8.0, 48.3, 400.0), THROUGH),
        ("dome", cross_dome, dome_rates, (8.0, 45.6, 400.0), OFF),
        ("dome", leave_dome, dome_rates, (8.0, 10.0, 20.0), OUT),
    ],
)
def test_rays_follow_every_number_of_a_wall(
    what: str, cross: Callable[..., tuple[float, ...]], rates: Callable[..., tuple[float, ...]],
    eye: tuple[float, float, float], way: int,
) -> None:  # fmt: skip
    """Derivatives by each number of the row, which no scene uses yet, against differences of the ray itself."""
    inner = {THROUGH: 30.0, OFF: 40.0}.get(way, 45.0)
    ends = {"start_mm": (-80.0, 0.1, 60.0), "end_mm": (80.0, -0.1, 70.0)}
    high = tube(**ends, inner_radius_mm=inner, filled=ConstantMedium(1.1))
    tilted = window(normal=tuple(float(x) for x in unit((0.1, 0.2, 1.0))), behind=None)
    flask = dome(centre_mm=(1.0, 0.1, 65.0), inner_centre_mm=(0.8, 0.3, 65.4), filled=ConstantMedium(1.1))
    walls = {"window": tilted, "tube": high, "dome": replace(flask, inner_radius_mm=inner)}
    (row,) = Scene(AIR_CAMERA, (walls[what],)).other_tables()[0].rows
    ray = np.array([*eye, *(float(x) for x in unit((0.02, -0.001, -1.0)))])
    if way == OUT:
        ray[5] *= -1.0
    axis = 10 if what == "dome" else 3  # where the direction stands in the row
    fate, _ = behind(cross, ray, row)
    assert fate == {IN: ENTERED, OUT: ENTERED, OFF: OFF_INSIDE, THROUGH: 0}[way]
    step = 1e-5
    for number in range(len(row)):
        rate = np.zeros(MOST_NUMBERS)
        rate[number] = 1.0
        if axis <= number < axis + 3:  # the direction stays one of length 1
            rate[axis : axis + 3] -= row[number] * row[axis : axis + 3]
        ahead, back = (behind(cross, ray, row + s * rate[: len(row)])[1] for s in (step, -step))
        numeric = (ahead - back) / (2.0 * step)
        found = np.array(flat(rates(*halves(ray), *halves(np.zeros(6)), row, rate, way)))
        np.testing.assert_allclose(found, numeric, rtol=1e-6, atol=2e-7, err_msg=f"{what} {number}")


def test_what_is_no_glass_does_nothing() -> None:
    """A plate, a tube and a shell of their surroundings' medium, or of no thickness, leave the ray where it is."""
    air = ConstantMedium(1.0)
    pixels = np.random.default_rng(1).uniform(0.0, 60.0, (200, 2))
    ball = Sphere("ball", (0.0, 0.0, 20.0), 15.0, GLASS)
    bare = seen(Scene(AIR_CAMERA, (ball,)), pixels).plane_mm
    no_window = window(medium=air, behind=None)
    for walls in (
        (no_window, tube(medium=air)),
        (window(medium=air, behind=air, normal=(0.0, 0.6, 0.8)), tube(medium=air, filled=air)),
        (no_window, tube(inner_radius_mm=50.0 - 1e-9)),
    ):
        through = seen(among_all_kinds(*walls, ball), pixels).plane_mm
        bound = 1e-12 if walls[1].medium == air else 1e-9
        np.testing.assert_allclose(through, bare, rtol=0.0, atol=bound * 400.0)
    for nothing in (dome(medium=air), dome(inner_radius_mm=50.0 - 1e-9, inner_centre_mm=None)):
        through = seen(among_all_kinds(no_window, nothing, ball), pixels).plane_mm
        np.testing.assert_allclose(through, bare, rtol=0.0, atol=4e-10 if nothing.medium == air else 4e-7)


def test_a_camera_in_the_middle_of_a_dome_sees_straight() -> None:
    """Rays from the centre meet both spheres at right angles; from beside it they do not."""
    port = dome(centre_mm=(0.0, 0.0, 400.0), inner_centre_mm=None, axis=(0.0, 0.0, -1.0), half_angle_deg=30.0)
    ball = Sphere("ball", (0.0, 0.0, 20.0), 15.0, GLASS)
    pixels = np.random.default_rng(3).uniform(0.0, 60.0, (200, 2))
    for water, air in ((WATER, ConstantMedium(1.0)), (ConstantMedium(1.0), WATER)):
        wet = among_all_kinds(replace(port, filled=air), ball, ambient=water)
        dry = seen(Scene(AIR_CAMERA, (ball,), ambient=water), pixels).plane_mm
        np.testing.assert_allclose(seen(wet, pixels).plane_mm, dry, rtol=0.0, atol=1e-9)
        aside = replace(port, filled=air, centre_mm=(0.0, 1.0, 400.0))
        assert np.nanmax(np.abs(seen(among_all_kinds(aside, ball, ambient=water), pixels).plane_mm - dry)) > 0.1
    shut = seen(among_all_kinds(replace(port, half_angle_deg=0.1), ball), pixels)
    assert 0.5 < (shut.rays["status"] == RayStatus.BLOCKED).mean() < 1.0
    shut = seen(among_all_kinds(replace(port, axis=(0.0, 0.0, 1.0)), ball), pixels)
    assert (shut.rays["status"] == RayStatus.BLOCKED).all()


def test_a_ball_knows_the_medium_in_which_it_stands() -> None:
    """In a liquid of its own index a ball is not there; its n counts against the liquid, not the air."""
    liquid = ConstantMedium(1.5195)
    pixels = np.random.default_rng(2).uniform(0.0, 60.0, (100, 2))
    ball = Sphere("ball", (0.0, 0.0, 20.0), 15.0, GLASS)
    walls = (window(behind=liquid), tube(medium=liquid))
    with_ball = seen(among_all_kinds(*walls, ball), pixels).plane_mm
    without = seen(among_all_kinds(*walls), pixels).plane_mm
    np.testing.assert_allclose(with_ball, without, rtol=0.0, atol=1e-10)
    assert among_all_kinds(*walls, ball).sphere_table()[0, 4] == 1.0


def test_no_wall_stands_between_bodies_of_the_cameras_room_and_the_camera() -> None:
    ball, beside = Sphere("ball", (0.0, 0.0, 20.0), 5.0, GLASS), Sphere("beside", (0.0, 70.0, 20.0), 5.0, GLASS)
    assert among_all_kinds(ball).in_camera_room(ball)
    around = among_all_kinds(tube(), ball, beside)
    assert [around.in_camera_room(one) for one in (ball, beside)] == [False, True]
    behind = among_all_kinds(window(), ball)
    assert not behind.in_camera_room(ball)


def test_the_order_of_bodies_does_not_matter() -> None:
    rng = np.random.default_rng(8)
    for _ in range(5):
        scene = drawn_walls(rng)
        turned = scene.with_bodies(scene.bodies[::-1])
        assert turned.content_hash() == scene.content_hash()
        pixels = rng.uniform(0.0, 60.0, (50, 2))
        np.testing.assert_array_equal(seen(scene, pixels).plane_mm, seen(turned, pixels).plane_mm)


def test_every_number_is_in_the_hash() -> None:
    known = {Scene(AIR_CAMERA, (window(),)).content_hash(), Scene(AIR_CAMERA, (tube(),)).content_hash()}
    changed = [
        window(centre_mm=(0.0, 0.0, 151.0)), window(normal=(0.0, 0.6, 0.8)), window(thickness_mm=9.0),
        window(radius_mm=90.0), window(medium=WATER), window(behind=None), dome(), dome(inner_centre_mm=None),
        dome(centre_mm=(0.0, 0.0, 1.0)), dome(outer_radius_mm=51.0), dome(inner_radius_mm=44.0),
        dome(medium=WATER), dome(filled=WATER), dome(half_angle_deg=50.0),
        dome(half_angle_deg=50.0, axis=(0.0, 0.6, 0.8)), tube(start_mm=(-81.0, 0.0, 0.0)),
        tube(outer_radius_mm=51.0), tube(inner_radius_mm=44.0), tube(medium=WATER), tube(filled=WATER),
    ]  # fmt: skip
    for number, wall in enumerate(changed, start=3):
        known.add(Scene(AIR_CAMERA, (wall,)).content_hash())
        assert len(known) == number


@pytest.mark.slow  # compiles an inversion for these kinds, 40 s
def test_a_map_behind_walls_is_inverted() -> None:
    """Each node's pixel sees the node; direct views are sought behind a window, where no line is straight."""
    ball = Sphere("ball", (0.0, 2.0, 7.0), 4.0, ConstantMedium(1.6))
    camera = camera_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), 2600.0, (160, 120))
    tilted = tuple(float(x) for x in unit((0.02, -0.03, 1.0)))
    walls = (window(normal=tilted), tube(filled=ConstantMedium(1.0)))
    scene = among_all_kinds(*walls, ball).with_camera(camera)
    ray_map = build_ray_map(scene)
    found = build_correction_map(scene, ray_map, PlaneGrid((-9.0, 7.0), 0.5, (29, 37)))
    assert set(ray_map.branches) >= {(), ("ball",)}
    back = trace(scene, found.pixel[0][found.recovered]).plane_mm
    np.testing.assert_allclose(back, found.grid.nodes_mm()[found.recovered], rtol=0.0, atol=1e-9)
    seen = {found.branches[number] for number in np.unique(found.branch[0][found.recovered])}
    assert seen >= {(), ("ball",)}
    assert found.recovered.mean() > 0.7


def test_scene_files_hold_walls(tmp_path: Path) -> None:
    ends = {"start_mm": (-30.0, 70.0, 9.0), "end_mm": (30.0, 70.0, 9.0)}
    rod = tube(name="rod", **ends, outer_radius_mm=3.0, inner_radius_mm=0.0)
    flask = dome(centre_mm=(0.0, -130.0, 0.0), inner_centre_mm=None, axis=(0.0, 0.6, 0.8), half_angle_deg=80.0)
    balls = (Sphere("b", (0.0, 0.0, 20.0), 9.0, GLASS),)
    walls = (window(), tube(filled=ConstantMedium(1.0)), rod, flask)
    scene = Scene(AIR_CAMERA, (*walls, *balls))
    (tmp_path / "scene.yaml").write_text(dump_scene(scene))
    again = load_scene(tmp_path / "scene.yaml")
    assert again.content_hash() == scene.content_hash()
    assert again.bodies == scene.bodies


def ball(z_mm: float) -> Sphere:
    return Sphere("b", (0.0, 0.0, z_mm), 5.0, GLASS)


def sideways() -> Window:
    """The other window of a tank, through which nobody looks."""
    return window(name="side", centre_mm=(90.0, 0.0, 60.0), normal=(1.0, 0.0, 0.0), radius_mm=50.0)


@loop_over("bodies, words",
    [
        (lambda: (tube(), ball(46.0)), "tube 'tube' cuts body 'b'"),
        (lambda: (window(), ball(150.0)), "window 'window' cuts body 'b'"),
        (lambda: (window(), tube(start_mm=(0.0, 0.0, 20.0), end_mm=(0.0, 0.0, 200.0))), "cuts body 'tube'"),
        (lambda: (window(centre_mm=(0.0, 0.0, 405.0)),), "the camera stands in the glass"),
        (lambda: (tube(inner_radius_mm=60.0),), "less than outer_radius_mm"),
        (lambda: (tube(end_mm=(-80.0, 0.0, 0.0)),), "two points"),
        (lambda: (tube(), tube(name="b", start_mm=(0.0, 0.0, 5.0), outer_radius_mm=47.0)), "cuts body"),
        (lambda: (dome(), ball(44.0)), "dome 'dome' cuts body 'b'"),
        (lambda: (dome(centre_mm=(0.0, 0.0, 352.0), inner_centre_mm=None),), "stands in the glass of 'dome'"),
        (lambda: (dome(inner_centre_mm=(5.0, 0.0, 0.0)),), "reaches through the outer one"),
        (lambda: (dome(inner_radius_mm=50.0),), "less than outer_radius_mm"),
        (lambda: (tube(inner_radius_mm=0.0, filled=WATER),), "has no inside"),
        (lambda: (tube(inner_radius_mm=0.0), ball(20.0)), "overlap by"),
        (
            lambda: (
                tube(inner_radius_mm=0.0),
                tube(name="b", inner_radius_mm=0.0, start_mm=(0.0, -80.0, 90.0), end_mm=(0.0, 80.0, 90.0)),
            ),
            "bodies 'tube' and 'b' overlap by 10 mm",
        ),
        (lambda: (window(), sideways(), ball(20.0)), "window 'side' cuts body 'window'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(bodies: Callable[[], tuple[Body, ...]], words: str) -> None:
    with pytest.raises(SceneError, match=re.escape(words)):
        Scene(AIR_CAMERA, bodies())


def test_a_radial_field_of_view_is_for_round_spheres_alone() -> None:
    """A window bends the rays as well: the curve of the spheres alone would be that of another scene."""
    for bodies in ((window(), ball(20.0)), (replace(ball(20.0), shape_um=(5.0,) + 44 * (0.0,)),)):
        with pytest.raises(SceneError, match="radial field of view is for"):
            field_of_view(Scene(AIR_CAMERA, bodies))
    assert field_of_view(Scene(AIR_CAMERA, (ball(20.0),))).radius_mm == 5.0
