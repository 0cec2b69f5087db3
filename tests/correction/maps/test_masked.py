"""Masked parts of a scene's view reach every map, and what is made of maps."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.evaluate.particle_tracks import usable_branches
from correction.fitted.prepared import content_key, prepare
from correction.light_sheet.double_views import double_views
from correction.maps.aperture import MAX_MISFIT_PX, blur_map, chief_pixels
from correction.maps.correction_map import build_correction_map
from correction.masked import hull_px, mask_pixels, pixels_in
from correction.node_status import NodeStatus
from daq.live.scene_lines import folds_and_masks
from daq.runs.glass_place import with_glass_at
from ground.errors import ConfigError
from sim.demo.scenes import at_size, demo_scene
from tests.correction.small_scenes import small_scene
from tracer.errors import SceneError
from tracer.light_sheet import LightSheet
from tracer.masked import LEFT_OUT, UNCONFIRMED, UNLISTED, MaskedPart
from tracer.pupil import Pupil
from tracer.scene.scene import Scene
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.blur import pupil_views
from tracer.strategies.ray_map import build_ray_map

SIZE_PX = 252
THROUGH = ("sphere2", "sphere1")
CORNER = MaskedPart(UNLISTED, ((120.0, 120.0), (150.0, 120.0), (150.0, 150.0), (120.0, 150.0)))
WAY = MaskedPart(UNCONFIRMED, through=THROUGH)


def scene(*masked: MaskedPart) -> Scene:
    return replace(at_size(demo_scene("two_spheres_500"), SIZE_PX), masked=masked)


def test_nodes_seen_through_an_outline_are_left_out_with_its_reason():
    whole = build_correction_map(scene(), build_ray_map(scene()))
    found = prepare(scene(CORNER)).corrector
    u, v = np.moveaxis(whole.pixel[0], -1, 0)
    inside = whole.recovered & (np.rint(u) > 120) & (np.rint(u) < 150) & (np.rint(v) > 120) & (np.rint(v) < 150)
    assert np.count_nonzero(inside) > 300
    assert (found.status[inside] == NodeStatus.UNLISTED).all()
    well_outside = whole.recovered & ((u < 119) | (u > 151) | (v < 119) | (v > 151))
    np.testing.assert_array_equal(found.status[well_outside], whole.status[well_outside])
    image = np.full((SIZE_PX, SIZE_PX), 700, np.uint16)
    assert np.isnan(found(image)[inside]).all()


WALL = MaskedPart(LEFT_OUT, outline_mm=((-60.0, -31.0), (60.0, -29.0), (60.0, -20.0), (-60.0, -20.0)))


def test_what_is_left_out_by_hand_in_the_plane_shows_nothing_seen_directly_or_through_glass():
    whole, found = (prepare(scene(*parts)).corrector for parts in ((), (WALL,)))
    x, y = np.moveaxis(whole.map.grid.nodes_mm(), -1, 0)
    inside = (np.abs(x) < 60.0) & (y > x / 60.0 - 30.0) & (y < -20.0)
    assert (whole.map.behind_glass & inside).any()
    np.testing.assert_array_equal(found.status == NodeStatus.LEFT_OUT, inside)
    np.testing.assert_array_equal(found.status[~inside], whole.status[~inside])
    assert np.isnan(found(np.full((SIZE_PX, SIZE_PX), 700, np.uint16))[inside]).all()
    joined = build_correction_map(scene(WALL), build_ray_map(scene(WALL)), layers=3)
    assert not (joined.weight[:, inside] > 0.0).any()
    assert joined._sound()
    assert content_key(scene(WALL)) != content_key(scene())


def test_what_a_person_leaves_out_stays_where_glass_goes_and_where_it_is_taken_away():
    hand = MaskedPart(LEFT_OUT, CORNER.outline_px)
    assert scene(CORNER, hand, WALL).bare().masked == (hand, WALL)
    assert with_glass_at(scene(CORNER, hand, WALL), (0.0, 3.0, 0.0)).masked[1:] == (hand, WALL)
    here = scene(hand, WALL)
    lit = replace(here, sheet=LightSheet(z_mm=0.4)).in_light_sheet()
    assert lit.masked == (hand, WALL)


def test_a_way_that_is_not_confirmed_is_left_out_whole():
    whole = build_correction_map(scene(), build_ray_map(scene()))
    found = build_correction_map(scene(WAY), build_ray_map(scene(WAY)))
    through = whole.recovered & (whole.branch[0] == list(whole.branches).index(THROUGH))
    assert not found.recovered[through].any()
    assert (found.status[through] == NodeStatus.UNCONFIRMED).sum() > 1000
    assert found.recovered[~through].any()
    assert found._sound()


@pytest.mark.parametrize("name", ["three_spheres_500", "pyramid_500"])
def test_the_next_best_view_takes_over_where_the_best_is_masked(name):
    """Nothing is left out that an unmasked view shows, and nothing is shown by a masked one."""
    whole = replace(scene(), bodies=at_size(demo_scene(name), SIZE_PX).bodies)
    views = build_correction_map(whole, build_ray_map(whole), layers=6)
    used = views.weight > 0.0
    twice = used[0] & used[1]
    (v0, v1), (u0, u1) = (
        (int(p.min()), int(p.max())) for p in (views.pixel[0][twice].T[1], views.pixel[0][twice].T[0])
    )
    half = MaskedPart(UNLISTED, ((u0, v0), (u1, v0), (u0, v1)))
    inside = pixels_in(half, (SIZE_PX, SIZE_PX))
    masked = replace(whole, masked=(half,))
    found = build_correction_map(masked, build_ray_map(masked))
    at = np.rint(np.nan_to_num(views.pixel)).astype(int)
    free = used & ~inside[at[..., 1], at[..., 0]]
    np.testing.assert_array_equal(found.recovered, free.any(axis=0))
    best = np.argmax(free, axis=0)[None, ..., None]
    pixel = np.take_along_axis(views.pixel, best, axis=0)[0]
    np.testing.assert_allclose(found.pixel[0][found.recovered], pixel[found.recovered], atol=1e-6)
    assert np.count_nonzero(free.any(axis=0) & ~free[0] & used[0]) > 20
    assert (found.status[used.any(axis=0) & ~found.recovered] == NodeStatus.UNLISTED).all()


def test_maps_of_masked_scenes_are_not_taken_for_others():
    assert scene(CORNER).content_hash() == scene().content_hash()
    assert len({content_key(scene(*parts)) for parts in ((), (CORNER,), (WAY,), (CORNER, WAY))}) == 4


def test_vectors_of_raw_frames_do_not_come_from_there():
    rays = build_ray_map(scene())
    before = sum(mask for _, mask in usable_branches(rays, scene(), 10))
    after = sum(mask for _, mask in usable_branches(rays, scene(CORNER), 10))
    assert before[125:145, 125:145].all()
    assert not after[121:150, 121:150].any()
    assert np.count_nonzero(mask_pixels(scene(WAY), rays)) == np.count_nonzero(
        rays.branch == list(rays.branches).index(THROUGH)
    )


def test_the_sheet_is_not_found_by_what_is_masked():
    three = at_size(demo_scene("three_spheres_500"), SIZE_PX)
    left_out = []
    for masked in ((), (CORNER,)):
        found = double_views(replace(three, masked=masked), step=2)
        seen = np.concatenate((found.first_px, found.second_px))
        left_out.append(not ((seen > 121) & (seen < 149)).all(axis=-1).any())
    assert left_out == [False, True]


def test_the_live_page_draws_it():
    coarse = folds_and_masks(scene(WAY))["corrected"]["masks"]
    assert coarse != folds_and_masks(scene())["corrected"]["masks"]


def test_it_goes_with_the_scene_and_not_with_the_bare_view(tmp_path):
    made = scene(CORNER, WAY, WALL)
    (tmp_path / "scene.yaml").write_text(dump_scene(made))
    assert load_scene(tmp_path / "scene.yaml").masked == made.masked
    assert made.bare().masked == (WALL,)
    lit = replace(made, sheet=LightSheet(-0.2))
    assert lit.in_light_sheet().masked == made.masked


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("{why: unlisted body, outline_px: [[1, 2], [3, 4]]}", "three points"),
        ("{why: unlisted body}", "outline_px, outline_mm or through"),
        ("{why: left out, outline_mm: [[1, 2], [3, 4]]}", "three points"),
        ("{why: left out, outline_px: [[1, 2], [3, 4], [5, 0]], through: [sphere1]}", "one of them"),
        ("{why: dirty, through: [sphere1]}", "why"),
    ],
)
def test_a_masked_part_that_is_none_is_refused_with_its_line(tmp_path, section, said):
    file = tmp_path / "scene.yaml"
    file.write_text(dump_scene(scene()) + f"masked:\n- {section}\n")
    line = len(file.read_text().splitlines())
    with pytest.raises(ConfigError, match=said) as caught:
        load_scene(file)
    assert f":{line}" in str(caught.value)


def test_an_outline_beyond_the_frame_is_cut():
    part = MaskedPart(UNLISTED, hull_px(np.array([[-50.0, -50.0], [10.0, -50.0], [10.0, 10.0], [-50.0, 10.0]])))
    inside = pixels_in(part, (40, 30))
    assert inside[:10, :10].all()
    assert not inside[12:].any()
    assert pixels_in(part.coarser(2), (20, 15))[:5, :5].all()
    with pytest.raises(SceneError):
        MaskedPart(UNLISTED, ((0.0, 0.0), (1.0, float("nan")), (2.0, 2.0)))


# A map through a pupil: particles' centroids where they are small moves, left out where they are not.


FILE = """
camera: {{f_mm: 60.0, L_mm: 500.0, pixel_pitch_um: 44.0, sensor_px: [200, 200]{more}}}
bodies:
  - {{name: ball, kind: sphere, centre_mm: [0.0, 0.0, 26.0], radius_mm: 25.0, material: {{n: 1.5}}}}
