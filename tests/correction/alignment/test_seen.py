"""Where glass and camera stand, from one frame: right, with a sigma that holds, or refused."""

from dataclasses import replace

import numpy as np
import pytest

from correction.alignment.camera_seen import find_camera
from correction.alignment.rim import rim_of
from correction.alignment.seen import Expected, find_arrangement
from correction.errors import AlignmentError, RimNotFound, RimUnclear, TargetNotFound
from correction.target import Chessboard
from correction.target.codes import with_codes
from piv.errors import FrameError
from sim.demo.scenes import at_size, demo_scene, misalign
from sim.renderer.patterns import Chessboard as Print
from sim.renderer.render import render
from sim.renderer.sensor import Sensor
from tests.correction.alignment.drawn import BOARD, drawn, moved, ring, scene_of
from tracer.board import Codes

NOMINAL = scene_of()
GLASS, CAMERA = (1.1, -0.9, 0.8), (-0.2, 0.3, 0.4)
HERE = Expected(np.zeros(3), np.zeros(3), np.zeros(3))


@pytest.fixture(scope="module")
def frame():
    return drawn(moved(NOMINAL, glass_mm=GLASS, camera_mm=CAMERA))


def looked(frame, scene=NOMINAL, **changes):
    return find_arrangement(frame, scene, BOARD, HERE, **changes)


def test_glass_and_camera_are_where_they_were_drawn(frame):
    seen = looked(frame)
    assert np.all(np.abs(seen.camera_mm - CAMERA) < 4.0 * seen.camera_sigma_mm)
    assert np.all(seen.camera_sigma_mm < 0.3)
    for one in seen.spheres:
        assert one.own_rim
        assert np.all(np.abs(one.off_mm - GLASS) < 3.0 * one.sigma_mm)
        assert np.all(one.sigma_mm[:2] < 0.09)
        assert 0.3 < one.sigma_mm[2] < 2.0  # nobody can tell it from the size of an edge
    assert np.all(np.abs(seen.glass_mm[:2] - GLASS[:2]) < 0.05)
    assert seen.sigma_mm[2] > 0.9 * min(one.sigma_mm[2] for one in seen.spheres)  # light shifts all edges alike
    assert seen.remarks == ()


def test_a_plain_board_shows_as_well_where_glass_and_camera_are():
    plain = Chessboard(discs=(), squares=(99, 99))
    shown = replace(plain, odd_bright=False)  # nobody has said which of its squares are bright
    frame = drawn(moved(NOMINAL, glass_mm=GLASS, camera_mm=CAMERA), board=shown)
    seen = find_arrangement(frame, NOMINAL, plain, HERE)
    assert np.all(np.abs(seen.camera_mm - CAMERA) < 4.0 * seen.camera_sigma_mm)
    assert np.all(np.abs(seen.glass_mm[:2] - GLASS[:2]) < 0.05)


def test_a_print_that_is_stretched_still_shows_where_the_glass_is():
    unmeasured = replace(BOARD, scale_sigma=(0.005, 0.005))
    stretched = drawn(moved(NOMINAL, glass_mm=GLASS, camera_mm=CAMERA), board=BOARD.stretch((0.996, 1.011)))
    seen = find_arrangement(stretched, NOMINAL, unmeasured, HERE)
    assert np.all(np.abs(seen.glass_mm - GLASS) < 3.0 * seen.sigma_mm)
    assert np.all(np.abs(seen.camera_mm - CAMERA) < 3.0 * seen.camera_sigma_mm)
    assert np.all(seen.sigma_mm[:2] < 0.1)


def test_a_coded_board_shows_where_the_camera_is():
    coded = with_codes(
        Chessboard(4.0, discs=(), squares=(44, 42), origin_corner=(20, 22)), Codes("DICT_4X4_1000", 0.7)
    )
    frame = drawn(moved(NOMINAL, glass_mm=GLASS, camera_mm=CAMERA), board=coded)
    seen = find_camera(frame, NOMINAL, coded, np.zeros(3), 3.0)
    assert np.all(np.abs(seen.off_mm - CAMERA) < 4.0 * seen.sigma_mm)


def test_without_a_board_the_glass_is_seen_before_the_camera():
    seen = find_arrangement(drawn(moved(NOMINAL, glass_mm=GLASS), board=False), NOMINAL, None, HERE)
    assert seen.camera_mm is None
    assert np.all(np.abs(seen.glass_mm[:2] - GLASS[:2]) < 0.02)


def test_a_rim_half_out_of_the_frame_is_enough_and_says_what_it_costs(frame):
    camera = NOMINAL.camera
    wide = round(camera.project(np.array(NOMINAL.spheres[1].centre_mm))[0])
    cut = replace(NOMINAL, camera=replace(camera, sensor_px=(wide, camera.sensor_px[1])))
    whole, half = looked(frame).spheres[1], looked(frame[:, :wide], cut).spheres[1]
    assert half.share_seen < 0.6 < whole.share_seen
    assert np.all(np.abs(half.off_mm - GLASS) < 3.0 * half.sigma_mm)
    assert np.all(half.sigma_mm[:2] > whole.sigma_mm[:2])


