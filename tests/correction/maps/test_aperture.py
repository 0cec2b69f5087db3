"""A map through a pupil: particles' centroids where they are small moves, left out where they are not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from correction.fitted.prepared import content_key, prepare
from correction.maps.aperture import MAX_MISFIT_PX, blur_map, chief_pixels
from correction.node_status import NodeStatus
from ground.errors import ConfigError
from tests.correction.small_scenes import small_scene
from tracer.pupil import Pupil
from tracer.scene.scene_file import dump_scene, load_scene
from tracer.strategies.blur import pupil_views

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


def test_between_traced_nodes_the_blur_is_interpolated():
    scene = at(11.0)
    pinhole = map_of(None)
    behind = np.count_nonzero(pinhole.behind_glass)
    every, some = blur_map(pinhole, scene), blur_map(pinhole, scene, nodes=behind // 9)
    off = np.abs(every.shift_px - some.shift_px)[every.usable & some.usable]
    assert 0.0 < np.quantile(off, 0.95) < 0.005
    np.testing.assert_array_equal(every.shift_px[~pinhole.behind_glass], 0.0)


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
