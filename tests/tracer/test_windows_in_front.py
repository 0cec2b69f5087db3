"""A sensor traced through windows block by block, against the march that knows rooms."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from correction.maps.correction_map import build_correction_map
from tests.tracer.drawn_walls import GLASS, WATER, among_all_kinds, seen
from tests.tracer.scenes import camera_at
from tracer.bodies import Body, Sphere, Tube, Window
from tracer.camera import Lens
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.lockstep import ALL_SKIPS, SKIP_MIRRORED, find_mirrors, trace_lockstep
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.strategy import Kind, Strategy, choose
from tracer.strategies.trace import RayStatus

NEAR_MM = 150.0
CAMERA = camera_at((12.0, -7.0, 400.0), (0.0, 0.0, 0.0), 900.0, (150, 131))


def window(z_mm: float, name: str, radius_mm: float = 90.0, behind: ConstantMedium | None = None) -> Window:
    normal = np.array([0.05, -0.08, 1.0])
    normal /= np.linalg.norm(normal)
    return Window(name, (0.0, 0.0, z_mm), tuple(normal.tolist()), 8.0, radius_mm, GLASS, behind)


def balls(n: float = 1.6) -> tuple[Body, ...]:
    places = ((0.0, 0.0, 20.0), (25.0, 5.0, 60.0), (-16.0, 12.0, 72.0), (2.0, -40.0, 26.0))
    return tuple(Sphere(f"b{k}", at, 18.0, ConstantMedium(n)) for k, at in enumerate(places))


def check(scene: Scene, *, few: bool = True) -> dict[int, int]:
    """Compare with the march, which has been compiled for walls of all kinds; how many pixels have each status.

    Those walls stand far off: what flies that far is left out.
    """
    assert choose(scene).kind is (Kind.LOCKSTEP if few else Kind.BUNDLES)
    made = build_ray_map(scene)
    height, width = made.status.shape
    v, u = np.mgrid[0:height, 0:width]
    marched = seen(among_all_kinds(*scene.bodies).with_camera(scene.camera), np.stack((u, v), axis=-1) * 1.0)
    with np.errstate(invalid="ignore"):
        near, near_there = ((np.abs(plane) < NEAR_MM).all(axis=2) for plane in (made.plane_mm, marched.plane_mm))
    np.testing.assert_array_equal(near, near_there)
    assert (marched.rays["status"][made.status == RayStatus.BLOCKED] == RayStatus.BLOCKED).all()
    np.testing.assert_allclose(made.plane_mm[near], marched.plane_mm[near], rtol=0.0, atol=1e-10)
    names = [marched.branches[int(key)] for key in marched.rays["key"][near]]
    assert [made.branches[number] for number in made.branch[near]] == names
    numbers, counts = np.unique(made.status, return_counts=True)
    return dict(zip(numbers.tolist(), counts.tolist(), strict=True))


def test_a_furnace() -> None:
    statuses = check(Scene(CAMERA, (window(150.0, "window"), *balls())))
    assert statuses[0] > 10_000


def test_a_tank_behind_two_windows_and_a_lens_with_distortion() -> None:
    two = (window(150.0, "outer"), window(130.0, "inner", 20.0, WATER))
    bent = replace(CAMERA, lens=Lens(k1=-0.05, p1=1e-3))
    statuses = check(Scene(bent, (*balls(1.5195), *two)))
    assert statuses[1] > 100  # beside the inner opening


def test_a_window_alone() -> None:
    assert check(Scene(CAMERA, (window(150.0, "window"),)))[0] > 10_000


def in_rows(medium: Callable[[int], ConstantMedium | None]) -> tuple[Body, ...]:
    """Four rows of six balls."""
    rng = np.random.default_rng(5)
    places = [(22.0 * (k % 6) - 55.0, 22.0 * (k // 6) - 33.0, 12.0 + 30.0 * rng.random()) for k in range(24)]
    return tuple(Sphere(f"b{k}", at, 10.9, medium(k)) for k, at in enumerate(places))


@pytest.mark.parametrize("kind", ["many", "bubbles and stones", "half shut"])
def test_a_bed_in_a_tank(kind: str) -> None:
    """In bundles: many balls; some thinner than the liquid, some opaque; seen through a porthole."""
    mixed = kind == "bubbles and stones"
    bed = in_rows(
        lambda k: None if mixed and k % 5 == 0 else ConstantMedium((1.5195, 1.2, 1.9)[k % 3] if mixed else 1.6)
    )
    tank = window(150.0, "tank", 30.0 if kind == "half shut" else 90.0, WATER)
    outer = window(170.0, "outer")
    statuses = check(Scene(CAMERA, (*bed, tank, outer)), few=False)
    assert statuses[0] > 4000
    assert statuses.get(int(RayStatus.BLOCKED), 0) > (100 if kind != "many" else -1)


@pytest.mark.slow  # compiles the march for windows alone, which names what is not the usual case
def test_a_window_that_leans_far() -> None:
    """Some rays pass beside the window's plane, some come back to it, some see its edge."""
    leaning = replace(window(60.0, "window", 40.0), normal=(0.8, 0.0, 0.6), centre_mm=(70.0, 0.0, 60.0))
    ball = Sphere("b", (0.0, 0.0, 12.0), 10.0, GLASS)
    wide = camera_at((150.0, 0.0, 300.0), (40.0, 0.0, 0.0), 250.0, (160, 90))
    statuses = check(Scene(wide, (leaning, ball)))
    assert statuses[0] > 1000
    stone = Sphere("stone", (-30.0, 0.0, 12.0), 10.0, None)
    statuses = check(Scene(wide, (leaning, ball, stone)), few=False)  # not in bundles, after all
    assert statuses[0] > 1000


