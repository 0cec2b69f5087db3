"""Bundles of rays through many spheres against single rays: branch, status and plane point of every pixel."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.scenes import bed
from tests.tracer.scenes import HOLLOW, ball, camera_at, scene, shrunk
from tests.tracer.test_lockstep import check
from tracer.bodies import Sphere
from tracer.errors import RayMapUsageError
from tracer.media import ConstantMedium
from tracer.scene.scene import Scene
from tracer.strategies.branches import lengths_of
from tracer.strategies.lockstep import cache_aligned
from tracer.strategies.ray_map import RayMap, build_ray_map
from tracer.strategies.strategy import Kind, choose
from tracer.strategies.trace import RayStatus

packed = cache(bed)  # a thousand balls take a while to be checked


def small(where: Scene, times: float = 24.0) -> Scene:
    return where.with_camera(shrunk(where.camera, times))


def mixed_bed(seed: int, count: int = 60) -> Scene:
    """Balls of all sizes, many touching, matched or of heavy glass, bubbles, opaque, in water; a slanted view."""
    rng = np.random.default_rng(seed)
    bodies: list[Sphere] = []
    while len(bodies) < count:
        centre = rng.uniform((-40.0, -40.0, 12.0), (40.0, 40.0, 90.0))
        gaps = [float(np.linalg.norm(centre - b.centre_mm) - b.radius_mm) for b in bodies]
        radius = min([11.0, float(centre[2]) - 0.5, *gaps])
        if radius > 1.0:
            radius = radius if rng.random() < 0.7 else 0.8 * radius  # most touch the nearest one
            kind = rng.choice(4, p=(0.5, 0.3, 0.1, 0.1))
            made = ball(f"b{len(bodies)}", *centre.tolist(), radius * (1.0 - 1e-13), (1.37, 1.9, 1.0, 1.5)[kind])
            bodies.append(replace(made, medium=None) if kind == 3 else made)
    camera = camera_at((*rng.uniform(-120.0, 120.0, 2).tolist(), 380.0), (3.0, -2.0, 30.0), 330.0, (150, 118))
    return Scene(camera, tuple(bodies), ambient=ConstantMedium(1.333))


def bits(made: RayMap) -> tuple[bytes, ...]:
    return (
        made.plane_mm.tobytes(),
        made.status.tobytes(),
        made.branch.tobytes(),
        repr(tuple(made.branches)).encode(),
    )


@pytest.mark.parametrize("packing", ["bcc", "random"])
@pytest.mark.parametrize("count", [16, 128])
def test_packed_beds(count: int, packing: str) -> None:
    where = small(packed(count, packing=packing))
    assert choose(where).kind is Kind.BUNDLES
    check(where)


@pytest.mark.parametrize("seed", range(4))
def test_balls_of_all_kinds_and_sizes(seed: int) -> None:
    made = check(mixed_bed(seed))
    assert {RayStatus.RECOVERED, RayStatus.BLOCKED, RayStatus.TIR, RayStatus.MISSED_PLANE} <= set(
        np.unique(made.status).tolist()
    )


def test_one_ball_a_hundred_times_as_large_as_the_others() -> None:
    """The horizon of neighbours is that of the small ones: what stands beyond it must still be found."""
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(12), (0, 1)), axis=-1).reshape(-1, 3)
    small_ones = [
        ball(f"s{i}", *(3.0 * at - (16.5, 16.5, -220.0)).tolist(), 1.0, 1.4) for i, at in enumerate(grid)
    ]
    bodies = (*small_ones, ball("large", 0.0, 0.0, 101.0, 100.0, 1.5))
    made = check(Scene(camera_at((8.0, 5.0, 500.0), (0.0, 0.0, 200.0), 1200.0, (140, 140)), bodies))
    assert any(branch[-1:] == ("large",) and len(branch) > 2 for branch in made.branches)


def test_rays_along_contacts_and_rims() -> None:
    """A camera on the line of many contacts, and rays that graze: nobody is met twice, nobody passed over."""
    column = [ball(f"c{k}", 0.0, 0.0, 5.0 + 10.0 * k, 5.0, 1.5) for k in range(12)]
    beside = [ball(f"d{k}", 10.0, 0.0, 5.0 + 10.0 * k, 5.0, 1.02) for k in range(12)]
    check(Scene(camera_at((0.0, 0.0, 300.0), (0.0, 0.0, 0.0), 2400.0, (127, 127)), (*column, *beside)))
    check(Scene(camera_at((5.0, 0.0, 300.0), (5.0, 0.0, 0.0), 2400.0, (127, 127)), (*column, *beside)))


def test_a_level_view_of_a_bed() -> None:
    """Directions of a tile are far apart and go up as well as down."""
    where = packed(128)
    camera = camera_at((-90.0, 3.0, 40.0), (0.0, 0.0, 60.0), 20.0, (60, 50))
    made = check(where.with_camera(camera))
    assert np.mean(made.status == RayStatus.MISSED_PLANE) > 0.1


@pytest.mark.slow
def test_same_bits_for_any_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    where, made = small(packed(1000, packing="bcc"), 12.0), set()
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("RTPIV_THREADS", threads)
        made.add(bits(build_ray_map(where)))
    assert len(made) == 1


def test_same_bits_for_any_order_of_bodies() -> None:
    """Numbers, names and points: the map of a bed does not know how its file was written."""
    for where in (small(packed(128)), mixed_bed(7)):
        order = np.random.default_rng(3).permutation(len(where.spheres))
        other = where.with_bodies([where.spheres[k] for k in order])
        assert bits(build_ray_map(where)) == bits(build_ray_map(other))


@pytest.mark.slow
@pytest.mark.parametrize("shift", [1, 11])
def test_same_bits_for_any_tile(shift: int) -> None:
    """The same pixels on a sensor that begins elsewhere stand in other tiles, beside other rays."""
    for where in (small(packed(432, packing="bcc"), 12.0), mixed_bed(5)):
        camera = where.camera
        (u, v), (width, height) = camera.principal_px, camera.sensor_px
        cut = replace(
            camera, principal_px=(u - shift, v - 2 * shift), sensor_px=(width - shift - 3, height - 2 * shift)
        )
        whole, part = build_ray_map(where), build_ray_map(where.with_camera(cut))
        there = np.s_[2 * shift :, shift : width - 3]
        assert whole.plane_mm[there].tobytes() == part.plane_mm.tobytes()
        assert whole.status[there].tobytes() == part.status.tobytes()
        names = [np.array([" ".join(way) for way in made.branches])[made.branch] for made in (whole, part)]
        assert np.array_equal(names[0][there], names[1])


def one_uneven() -> Scene:
    where = small(packed(16))
    first, *rest = where.spheres
    return where.with_bodies([replace(first, shape_um=(30.0,) + 44 * (0.0,)), *rest])


def test_a_bed_with_a_ball_out_of_round_goes_no_fast_way() -> None:
    assert choose(one_uneven()).kind is Kind.RAYS


@pytest.mark.slow
def test_a_ball_out_of_round_is_not_taken_for_a_sphere() -> None:
    check(one_uneven())


@pytest.mark.parametrize("most", [0, 2])
def test_no_more_bodies_than_asked_for(most: int) -> None:
    """Ways that are no longer keep their bits, all others are dropped: in a bed, in lockstep and ray by ray."""
    hollow = scene(HOLLOW)
    for where in (small(packed(128)), mixed_bed(1), small(scene("three_spheres_500")), small(hollow)):
        whole, cut = build_ray_map(where), build_ray_map(where, most_bodies=most)
        longer = (lengths_of(whole.branches) > most)[whole.branch]
        assert longer.any()
        assert (cut.status[longer] == RayStatus.TOO_MANY_EVENTS).all()
        assert np.isnan(cut.plane_mm[longer]).all()
        assert np.array_equal(cut.status[~longer], whole.status[~longer])
        assert cut.plane_mm[~longer].tobytes() == whole.plane_mm[~longer].tobytes()
        with pytest.raises(RayMapUsageError, match="is not stored"):
            cut.save("limited.map")
    with pytest.raises(RayMapUsageError, match="most_bodies"):
        build_ray_map(hollow, most_bodies=-1)


def test_a_map_without_any_ball_in_view() -> None:
    where = packed(16)
    away = camera_at((500.0, 0.0, 300.0), (500.0, 0.0, 0.0), 300.0, (40, 33))
    made = check(where.with_camera(away))
    assert tuple(made.branches) == ((),)


def test_a_tile_whose_rays_are_all_totally_reflected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is left to ask a list, and memory that nobody has written to must not say which."""

    def poisoned(count: int, dtype: type) -> np.ndarray:
        memory = cache_aligned(count, dtype)
        memory[...] = np.nan if np.issubdtype(dtype, np.floating) else 7_777_777_777_777
        return memory

    monkeypatch.setattr("tracer.strategies.beds.cache_aligned", poisoned)
    bubble = Sphere("bubble", (0.0, 0.0, 60.0), 20.0, ConstantMedium(1.0))
    camera = camera_at((18.0, 0.0, 460.0), (18.0, 0.0, 0.0), 4000.0, (16, 16))
    made = build_ray_map(Scene(camera, (bubble,), ambient=ConstantMedium(1.5)))
    assert (made.status == RayStatus.TIR).all()
