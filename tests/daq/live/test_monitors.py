"""Glass beside its place is said on the page, glass at its place is not."""

import json
from dataclasses import asdict

import pytest

from correction.target import Chessboard
from correction.target.codes import with_codes
from daq.live.frame_quality import FrameQuality
from daq.live.monitors import RimMonitor, SphereMonitor, begin, board_told, scene_told
from daq.pipeline.live_slot import SlotReader, SlotWriter
from tests.correction.alignment.drawn import BOARD, drawn, moved, scene_of
from tests.correction.self_check.test_moved_sphere import drawn_flow
from tests.correction.self_check.test_moved_sphere import moved as sphere_moved
from tests.daq.live.test_figures import board
from tracer.board import Codes
from tracer.scene.scene_file import dump_scene

SHOWS = {"rims": True, "shows": "chessboard"}


@pytest.mark.slow
def test_glass_that_stands_beside_its_outline_is_red():
    scene = scene_of()
    slot = SlotWriter(4 * scene.camera.shape[0] ** 2)
    watch = RimMonitor(SlotReader(slot.path), scene, BOARD)
    try:
        watch.look()
        assert watch.said == {}
        slot.put(SHOWS, {"raw": drawn(scene)})
        watch.look()
        assert not watch.said["glass beside its place"][1]
        slot.put(SHOWS, {"raw": drawn(moved(scene, glass_mm=(0.4, -0.2, 0.0)), seed=1)})
        watch.look()
        text, is_wrong = watch.said["glass beside its place"]
        assert is_wrong
        across, up = (float(word) for word in text.split(" mm")[0].split(", "))
        assert abs(across - 0.4) < 0.05
        assert abs(up + 0.2) < 0.05
        slot.put(SHOWS | {"rims": False}, {"raw": drawn(scene, seed=2)})
        watch.look()
        assert watch.said["glass beside its place"][1]  # a frame that cannot tell leaves what was said
        slot.put(SHOWS, {"raw": drawn(scene.bare(), seed=3)})
        watch.look()
        assert watch.said["rims"][0]
    finally:
        slot.close()


def test_a_board_is_told_whole():
    coded = with_codes(Chessboard(4.0, discs=(), squares=(9, 8), scale=(1.01, 0.99)), Codes("DICT_4X4_50", 0.7))
    for one in (BOARD, coded):
        assert board_told(json.loads(json.dumps(asdict(one)))) == one


def test_scenes_that_say_nothing_are_not_watched(tmp_path):
    slot = SlotWriter(1000)
    try:
        reader = SlotReader(slot.path)
        assert scene_told("bodies: 3") is None
        bare = scene_told(dump_scene(scene_of().bare()))
        assert bare is not None
        assert begin(reader, bare, BOARD) == ()
    finally:
        slot.close()


def test_a_sphere_that_moved_is_named_by_particles_of_one_pulse():
    scene, frames = drawn_flow()
    slot = SlotWriter(4 * frames[0][0].size)
    reader = SlotReader(slot.path)
    right, wrong = SphereMonitor(reader, scene), SphereMonitor(reader, sphere_moved(scene, 1, (0.04, 0.0, 0.0)))
    try:
        for pair in frames:
            for pulse, frame in enumerate(pair):
                slot.put({"rims": True, "shows": "flow", "pulse": pulse}, {"raw": frame.astype("f4")})
                right.look()
                wrong.look()
        assert not right.said["spheres"][1]
        assert "in 15 pairs" in right.said["spheres"][0]  # the first frame is what all others are compared with
        assert wrong.said["spheres"][1]
        assert "sphere2 has moved" in wrong.said["spheres"][0]
    finally:
        slot.close()


@pytest.mark.slow
def test_which_way_the_focus_goes_is_followed_and_forgotten_with_the_step(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("daq.live.frame_quality.time.monotonic", lambda: clock[0])
    slot = SlotWriter(4 * 200**2)
    quality = FrameQuality(SlotReader(slot.path))
    try:
        for look, blur_px in enumerate([3.0] * 8 + [2.6, 2.2, 1.8, 1.4, 1.8, 2.2, 2.2, 2.2, 2.2]):
            clock[0] = 0.5 * look
            slot.put({"run": "r: bare", "shows": "chessboard", "bits": 12}, {"raw": board(blur_px, 200, look)})
            quality.look()
            said = quality.said.get("focus", [""])[0]
            if look == 7:
                assert "turn the ring a little" in said
            if look == 11:
                assert "becoming sharper: go on" in said
        assert "turn back the way you came" in said
        assert quality.figures["maps"].keys() == {"edge_px"}
        slot.put({"run": "r: glass", "shows": "chessboard"}, {"raw": board(2.0, 200)})
        quality.look()
        assert quality.said == {}
    finally:
        slot.close()
