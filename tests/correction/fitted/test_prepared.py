"""A correction is made once for what it is made of, and goes when others are used."""

import os
from dataclasses import replace

import numpy as np
import pytest

from correction.fitted import prepared
from correction.fitted.prepared import PreparedCorrections, content_key, prepare
from correction.maps.correction_map import STORED_BYTES, CorrectionMap, build_correction_map, code_here
from correction.maps.corrector import Corrector
from correction.maps.dewarp import fit_dewarp_pairs
from tests.correction.small_scenes import small_scene
from tracer.strategies.ray_map import build_ray_map

SIZE_PX = 96


@pytest.fixture
def scene():
    return small_scene("two_spheres_500", SIZE_PX)


@pytest.fixture
def dewarp():
    ideal = np.stack(np.meshgrid(*[np.arange(0.0, SIZE_PX, 6.0)] * 2), axis=-1).reshape(-1, 2)
    return fit_dewarp_pairs(ideal, ideal + 0.5, (SIZE_PX, SIZE_PX), spacing_px=6.0)


def test_it_corrects_as_its_parts_do(scene, dewarp):
    frame = np.random.default_rng(1).integers(0, 4095, scene.camera.shape).astype(np.uint16)
    built = build_correction_map(scene, build_ray_map(scene), layers=2).as_stored()
    made = prepare(scene, dewarp, "bilinear", 2)
    assert np.array_equal(made.corrector(frame), Corrector(built, dewarp, "bilinear")(frame), equal_nan=True)
    assert np.array_equal(made.ray_map.plane_mm, build_ray_map(scene).plane_mm, equal_nan=True)


def test_whatever_changes_a_pixel_changes_the_key(scene, dewarp):
    other = replace(dewarp, centre_px=(1.0, 2.0))
    keys = [content_key(scene), content_key(scene.with_bodies(())), content_key(scene, dewarp),
            content_key(scene, other), content_key(scene, method="bilinear"),
            content_key(scene, layers=2)]  # fmt: skip
    assert len(set(keys)) == len(keys)
    assert content_key(small_scene("two_spheres_500", SIZE_PX), dewarp) == keys[2]


def test_the_latest_stay_and_the_one_not_used_for_longest_goes(scene, mocker):
    traced = mocker.spy(prepared, "build_ray_map")
    corrections, clear = PreparedCorrections(kept=2), scene.with_bodies(())
    glass = corrections.of(scene)
    corrections.of(clear)
    assert corrections.of(scene) is glass
    corrections.of(scene, method="bilinear")  # the clear one goes
    assert corrections.of(scene) is glass
    assert traced.call_count == 3
    corrections.of(clear)
    assert traced.call_count == 4


def test_maps_on_the_disk_are_used_again_unless_they_are_damaged(scene, tmp_path, mocker):
    first = PreparedCorrections(tmp_path).of(scene)
    PreparedCorrections(tmp_path).of(scene, layers=2)
    traced = mocker.spy(prepared, "build_ray_map")
    again = PreparedCorrections(tmp_path).of(scene)
    assert not traced.called
    assert np.array_equal(first.corrector.map.pixel, again.corrector.map.pixel, equal_nan=True)
    assert PreparedCorrections(tmp_path).of(scene, layers=2).corrector.map.layers == 2
    (tmp_path / f"{scene.content_hash()}.map").write_bytes(b"nonsense")
    PreparedCorrections(tmp_path).of(scene)
    assert traced.call_count == 1
    assert CorrectionMap.load(tmp_path / f"{scene.content_hash()}.map").layers == 1


def test_a_map_of_another_program_is_made_again(scene, tmp_path, mocker):
    """As after an update: a scene has its name, and its map has who made it."""
    mocker.patch("correction.maps.correction_map.code_digest", return_value="as it was before")
    PreparedCorrections(tmp_path).of(scene)
    path = tmp_path / f"{scene.content_hash()}.map"
    assert CorrectionMap.load(path).made_by == "as it was before"
    mocker.stopall()
    traced = mocker.spy(prepared, "build_ray_map")
    PreparedCorrections(tmp_path).of(scene)
    PreparedCorrections(tmp_path).of(scene)
    assert traced.call_count == 1
    assert CorrectionMap.load(path).made_by == code_here()


@pytest.mark.parametrize("layers", [1, 3])
def test_a_stored_map_is_small_and_has_the_bits_of_the_one_in_use_within_its_bound(tmp_path, layers):
    scene = small_scene("two_spheres_500", 252)
    built = build_correction_map(scene, build_ray_map(scene), layers=layers)
    first = PreparedCorrections(tmp_path).of(scene, layers=layers).corrector.map
    again = PreparedCorrections(tmp_path).of(scene, layers=layers).corrector.map
    assert again is not first
    seen = built.weight > 0.0
    for name, most in {"pixel": 8e-6, "jacobian": 1e-6, "weight": 1e-7, "transmittance": 1e-6}.items():
        exact, used, stored = (getattr(one, name) for one in (built, first, again))
        assert np.array_equal(used, stored, equal_nan=True)
        assert used.dtype == exact.dtype
        assert 0.0 < np.abs(used[seen] - exact[seen]).max(initial=1e-12) < most
    for name in ("status", "branch"):
        assert np.array_equal(getattr(built, name), getattr(again, name))
    whole = sum(array.nbytes for array in built.arrays().values())
    (path,) = tmp_path.glob("*.map")
    assert path.stat().st_size < 0.3 * whole
    assert path.stat().st_size < 2.0 * STORED_BYTES * layers * built.status.size


def test_a_map_of_a_sensor_beyond_32_000_pixels_keeps_its_pixels(tmp_path):
    """A step of 2^-16 px in 32 bits ends at 32 768, and what lay beyond was put there."""
    small = small_scene("one_sphere_250", 96)
    built = build_correction_map(small, build_ray_map(small))
    wide = replace(built, pixel=built.pixel * 700.0, sensor_px=(67200, 67200))
    wide.save(tmp_path / "wide.map")
    for kept in (CorrectionMap.load(tmp_path / "wide.map"), wide.as_stored()):
        np.testing.assert_allclose(kept.pixel, wide.pixel, atol=3.1e-5)
        assert np.nanmax(kept.pixel) > 50000.0


def test_maps_not_used_for_longest_are_removed(tmp_path, scene, monkeypatch):
    monkeypatch.setattr(prepared, "STORED", 3)
    scenes = [scene.with_camera(replace(scene.camera, focal_px=scene.camera.focal_px + k)) for k in range(4)]
    for number, one in enumerate(scenes):
        prepare(one, maps=tmp_path)
        os.utime(tmp_path / f"{one.content_hash()}.map", (number, number))
    left = {path.stem for path in tmp_path.glob("*.map")}
    assert left == {one.content_hash() for one in scenes[1:]}
    prepare(scenes[1], maps=tmp_path)  # used again: not the next to go
    prepare(scenes[0], maps=tmp_path)
    assert {path.stem for path in tmp_path.glob("*.map")} == {scenes[k].content_hash() for k in (0, 1, 3)}
