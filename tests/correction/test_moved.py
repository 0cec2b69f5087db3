"""After a sphere has moved: the bits of a map made anew, and most of it not touched."""

from dataclasses import replace

import numpy as np
import pytest

from correction import moved
from correction.correction_map import build_correction_map
from correction.moved import invert_again
from tests.correction.small_scenes import SCENES, small_scene
from tracer.errors import StaleMap
from tracer.media import ConstantMedium
from tracer.ray_map import build_ray_map

ARRAYS = ("status", "pixel", "jacobian", "weight", "transmittance", "branch")


def with_sphere(scene, which, **changes):
    bodies = list(scene.bodies)
    bodies[which] = replace(bodies[which], **changes)
    return scene.with_bodies(bodies)


def aside(scene, which, dx, dy, shrink=0.9):
    """A sphere moved sideways, and smaller so that it touches nobody."""
    x, y, z = scene.bodies[which].centre_mm
    return with_sphere(
        scene, which, centre_mm=(x + dx, y + dy, z), radius_mm=shrink * scene.bodies[which].radius_mm
    )


def again(before, scene, layers=1):
    rays = build_ray_map(before)
    return invert_again(
        build_correction_map(before, rays, layers=layers), before, rays, scene, build_ray_map(scene)
    )


def assert_same(one, other):
    for name in ARRAYS:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert (one.grid, one.branches, one.scene_hash) == (other.grid, other.branches, other.scene_hash)


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("name", SCENES)
def test_a_moved_sphere_gives_the_bits_of_a_map_made_anew(name, layers):
    before = small_scene(name)
    rng = np.random.default_rng(4)
    for which in range(len(before.bodies)):
        scene = aside(before, which, *rng.uniform(-1.4, 1.4, 2))
        expected = build_correction_map(scene, build_ray_map(scene), layers=layers)
        assert_same(again(before, scene, layers), expected)


def test_another_glass_is_a_change_and_another_body_is_made_anew():
    before = small_scene("pyramid_500")
    glass = with_sphere(before, 0, medium=ConstantMedium(1.6))
    fewer = before.with_bodies(before.bodies[1:])
    for scene in (glass, fewer, before):
        assert_same(again(before, scene), build_correction_map(scene, build_ray_map(scene)))


def test_only_what_the_sphere_can_have_touched_is_asked_again(monkeypatch):
    before = small_scene("pyramid_500")
    scene = aside(before, 4, 0.5, 0.0)
    asked = []
    touched = moved._touched
    monkeypatch.setattr(moved, "_touched", lambda *args: asked.append(touched(*args)) or asked[-1])
    again(before, before)
    again(before, scene)
    assert not asked[0].any()
    assert 0.02 < asked[1].mean() < 0.5


def test_maps_of_other_scenes_are_refused():
    before = small_scene("two_spheres_500")
    scene = aside(before, 0, 1.0, 0.0)
    rays, rays_2 = build_ray_map(before), build_ray_map(scene)
    cmap = build_correction_map(before, rays)
    for arguments in ((before, rays_2, scene, rays_2), (scene, rays, scene, rays_2), (before, rays, scene, rays)):
        with pytest.raises(StaleMap):
            invert_again(cmap, *arguments)
