"""The glass of a flow run stands off its place in the scene: what is evaluated is the scene as it was."""

from dataclasses import replace

import numpy as np
import pytest

from correction.masked import pixels_in
from daq.errors import RunDamaged
from daq.runs.glass_place import glass_place_mm, with_glass_at
from daq.runs.journal import Journal
from daq.runs.run_folder import RunFolder
from piv.errors import PairError
from tests.correction.small_scenes import small_scene
from tests.daq.small_run import BENCH, about_run, keep_frame, planned
from tracer.masked import UNCONFIRMED, UNLISTED, MaskedPart

AXIS = """    glass_z: {controller: box, channel: 2/1, carries: glass, along: z, limits_mm: [-1.0, 50.0],
              speed_mm_s: 1.0, acceleration_mm_s2: 1.0}
  home_order: [target_x, glass_z]
glass: {out_mm: {glass_z: 50.0}}
scene_at_mm: {glass_z: 2.0}
"""


def run_with(path, places_mm):
    bench = BENCH.replace("  home_order: [target_x]\n", AXIS)
    folder = RunFolder.create(path, "flow", about_run([planned(0, frames=len(places_mm))]) | {"bench": bench})
    journal = Journal(folder.journal_path)
    for number, place_mm in enumerate(places_mm):
        facts = {} if place_mm is None else {"planned_mm": {"target_x": 1.0, "glass_z": place_mm}}
        keep_frame(folder, journal, number, np.zeros((4, 4), np.uint16), **facts)
    journal.close()
    return folder.path, sorted((folder.path / "frames").iterdir())


def test_the_place_is_against_the_scene_not_the_axis(tmp_path):
    run, frames = run_with(tmp_path, [6.0, 6.0])
    assert glass_place_mm(run, frames) == pytest.approx((0.0, 0.0, 4.0))
    assert glass_place_mm(run, []) == (0.0, 0.0, 0.0)


def test_glass_that_was_moved_in_between_is_refused(tmp_path):
    run, frames = run_with(tmp_path, [6.0, 6.0, 7.0])
    assert glass_place_mm(run, frames[:2])
    with pytest.raises(PairError, match=r"the glass was moved between 000000.tif and 000002.tif"):
        glass_place_mm(run, frames)


def test_a_run_that_does_not_say_is_damaged(tmp_path):
    run, frames = run_with(tmp_path, [None])
    with pytest.raises(RunDamaged, match="lacks the position of 'glass_z'"):
        glass_place_mm(run, frames)


def test_bodies_move_and_nothing_else(tmp_path):
    scene = small_scene("two_spheres_500")
    moved = with_glass_at(scene, (0.0, 0.0, 4.0))
    assert [s.centre_mm[2] for s in moved.spheres] == pytest.approx([s.centre_mm[2] + 4.0 for s in scene.spheres])
    assert moved.camera == scene.camera
    assert with_glass_at(scene, (0.0, 0.0, 0.0)) is scene


def test_what_is_masked_is_masked_where_it_was_and_where_the_glass_took_it():
    scene = small_scene("two_spheres_500")
    drop = np.array([-8.0, 9.0, 101.0])  # on the upper ball
    u, v = scene.camera.project(drop)
    around = ((u - 5, v - 5), (u + 5, v - 5), (u + 5, v + 5), (u - 5, v + 5))
    way = MaskedPart(UNCONFIRMED, through=("sphere2", "sphere1"))
    masked = replace(scene, masked=(MaskedPart(UNLISTED, around), way))
    moved = with_glass_at(masked, (12.0, -4.0, 6.0))
    inside = pixels_in(moved.masked[0], scene.camera.shape)
    for place in (drop, drop + np.array([12.0, -4.0, 6.0])):
        column, row = np.rint(scene.camera.project(place)).astype(int)
        assert inside[row - 3 : row + 4, column - 3 : column + 4].all()
    assert 100 < np.count_nonzero(inside) < 1500
    assert moved.masked[1] == way