"""


def at(f_number: float | None):
    scene = small_scene("two_spheres_500", 300)
    pupil = None if f_number is None else Pupil(0.5 * 60.0 / f_number, 500.0)
    return scene.with_camera(replace(scene.camera, pupil=pupil))


@cache
def map_of(f_number: float | None):
    return prepare(at(f_number)).corrector.map


def test_nodes_are_looked_up_at_centroids():
    scene = at(5.6)
    pinhole, wide = map_of(None), map_of(5.6)
    behind = wide.behind_glass
    step = (wide.pixel[0] - pinhole.pixel[0])[behind][::7]
    own = pupil_views(scene, scene.camera.pupil, pinhole.pixel[0][behind][::7]).of_particles()
    good = own.lost == 0.0
    assert good.mean() > 0.8
    assert np.abs(step).max() > 0.01
    small = good & (np.hypot(*own.shift_px.T) < MAX_MISFIT_PX)
    assert np.abs(step - own.shift_px)[small].max() < 1e-4
    assert np.hypot(*step.T).max() <= MAX_MISFIT_PX + 1e-6
    direct = wide.recovered & ~behind
    assert np.array_equal(wide.pixel[0][direct], pinhole.pixel[0][direct])


@pytest.mark.parametrize(("f_number", "moved_px", "left_px"), [(22.0, 0.01, 0.001), (8.0, 0.1, 0.05)])
def test_raw_centroids_go_back_to_their_chief_rays(f_number, moved_px, left_px):
    """Tracks and raw vectors are traced along chief rays: what the pupil moved is taken off, or left out."""
    scene = at(f_number)
    pinhole = map_of(None)
    chief = pinhole.pixel[0][pinhole.behind_glass][::13]
    blur = pupil_views(scene, scene.camera.pupil, chief).of_particles()
    seen = np.isfinite(blur.shift_px).all(axis=1) & (blur.lost == 0.0)
    behind = np.ones(np.count_nonzero(seen), bool)
    found, usable = chief_pixels(scene, (chief + blur.shift_px)[seen], behind)
    off = np.hypot(*(found - chief[seen]).T)
    before = np.hypot(*blur.shift_px[seen].T)
    assert usable.mean() > 0.95
    assert before[usable].max() > moved_px
    assert np.quantile(off[usable], 0.99) < 0.05 * np.quantile(before[usable], 0.99)
    assert off[usable].max() < left_px
    beside, kept = chief_pixels(scene, chief, np.zeros(len(chief), bool))
    assert kept.all()
    assert np.array_equal(beside, chief)


@pytest.mark.slow
def test_between_traced_nodes_the_blur_is_interpolated():
    scene = at(11.0)
    pinhole = map_of(None)
    behind = np.count_nonzero(pinhole.behind_glass)
    every, some = blur_map(pinhole, scene), blur_map(pinhole, scene, nodes=behind // 9)
    off = np.abs(every.shift_px - some.shift_px)[every.usable & some.usable]
    assert 0.0 < np.quantile(off, 0.95) < 0.005
    np.testing.assert_array_equal(every.shift_px[~pinhole.behind_glass], 0.0)


@pytest.mark.slow
def test_what_a_wide_pupil_blurs_is_left_out():
    scene = at(1.4)
    found = map_of(1.4)
    left_out = found.status == NodeStatus.BLURRED
    assert left_out.any()
    blur = blur_map(map_of(None), scene)
    assert np.array_equal(left_out | found.behind_glass, map_of(None).behind_glass)
    assert not blur.usable[left_out].any()
    assert np.isnan(found.pixel[0][left_out]).all()


def test_a_pupil_is_part_of_the_key():
    assert len({content_key(at(f_number)) for f_number in (None, 22.0, 11.0)}) == 3


def test_an_aperture_is_read_and_written(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(FILE.format(more=", f_number: 22.0"))
    scene = load_scene(path)
    assert scene.camera.pupil == Pupil(0.5 * 60.0 / 22.0, 500.0)
    path.write_text(dump_scene(scene))
    assert load_scene(path).camera.pupil == scene.camera.pupil
    path.write_text(FILE.format(more=", f_number: 8.0, focus_mm: 480.0"))
    assert load_scene(path).camera.pupil == Pupil(3.75, 480.0)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("focus_mm: 480.0", "focus_mm says nothing"),
        ("f_number: 22.0, pupil_mm: 3.0", "f_number goes with f_mm"),
        ("f_number: 0.0", "f_number"),
    ],
)
def test_an_aperture_that_says_nothing_is_refused(tmp_path, more, words):
    path = tmp_path / "scene.yaml"
    path.write_text(FILE.format(more=f", {more}"))
    with pytest.raises(ConfigError, match=words):
        load_scene(path)