@pytest.mark.parametrize("threads", ["1", "3"])
def test_same_bits_for_any_threads(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(CAMERA, (window(150.0, "window"), *balls()))
    once = build_ray_map(scene)
    monkeypatch.setenv("RTPIV_THREADS", threads)
    again = build_ray_map(scene.with_bodies(scene.bodies[::-1]))
    assert once.plane_mm.tobytes() == again.plane_mm.tobytes()
    assert once.branch.tobytes() == again.branch.tobytes()


def skipless(scene: Scene, skips: int = 0) -> RayMap:
    """Trace a map without the skips that are not named."""
    windows, made = choose(scene).windows, build_ray_map(scene)
    assert len(windows) > 0
    plane, status, branch = (
        np.full_like(made.plane_mm, 7.0),
        np.empty_like(made.status),
        np.empty_like(made.branch),
    )
    branches = trace_lockstep(scene, plane, status, branch, skips, windows)
    return replace(made, plane_mm=plane, status=status, branch=branch, branches=branches)


def test_silhouettes_seen_aslant_through_liquid_skip_nothing() -> None:
    """Where straight rays to where the balls seem to stand are off by ten pixels."""
    row = tuple(Sphere(f"b{k}", (60.0 * k - 200.0, 4.0 * k, 15.0 + 5.0 * k), 6.0, GLASS) for k in range(8))
    aslant = replace(
        camera_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), 1500.0, (1500, 30)), principal_px=(600.0, 100.0)
    )
    scene = Scene(aslant, (window(150.0, "window", 400.0, WATER), *row))
    made, slow = build_ray_map(scene), skipless(scene)
    assert (made.branch > 0).sum() > 1000
    assert (made.branch == 0).sum() > 10_000
    np.testing.assert_array_equal(made.branch, slow.branch)
    np.testing.assert_array_equal(made.status, slow.status)
    np.testing.assert_allclose(made.plane_mm, slow.plane_mm, rtol=0.0, atol=1e-11)


def test_a_porthole_shuts_pixel_by_pixel() -> None:
    """Blocks that straddle the rim, blocks within it, blocks beside it."""
    upright = replace(window(150.0, "porthole", 40.0), normal=(0.0, 0.0, 1.0))
    scene = Scene(replace(CAMERA, sensor_px=(700, 131)), (upright, *balls()))
    made = build_ray_map(scene)
    again = build_ray_map(scene.with_bodies((replace(upright, radius_mm=4000.0), *balls())))
    v, u = np.mgrid[0:131, 0:700]
    ray = scene.camera.directions(np.stack((u, v), axis=-1) * 1.0)
    entry = np.array((12.0, -7.0)) - 250.0 * ray[..., :2] / ray[..., 2:]
    leaving = entry + 8.0 * ray[..., :2] / np.sqrt(1.5195**2 - ray[..., 0] ** 2 - ray[..., 1] ** 2)[..., None]
    shut = np.maximum(np.hypot(*np.moveaxis(entry, -1, 0)), np.hypot(*np.moveaxis(leaving, -1, 0))) >= 40.0
    np.testing.assert_array_equal(made.status == RayStatus.BLOCKED, shut)
    assert 10_000 < shut.sum() < 80_000
    assert not (again.status == RayStatus.BLOCKED).any()
    np.testing.assert_array_equal(made.branch[~shut], again.branch[~shut])
    np.testing.assert_allclose(made.plane_mm[~shut], again.plane_mm[~shut], rtol=0.0, atol=1e-11)