@pytest.mark.slow
def test_dust_that_looks_like_another_rim_is_refused_and_smaller_rings_are_not(frame):
    one_ball = NOMINAL.with_bodies(NOMINAL.bodies[1:])
    alone = drawn(moved(one_ball, glass_mm=GLASS))
    rim = rim_of(NOMINAL.camera, one_ball.sphere_table()[:, :4], 0, 90).pixel
    (u, v), radius = rim.mean(axis=0), 0.25 * np.ptp(rim, axis=0).sum()
    seen = looked(ring(ring(alone, u + 8.0, v, 0.6 * radius), u, v + 9.0, 0.88 * radius), one_ball)
    assert np.all(np.abs(seen.glass_mm - GLASS) < 3.0 * seen.sigma_mm)
    with pytest.raises(AlignmentError, match="far"):
        looked(ring(alone, u - 9.0, v - 4.0, radius, width_px=6.0), one_ball)


def test_another_number_of_balls_is_refused(frame):
    far = NOMINAL.spheres[1]
    more = NOMINAL.with_bodies([*NOMINAL.bodies, replace(far, name="third", centre_mm=(-30.0, 38.0, 70.0))])
    with pytest.raises(RimNotFound, match="not that of third"):
        looked(frame, more)
    with pytest.raises(RimUnclear, match="scene does not name: another ball"):
        looked(frame, NOMINAL.with_bodies(NOMINAL.bodies[:1]))


@pytest.mark.slow
def test_no_glass_no_board_no_light_are_told_apart(frame):
    bare = drawn(NOMINAL.bare())
    with pytest.raises(RimNotFound, match="no rim of near, far"):
        looked(bare)
    with pytest.raises(TargetNotFound, match="beside the glass"):
        looked(np.full_like(frame, 35))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda frame: frame[:-3], "they must agree"),
        (lambda frame: np.where(frame > 2500, np.nan, frame.astype(np.float32)), "NaN"),
        (lambda frame: np.where(frame > 2000, np.uint16(4095), frame), "saturated"),
    ],
)
def test_spoiled_frames_are_refused(frame, spoil, words):
    with pytest.raises(FrameError, match=words):
        looked(spoil(frame))


@pytest.mark.slow
def test_a_ball_that_stands_off_the_others_is_named():
    near, far = NOMINAL.spheres
    x, y, z = far.centre_mm
    seen = looked(drawn(NOMINAL.with_bodies([near, replace(far, centre_mm=(x + 0.6, y, z))])))
    assert any("far stands" in remark for remark in seen.remarks)


def rendered(name, seed, off_mm):
    nominal = at_size(demo_scene(name), 1008)
    true = moved(misalign(nominal, seed), glass_mm=off_mm)
    tilt = 1.0 + 0.03 * np.linspace(-1.0, 1.0, 1008)
    light = render(true, Print(), Sensor(blur_px=2.0), samples=2, seed=seed)
    return nominal, true, (light * tilt).astype(np.uint16)


@pytest.mark.slow
def test_of_a_rendered_ball_in_front_of_another_the_front_one_is_seen():
    nominal, true, frame = rendered("two_spheres_500", 3, (1.2, -1.0, 2.5))
    seen = find_arrangement(frame, nominal, BOARD, replace(HERE, glass_mm=np.array((0.0, 0.0, 3.0))))
    off = np.array(true.spheres[1].centre_mm) - np.array(nominal.spheres[1].centre_mm)
    assert [one.own_rim for one in seen.spheres] == [False, True]
    assert np.all(seen.sigma_mm[:2] < 0.010)  # of four seeds, errors are 1.1 sigma rms across the view
    assert np.all(np.abs(seen.glass_mm - off) < 3.0 * seen.sigma_mm)
    assert "sphere1 shows no rim of its own" in seen.remarks[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4, 9))
def test_of_a_rendered_pyramid_every_ball_is_seen(seed):
    rng = np.random.default_rng(seed)
    nominal, true, frame = rendered("pyramid_500", seed, (*rng.uniform(-1.2, 1.2, 2), 2.0))
    seen = find_arrangement(frame, nominal, BOARD, replace(HERE, glass_mm=np.array((0.0, 0.0, 2.0))))
    offs = [np.subtract(t.centre_mm, n.centre_mm) for t, n in zip(true.spheres, nominal.spheres, strict=True)]
    for one, off in zip(seen.spheres, offs, strict=True):
        assert np.all(np.abs(one.off_mm - off) < 3.0 * one.sigma_mm)
    assert np.all(np.abs(seen.glass_mm - np.mean(offs, axis=0))[:2] < 0.03)
    assert np.all(np.abs(seen.glass_mm - np.mean(offs, axis=0)) < 3.0 * seen.sigma_mm)
