"""Glass maps have the bits of the whole."""

from dataclasses import replace

import numpy as np
import pytest

from tests.tracer.test_lockstep_skips import SCENES, mirrored_scene, random_lockstep_scene, some_scene
from tracer.errors import SceneError, StaleMap
from tracer.glass_map import build_glass_map
from tracer.ray_map import RayMap, build_ray_map
from tracer.scene import Scene

EVERYTHING = [*map(some_scene, SCENES), *map(random_lockstep_scene, range(8)), *map(mirrored_scene, range(4))]


def same(one: RayMap, other: RayMap) -> bool:
    arrays = ("plane_mm", "status", "branch")
    equal = all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in arrays)
    return equal and (one.branches, one.scene_hash) == (other.branches, other.scene_hash)


@pytest.mark.parametrize("where", EVERYTHING)
def test_glass_maps_hold_the_bits_of_the_whole(where: Scene) -> None:
    made = build_glass_map(where)
    whole = build_ray_map(where)
    assert same(made.full(where), whole)
    u, v = made.pixels.T
    outside = np.ones(where.camera.shape, bool)
    outside[v, u] = False
    assert not whole.branch[outside].any()
    clear = np.bincount(made.pixels[made.branch == 0, 1], minlength=1)
    spheres = max(1, len(where.spheres))
    assert clear.max() <= 8 * spheres + 0.02 * where.camera.shape[1]  # margins; a row that just misses
    with pytest.raises(StaleMap):
        made.full(where.with_bodies(()))


def test_glass_maps_are_for_a_few_clear_spheres() -> None:
    where = some_scene("two_spheres_500")
    with pytest.raises(SceneError, match="eight"):
        build_glass_map(where.with_bodies([replace(b, medium=None) for b in where.spheres]))
    empty = where.with_bodies(())
    assert len(build_glass_map(empty).runs) == 0
    assert same(build_glass_map(empty).full(empty), build_ray_map(empty))
