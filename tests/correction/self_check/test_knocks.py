"""A knock is found in disparities that another hand made, and quiet or slowly drifting runs have none."""

import numpy as np
import pytest

from correction.self_check.knocks import Candidate, find_knock, least_knocks, min_pairs

PLACES, NOISE_MM, PAIRS = 300, 0.006, 24  # positions scatter by 3 um a pair, as in frames of 504 px
X, Y = np.random.default_rng(5).uniform(-1.0, 1.0, (2, PLACES))
LEFT, RIGHT = np.hypot(X + 0.5, Y) < 0.4, np.hypot(X - 0.5, Y) < 0.4


def behind(lens):
    """Disparity by a millimetre of a ball along x, y, z: bent light behind it, nothing elsewhere."""
    rates = np.zeros((PLACES, 2, 3))
    rates[:, 0, 0] = rates[:, 1, 1] = 0.8 - 0.3 * X**2
    rates[:, :, 2] = np.stack((X, Y), axis=-1)
    return np.where(lens[:, None, None], rates, 0.0)


def candidates():
    camera = np.zeros((PLACES, 2, 6))
    camera[:, 0, 0] = camera[:, 1, 1] = 1.0
    camera[:, :, 2] = 0.1 * np.stack((X, Y), axis=-1)
    camera[:, 0, 3], camera[:, 1, 4], camera[:, 0, 5], camera[:, 1, 5] = 500.0, 500.0, -Y, X
    return [
        Candidate("camera", camera, np.array([1.0, 1.0, 1.0, 3e-3, 3e-3, 3e-3])),
        Candidate("left", behind(LEFT), np.full(3, 0.3)),
        Candidate("right", behind(RIGHT), np.full(3, 0.3)),
    ]


def disparities(seed, first=None, move_mm=(0.02, 0.0, 0.0), lens=LEFT, drift_mm=0.0, pairs=PAIRS):
    """Views that differ everywhere already, noise with tails that windows share, gaps, and a ball that moves."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_t(4, (pairs, PLACES, 2))
    shared = rng.normal(0.0, 0.3, (pairs, 1, 2))  # of the particles of a pair
    found = np.stack((0.3 * X, 0.2 * Y), axis=-1) + NOISE_MM * (noise + shared)
    along = np.linspace(0.0, drift_mm, pairs)[:, None] * np.array([1.0, 0.0, 0.0])
    if first is not None:
        along[first:] += move_mm
    found += np.einsum("nac,kc->kna", behind(lens), along)
    found[rng.random((pairs, PLACES)) < 0.1] = np.nan
    return found


@pytest.mark.parametrize(("name", "lens"), [("left", LEFT), ("right", RIGHT)])
@pytest.mark.parametrize("first", [8, PAIRS - 5])
def test_a_knock_is_named_with_its_pairs(name, lens, first):
    found = find_knock(disparities(first, first, lens=lens), candidates())
    assert found.names == (name,)
    assert found.before < first <= found.after <= found.before + 3
    np.testing.assert_allclose(found.move, (0.02, 0.0, 0.0), atol=0.006)
    assert (np.abs(found.move - (0.02, 0.0, 0.0)) < 4.0 * found.sigma).all()


def test_quiet_and_drifting_runs_have_none():
    for seed in range(12):
        assert find_knock(disparities(100 + seed), candidates()) is None
    assert find_knock(disparities(1, drift_mm=0.005, pairs=200), candidates()) is None


@pytest.mark.parametrize("first", [PAIRS // 2, PAIRS - 5])
def test_knocks_are_found_from_the_least_one_on(first):
    runs = [
        least_knocks(disparities(seed, pairs=PAIRS), candidates(), {"left"}, [first]) for seed in range(40, 44)
    ]
    least = float(np.mean([run["left"] for run in runs]))

    def found(times):
        moves = [(0.0, times * least, 0.0) if seed % 2 else (times * least, 0.0, 0.0) for seed in range(10)]
        runs = [disparities(300 + seed, first, move) for seed, move in enumerate(moves)]
        return sum(find_knock(run, candidates()) is not None for run in runs)

    assert found(0.5) <= 2
    assert found(1.8) == 10


def test_few_pairs_and_nothing_seen_tell_nothing():
    few = min_pairs(candidates()) - 1
    assert find_knock(disparities(2, 8, pairs=few), candidates()) is None
    assert find_knock(np.full((PAIRS, PLACES, 2), np.nan), candidates()) is None
