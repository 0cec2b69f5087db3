"""Where to move, from looks: a thousand benches that are put up badly, and axes that do not follow."""

import numpy as np
import pytest

from correction.alignment.moves import STAGE_STEP_MM, Look, plan_moves, require_followed
from correction.alignment.seen import Arrangement
from correction.errors import MoveDoubted

AXES = {"glass": "xyz", "camera": "xyz"}
NAMES = {("glass", "x"): "glass_x", ("glass", "y"): "glass_y", ("glass", "z"): "glass_z"}
SIGMA_MM, CAMERA_SIGMA_MM = np.array((0.006, 0.006, 0.6)), np.array((0.03, 0.03, 0.01))
BACK_MM, PLAY_MM = 3.0, 0.005
CONTACT_MM = 0.025  # by which glass and target may overlap, as docs/files.md says


def seen(glass_mm, camera_mm=(0.0, 0.0, 0.0)):
    return Arrangement(
        np.array(glass_mm), np.diag(SIGMA_MM**2), (), np.array(camera_mm, dtype=float), CAMERA_SIGMA_MM
    )


def aligned(rng, follows=(1.0, 1.0, 1.0)):
    """Align a bench; return where its glass truly stood after each move."""
    put_up, camera_put_up = rng.uniform(-1.5, 1.5, 3), rng.uniform(-0.5, 0.5, 3)
    bias = np.array((*rng.normal(0.0, 0.002, 2), np.clip(rng.normal(), -2.5, 2.5) * SIGMA_MM[2]))
    axes, camera, looks, places = np.array((0.0, 0.0, BACK_MM)), np.zeros(3), [], []
    for _ in range(4):
        play = rng.uniform(-0.5, 0.5, 3) * PLAY_MM
        true = put_up + follows * axes + play
        places.append(true)
        noise = rng.normal(0.0, (0.003, 0.003, 0.05))
        camera_true = camera_put_up + camera + rng.normal(0.0, CAMERA_SIGMA_MM)
        looks.append(Look(axes, camera, seen(true + bias + noise, camera_true)))
        require_followed(looks, NAMES)
        want = plan_moves(looks, AXES, 0.0)
        axes, camera = want.glass_mm, want.camera_mm
    return np.array(places), camera_put_up + camera


def test_a_thousand_benches_are_aligned_and_no_glass_touches():
    rng = np.random.default_rng(1)
    ends = np.empty((1000, 3))
    for number in range(1000):
        places, camera = aligned(rng)
        ends[number] = places[-1]
        assert places[:, 2].min() > -CONTACT_MM  # what touches the target in the scene file stands at 0
        assert np.abs(camera).max() < 0.2
    sideways = np.hypot(ends[:, 0], ends[:, 1])
    assert np.quantile(sideways, 0.95) < STAGE_STEP_MM
    assert sideways.max() < 1.6 * STAGE_STEP_MM  # what is left is the bias of the looks


def test_glass_that_stands_right_is_left_alone():
    want = plan_moves([Look(np.zeros(3), np.zeros(3), seen((0.0009, -0.0005, 0.3)))], AXES, 0.0)
    assert np.all(want.glass_mm == 0.0)
    assert np.all(want.camera_mm == 0.0)


def test_towards_the_target_it_stays_as_far_as_it_is_not_sure():
    want = plan_moves([Look(np.zeros(3), np.zeros(3), seen((0.0, 0.0, 8.0)))], AXES, 0.0)
    assert want.glass_mm[2] + 8.0 == pytest.approx(3.0 * SIGMA_MM[2])
    far_off = plan_moves([Look(np.zeros(3), np.zeros(3), seen((0.0, 0.0, 8.0)))], AXES, 5.0)
    assert far_off.glass_mm[2] + 8.0 == pytest.approx(0.0)
    too_near = plan_moves([Look(np.zeros(3), np.zeros(3), seen((0.0, 0.0, -2.0)))], AXES, 0.0)
    assert too_near.glass_mm[2] - 2.0 == pytest.approx(3.0 * SIGMA_MM[2])


@pytest.mark.parametrize(
    ("follows", "words"),
    [
        ((-1.0, 1.0, 1.0), "glass_x .* the other way"),
        ((1.0, 0.0, 1.0), "glass_y .* stands still"),
        ((1.0, 0.5, 1.0), "glass_y .* not the way that was asked for"),
    ],
)
def test_an_axis_that_does_not_follow_is_named_after_the_first_move(follows, words):
    with pytest.raises(MoveDoubted, match=words):
        aligned(np.random.default_rng(5), np.array(follows))


def test_what_no_axis_carries_is_not_moved():
    want = plan_moves([Look(np.zeros(3), np.zeros(3), seen((0.5, 0.5, 0.0)))], {"glass": "x"}, 0.0)
    assert want.glass_mm.tolist() == [-0.5, 0.0, 0.0]
    assert want.sideways_mm == pytest.approx(np.hypot(0.5, 0.5))
