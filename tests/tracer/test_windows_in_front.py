"""A sensor traced through windows block by block, against the march that knows rooms."""

from dataclasses import replace

import numpy as np
import pytest

from correction.correction_map import build_correction_map
from tests.tracer.drawn_walls import GLASS, WATER, among_all_kinds, seen
from tests.tracer.scenes import camera_at
from tracer.bodies import Body, Sphere, Tube, Window
from tracer.camera import Lens
from tracer.media import ConstantMedium
from tracer.ray_map import build_ray_map
from tracer.scene import Scene
from tracer.status import RayStatus
from tracer.windows_in_front import windows_in_front

NEAR_MM = 150.0
CAMERA = camera_at((12.0, -7.0, 400.0), (0.0, 0.0, 0.0), 900.0, (150, 131))


def window(z_mm: float, name: str, radius_mm: float = 90.0, behind: ConstantMedium | None = None) -> Window:
    normal = np.array([0.05, -0.08, 1.0])
    normal /= np.linalg.norm(normal)
    return Window(name, (0.0, 0.0, z_mm), tuple(normal.tolist()), 8.0, radius_mm, GLASS, behind)


def balls(n: float = 1.6) -> tuple[Body, ...]:
    places = ((0.0, 0.0, 20.0), (25.0, 5.0, 60.0), (-16.0, 12.0, 72.0), (2.0, -40.0, 26.0))
    return tuple(Sphere(f"b{k}", at, 18.0, ConstantMedium(n)) for k, at in enumerate(places))


def check(scene: Scene) -> dict[int, int]:
    """Compare with the march, which has been compiled for walls of all kinds; how many pixels have each status.

    Those walls stand far off: what flies that far is left out.
    """
    assert windows_in_front(scene) is not None
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


@pytest.mark.slow  # compiles the march for windows alone, which names what is not the usual case
def test_a_window_that_leans_far() -> None:
    """Some rays pass beside the window's plane, some come back to it, some see its edge."""
    leaning = replace(window(60.0, "window", 40.0), normal=(0.8, 0.0, 0.6), centre_mm=(70.0, 0.0, 60.0))
    ball = Sphere("b", (0.0, 0.0, 12.0), 10.0, GLASS)
    wide = camera_at((150.0, 0.0, 300.0), (40.0, 0.0, 0.0), 250.0, (160, 90))
    statuses = check(Scene(wide, (leaning, ball)))
    assert statuses[0] > 1000


@pytest.mark.parametrize("threads", ["1", "3"])
def test_same_bits_for_any_threads(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(CAMERA, (window(150.0, "window"), *balls()))
    once = build_ray_map(scene)
    monkeypatch.setenv("RTPIV_THREADS", threads)
    again = build_ray_map(scene.with_bodies(scene.bodies[::-1]))
    assert once.plane_mm.tobytes() == again.plane_mm.tobytes()
    assert once.branch.tobytes() == again.branch.tobytes()


def test_what_else_stands_there_goes_by_the_march() -> None:
    one = window(150.0, "window")
    beside = Tube("tube", (-40.0, -60.0, 90.0), (40.0, -60.0, 90.0), 9.0, 0.0, GLASS)
    bubble = Sphere("bubble", (0.0, 0.0, 20.0), 9.0, ConstantMedium(1.0))
    before = Sphere("before", (0.0, 0.0, 250.0), 9.0, GLASS)
    tank = replace(one, behind=WATER)
    for bodies in ((one,), (one, *balls(), beside), (tank, bubble), (one, *balls(), before), balls()):
        assert windows_in_front(Scene(CAMERA, bodies)) is None
    assert windows_in_front(Scene(CAMERA, (one, *balls()))) is not None


@pytest.mark.slow  # compiles an inversion for windows alone
def test_its_map_is_inverted_as_that_of_the_march(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(CAMERA, (window(150.0, "window"), *balls()))
    blocks = build_correction_map(scene, build_ray_map(scene))
    monkeypatch.setattr("tracer.ray_map.windows_in_front", lambda _: None)
    marched = build_correction_map(scene, build_ray_map(scene))
    np.testing.assert_array_equal(blocks.recovered, marched.recovered)
    np.testing.assert_allclose(blocks.pixel, marched.pixel, rtol=0.0, atol=1e-9)
