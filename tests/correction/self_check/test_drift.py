"""Balls are followed through disparities that another hand made; quiet runs and what else drifts are no ball."""

import numpy as np
import pytest

from correction.self_check.drift import follow_balls
from tests.correction.self_check.test_knocks import LEFT, PLACES, behind, candidates, disparities

PAIRS = 60
CAMERA, LEFT_BALL, RIGHT_BALL = candidates()


def moved(seed, along, pairs=PAIRS, rates=None):
    """Disparities of a run in which the left ball is at `along` (K, 3) [mm]."""
    rates = behind(LEFT) if rates is None else rates
    return disparities(seed, pairs=pairs) + np.einsum("nac,kc->kna", rates, along)


def path(shape, size_mm=0.02):
    return size_mm * shape[:, None] * np.array([0.8, -0.6, 0.0])


@pytest.mark.parametrize("shape", [np.linspace(0.0, 1.0, PAIRS), np.sin(np.linspace(0.0, 4.0, PAIRS))])
def test_a_drift_is_followed_within_its_uncertainty(shape):
    offs, sigmas = [], []
    for seed in range(6):
        left, right = follow_balls(moved(seed, path(shape)), [LEFT_BALL, RIGHT_BALL], [CAMERA])
        assert left.drifts
        assert not right.drifts
        offs.append((left.position - path(shape))[1:, :2])
        sigmas.append(left.sigma[1:, :2])
    assert np.sqrt(np.mean(np.square(offs))) < 0.003  # of 0.02 mm; positions scatter by 3 um a pair and more
    assert 0.6 < np.sqrt(np.mean(np.square(np.divide(offs, sigmas)))) < 1.5


def test_quiet_runs_and_a_drifting_camera_are_no_drift_of_a_ball():
    pushed = np.linspace(0.0, 0.03, PAIRS)[:, None] * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    for seed in range(20):
        along = pushed if seed % 2 else 0.0 * pushed
        found = follow_balls(moved(50 + seed, along, rates=CAMERA.rates), [LEFT_BALL, RIGHT_BALL], [CAMERA])
        assert not any(one.drifts for one in found)


def test_a_knock_is_no_drift_where_its_pair_is_given():
    knock = path((np.arange(PAIRS) >= 25).astype(float))
    left, _ = follow_balls(moved(3, knock), [LEFT_BALL, RIGHT_BALL], [CAMERA], [25])
    assert not left.drifts
    np.testing.assert_allclose(
        left.position[25:, :2] - left.position[:25, :2].mean(axis=0), knock[25:, :2], atol=0.005
    )
    assert follow_balls(moved(3, knock), [LEFT_BALL, RIGHT_BALL], [CAMERA])[0].drifts


def test_pairs_and_places_that_show_nothing_are_left_out():
    shape = np.linspace(0.0, 1.0, PAIRS)
    found = moved(4, path(shape))
    found[10:14] = np.nan
    found[np.random.default_rng(0).random((PAIRS, PLACES)) < 0.2] = np.nan  # attenuated nothing
    left, _ = follow_balls(found, [LEFT_BALL, RIGHT_BALL], [CAMERA])
    np.testing.assert_allclose(left.position[-1, :2], path(shape)[-1, :2], atol=0.004)
    assert np.isfinite(left.position).all()
    assert follow_balls(np.full((PAIRS, PLACES, 2), np.nan), [LEFT_BALL], [CAMERA]) == []