def test_a_mirror_image_is_what_tracing_it_gives() -> None:
    straight = camera_at((0.0, 0.0, 400.0), (0.0, 0.0, 0.0), 900.0, (150, 131))
    upright = replace(window(150.0, "window"), normal=(0.0, 0.0, 1.0))
    pair = tuple(Sphere(f"b{k}", (x, 0.0, 20.0), 15.0, GLASS) for k, x in enumerate((-20.0, 20.0)))
    scene = Scene(straight, (upright, *pair))
    made, whole = build_ray_map(scene), skipless(scene, ALL_SKIPS & ~SKIP_MIRRORED)
    assert made.plane_mm.tobytes() == whole.plane_mm.tobytes()
    assert made.branch.tobytes() == whole.branch.tobytes()
    leaning = scene.with_bodies((replace(upright, normal=(0.6, 0.0, 0.8), radius_mm=60.0), *pair))
    mirrors = find_mirrors(leaning, choose(leaning).windows)
    assert (mirrors.in_x, mirrors.in_y) == (False, True)


def test_what_else_stands_there_goes_by_the_march() -> None:
    one = window(150.0, "window")
    beside = Tube("tube", (-40.0, -60.0, 90.0), (40.0, -60.0, 90.0), 9.0, 0.0, GLASS)
    bubble = Sphere("bubble", (0.0, 0.0, 20.0), 9.0, ConstantMedium(1.0))
    before = Sphere("before", (0.0, 0.0, 250.0), 9.0, GLASS)
    tank = replace(one, behind=WATER)
    for bodies in ((one, *balls(), beside), (one, *balls(), before)):
        assert choose(Scene(CAMERA, bodies)).kind is Kind.RAYS
    assert choose(Scene(CAMERA, (tank, bubble))).kind is Kind.BUNDLES
    assert choose(Scene(CAMERA, (one, *balls()))).kind is Kind.LOCKSTEP
    assert len(choose(Scene(CAMERA, balls())).windows) == 0


@pytest.mark.slow  # compiles an inversion for windows alone
@pytest.mark.parametrize("kind", ["few", "one window", "many"])
def test_its_map_is_inverted_in_blocks_as_node_by_node(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the careful Newton for every node, on the map of the march."""
    behind = in_rows(lambda k: ConstantMedium(1.6)) if kind == "many" else balls()
    before = () if kind == "one window" else (window(170.0, "outer"),)
    scene = Scene(
        replace(CAMERA, lens=Lens(k1=-0.05, p1=1e-3)), (*before, window(150.0, "window", 60.0, WATER), *behind)
    )
    blocks = build_correction_map(scene, build_ray_map(scene), layers=2)

    def trace_numbered(where: Scene) -> Strategy:
        return replace(choose(where), kind=Kind.RAYS, in_blocks=False)

    monkeypatch.setattr("tracer.strategies.ray_map.choose", trace_numbered)
    monkeypatch.setattr("correction.maps.correction_map.choose", trace_numbered)
    single = build_correction_map(scene, build_ray_map(scene), layers=2, skip=False)
    assert blocks.recovered.sum() > 4000
    if kind != "one window":  # there alone it is known why a node is not seen past the glass
        assert (blocks.status != single.status).sum() <= 2
    np.testing.assert_array_equal(blocks.recovered, single.recovered)
    both = (blocks.weight > 0.0) & (single.weight > 0.0)
    assert both.sum() > 0.999 * (single.weight > 0.0).sum()
    np.testing.assert_allclose(blocks.pixel[both], single.pixel[both], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(blocks.transmittance[both], single.transmittance[both], rtol=1e-5)
    np.testing.assert_allclose(blocks.jacobian[both], single.jacobian[both], rtol=1e-3, atol=1e-4)
    names = [[made.branches[number] for number in made.branch[both]] for made in (blocks, single)]
    assert names[0] == names[1]


def test_windows_that_a_ray_may_pass_beside_are_not_usual() -> None:
    leaning = Window("window", (70.0, 0.0, 60.0), (0.8, 0.0, 0.6), 8.0, 40.0, GLASS)
    wide = camera_at((150.0, 0.0, 300.0), (40.0, 0.0, 0.0), 250.0, (160, 90))
    ball = Sphere("b", (0.0, 0.0, 12.0), 10.0, GLASS)
    assert not choose(Scene(wide, (leaning, ball))).in_blocks
    assert choose(Scene(CAMERA, (window(150.0, "window"), *balls()))).in_blocks
    assert choose(Scene(CAMERA, balls())).in_blocks
