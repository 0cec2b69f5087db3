"""Maps of a part: glass only, and after a body has moved; both have the bits of a whole trace."""

from dataclasses import replace

import numpy as np
import pytest

from tests.tracer.scenes import ball, scene
from tests.tracer.test_lockstep import shrunk
from tests.tracer.test_lockstep_skips import SCENES, mirrored_scene, random_lockstep_scene, some_scene
from tracer import retrace as retrace_module
from tracer.errors import SceneError, StaleMap
from tracer.glass_map import build_glass_map
from tracer.ray_map import RayMap, build_ray_map
from tracer.retrace import retrace
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


def changed(where: Scene, rng: np.random.Generator) -> Scene:
    """One sphere a little aside, down, smaller or of other glass; its order from the camera down mostly kept."""
    bodies = list(where.spheres)
    which = int(rng.integers(len(bodies)))
    body = bodies[which]
    x, y, z = body.centre_mm
    radius = body.radius_mm * float(rng.uniform(0.6, 1.0))
    centre = (x + float(rng.normal()), y + float(rng.normal()), z)
    kind = rng.integers(3)
    if kind == 0:
        bodies[which] = replace(body, radius_mm=radius)
    elif kind == 1:
        bodies[which] = replace(body, radius_mm=0.9 * body.radius_mm, centre_mm=centre)
    else:
        assert body.medium is not None
        bodies[which] = replace(body, medium=ball("", 0.0, 0.0, 1.0, 1.0, float(rng.uniform(1.0, 2.0))).medium)
    try:
        return where.with_bodies(bodies)
    except SceneError:  # it overlaps another
        return where


@pytest.mark.parametrize("where", EVERYTHING)
def test_after_one_body_has_changed(where: Scene) -> None:
    rng = np.random.default_rng(3)
    earlier = build_ray_map(where)
    for _ in range(4):
        then = changed(where, rng)
        earlier = retrace(earlier, where, then)
        assert same(earlier, build_ray_map(then))
        where = then


def test_only_what_is_touched_is_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two spheres far apart: pixels of the other one are not written; a pattern that moves writes none."""
    where = scene("two_spheres_500")
    apart = [ball("left", -40.0, 0.0, 25.0, 20.0), ball("right", 40.0, 3.0, 24.0, 20.0)]
    where = where.with_bodies(apart).with_camera(shrunk(where.camera, 6.0))
    moved = where.with_bodies([apart[0], ball("right", 41.0, 4.0, 24.0, 20.0)])
    earlier = build_ray_map(where)
    left = np.nonzero(earlier.branch == 1)
    earlier.plane_mm[left] = 77.0
    assert np.all(retrace(earlier, where, moved).plane_mm[left] == 77.0)
    monkeypatch.setattr(retrace_module, "run_rows", None)
    same_again = retrace(replace(earlier, scene_hash=moved.content_hash()), moved, moved)
    assert np.all(same_again.plane_mm[left] == 77.0)


def test_what_cannot_be_compared_is_traced_as_a_whole() -> None:
    where = some_scene("two_spheres_500")
    other = where.with_bodies((*where.bodies, ball("third", 60.0, 0.0, 20.0, 10.0)))
    turned = where.with_camera(replace(where.camera, focal_px=where.camera.focal_px * 1.01))
    swapped = where.with_bodies(
        [replace(b, centre_mm=(b.centre_mm[0], b.centre_mm[1], 100.0 - b.centre_mm[2])) for b in where.spheres]
    )
    for then in (other, turned, swapped):
        assert same(retrace(build_ray_map(where), where, then), build_ray_map(then))
    with pytest.raises(StaleMap):
        retrace(build_ray_map(where), other, where)
