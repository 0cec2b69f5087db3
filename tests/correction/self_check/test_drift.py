"""What drifts is followed and named in disparities that another hand made; quiet runs have no drift."""

import numpy as np
import pytest

from correction.self_check.drift import drifting, find_changes, follow
from tests.correction.self_check.test_knocks import LEFT, PLACES, RIGHT, behind, candidates, disparities

PAIRS = 60


def followed(seed, along, rates=None, knocked_at=None, lost=None):
    """Paths of camera, left and right ball where the left ball, or what has these rates, is at `along` (K, P)."""
    rates = behind(LEFT) if rates is None else rates
    found = disparities(seed, pairs=PAIRS) + np.einsum("nac,kc->kna", rates, along)
    if lost is not None:
        found[lost] = np.nan
    return follow(found, candidates(), knocked_at)


def path(shape, size_mm=0.02):
    return size_mm * shape[:, None] * np.array([0.8, -0.6, 0.0])


@pytest.mark.parametrize("shape", [np.linspace(0.0, 1.0, PAIRS), np.sin(np.linspace(0.0, 4.0, PAIRS))])
def test_a_drift_is_followed_within_its_uncertainty(shape):
    offs, sigmas = [], []
    for seed in range(6):
        paths = followed(seed, path(shape))
        if shape[-1] == 1.0:  # the sine ends about where it begins
            assert [one.name for one in drifting(paths)] == ["left"]
        offs.append((paths[1].position - path(shape))[1:, :2])
        sigmas.append(paths[1].sigma[1:, :2])
    assert np.sqrt(np.mean(np.square(offs))) < 0.004  # of 0.02 mm; positions scatter by 3 um a pair and more
    assert 0.6 < np.sqrt(np.mean(np.square(np.divide(offs, sigmas)))) < 1.5


def test_quiet_runs_have_no_drift_and_a_camera_is_no_ball():
    for seed in range(20):
        assert not drifting(followed(50 + seed, path(np.zeros(PAIRS))))
    pushed = np.linspace(0.0, 0.03, PAIRS)[:, None] * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    for seed in range(4):
        assert drifting(followed(80 + seed, pushed, candidates()[0].rates))[0].name == "camera"


def test_a_knock_is_no_drift_where_its_pair_is_given():
    knock = path((np.arange(PAIRS) >= 25).astype(float))
    paths = followed(3, knock, knocked_at=25)
    assert not drifting(paths)
    off = paths[1].position[:, :2] - knock[:, :2]
    np.testing.assert_allclose(off[25:].mean(axis=0), off[:25].mean(axis=0), atol=0.004)
    assert drifting(followed(3, knock))
    assert paths[1].jump_chance < 1e-3


def test_a_fast_drift_is_no_knock():
    fast = path(np.linspace(0.0, 1.0, PAIRS), 0.08)
    for seed in range(6):
        assert followed(seed, fast, knocked_at=30)[1].jump_chance > 1e-3


def test_pairs_and_places_that_show_nothing_attenuate_no_drift():
    shape = np.linspace(0.0, 1.0, PAIRS)
    lost = np.random.default_rng(0).random((PAIRS, PLACES)) < 0.2
    lost[10:14] = True
    left = followed(4, path(shape), lost=lost)[1]
    np.testing.assert_allclose(left.position[-1, :2], path(shape)[-1, :2], atol=0.004)
    assert np.isfinite(left.position).all()
    assert followed(4, path(shape), lost=np.ones((PAIRS, PLACES), bool)) == []


def test_several_things_that_drift_at_once_are_no_knock():
    rates = np.concatenate([one.rates for one in candidates()], axis=-1)
    rates = rates[..., [0, 1, 6, 7, 9, 10]]  # camera, left and right along x and y
    for seed in range(8):
        ends = np.random.default_rng(600 + seed).normal(0.0, 0.04, 6)
        along = np.linspace(0.0, 1.0, PAIRS)[:, None] * ends
        found = disparities(seed, pairs=PAIRS) + np.einsum("nac,kc->kna", rates, along)
        knock, paths = find_changes(found, candidates())
        assert knock is None
        assert drifting(paths)


def test_a_knock_beside_a_drift_is_found():
    pushed = np.linspace(0.0, 0.02, PAIRS)[:, None] * np.array([1.0, 0.5, 0.0])
    found = disparities(7, 30, pairs=PAIRS) + np.einsum("nac,kc->kna", behind(RIGHT), pushed)
    knock, _ = find_changes(found, candidates())
    assert knock.names[0] == "left"
    assert knock.before < 30 <= knock.after <= 33
