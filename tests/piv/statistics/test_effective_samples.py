"""The sigma of a mean against what means of correlated series really do; and blocks against blocks cut by hand."""

import numpy as np
import pytest

from piv.errors import SeriesError
from piv.statistics.effective_samples import ENOUGH_PAIRS, Blocking, from_series, mean_sigma, stress_sigma
from piv.statistics.merge_tree import MergeTree, merge_in_order
from piv.statistics.moments import Moments
from tests.slow_cases import slow


def autoregressive(rho, count, shape, seed=3):
    """x_(k+1) = rho x_k + sqrt(1 - rho^2) noise: mean 0, variance 1, T = (1 + rho)/(1 - rho)."""
    rng = np.random.default_rng(seed)
    series = np.empty((count, *shape, 2))
    series[0] = rng.normal(size=series.shape[1:])
    for k in range(1, count):
        series[k] = rho * series[k - 1] + np.sqrt(1 - rho**2) * rng.normal(size=series.shape[1:])
    return series


def both(series):
    fields = list(enumerate(series))
    moments = merge_in_order((k, Moments.of(x)) for k, x in fields)
    return moments, merge_in_order((k, Blocking.of(x)) for k, x in fields)


@pytest.mark.parametrize(("rho", "lost"), [slow(0.0, 0.0), slow(0.5, 0.0), slow(0.9, 0.0), (0.5, 0.15)])
def test_sigma_of_the_mean_covers_what_it_says(rho, lost):
    series = autoregressive(rho, 1000, (16, 40))
    gone = np.random.default_rng(5).uniform(size=series.shape[:3]) < lost
    series[gone] = np.nan
    moments, blocking = both(series)
    error = np.abs(moments.mean_uv)
    naive = np.mean(error < np.sqrt(moments.covariance[..., :2] / moments.count[..., None]))
    assert naive == pytest.approx({0.0: 0.68, 0.5: 0.42, 0.9: 0.185}[rho], abs=0.06)
    for effective in (from_series(series), blocking.effective()):
        covered = np.mean(error < mean_sigma(moments, effective))
        assert 0.63 < covered < 0.73, (effective.way, covered)
        truth = (1 - rho) / (1 + rho) * moments.count.mean()
        if lost == 0.0:
            assert np.median(effective.samples) == pytest.approx(truth, rel=0.15)
        stress = np.mean(np.abs(moments.covariance - [1, 1, 0]) < stress_sigma(moments, effective), axis=(0, 1))
        assert (stress > 0.61).all(), (effective.way, stress)
        assert (stress < 0.76).all(), (effective.way, stress)


def test_the_level_is_named_and_a_short_series_says_so():
    _, steady = both(autoregressive(0.0, 256, (20, 20)))
    assert steady.effective().way == "pairs as they are (level 0)"
    assert steady.effective().converged
    _, slow = both(autoregressive(0.99, 256, (20, 20)))
    assert not slow.effective().converged
    assert "level" in slow.effective().way


def test_a_kept_series_of_few_slow_motions_says_so():
    assert from_series(autoregressive(0.9, 1000, (8, 8))).converged
    assert from_series(autoregressive(0.0, 50, (8, 8))).converged
    assert not from_series(autoregressive(0.9, 100, (8, 8))).converged
    assert from_series(np.full((5, 2, 2, 2), np.nan)).converged  # nothing moves slowly where nothing is


def test_one_slow_corner_is_not_voted_down():
    series = autoregressive(0.0, 512, (20, 20))
    series[:, :5, :8] = autoregressive(0.9, 512, (5, 8), seed=4)
    _, blocking = both(series)
    samples = blocking.effective().samples
    assert np.median(samples[:5, :8]) < 60
    assert np.median(samples[5:]) > 350


def test_blocks_are_those_cut_by_hand():
    series = autoregressive(0.7, 108, (2, 3)) + 1e4
    _, blocking = both(series)
    assert blocking.pairs == 108
    found = blocking.levels.variance(blocking.mean)
    mean = series.mean(axis=0)
    for level in range(6):
        length = 2**level
        cut = np.array([series[k : k + length].mean(axis=0) for k in range(0, 108 // length * length, length)])
        by_hand = ((cut - mean) ** 2).sum(axis=0) / len(cut) / (len(cut) - 1)
        assert found[level] == pytest.approx(by_hand, rel=1e-7)  # about a mean of 1e4
        assert (blocking.levels.blocks[level] == len(cut)).all()


def test_order_of_completion_shows_in_no_bit():
    series = autoregressive(0.5, 45, (3, 3))
    series[7:9] = np.nan
    whole = both(series)[1].to_arrays()
    tree = MergeTree()
    for k in np.random.default_rng(2).permutation(45):
        tree.add(int(k), Blocking.of(series[k]))
    for name, values in tree.result().to_arrays().items():
        assert values.tobytes() == whole[name].tobytes()
    back = Blocking.from_arrays(whole).to_arrays()
    assert all(values.tobytes() == whole[name].tobytes() for name, values in back.items())


def test_vectors_that_never_were_or_never_move():
    series = np.zeros((40, 2, 2, 2))
    series[:, 0, 0] = np.nan
    series[1:, 0, 1] = np.nan
    moments, blocking = both(series)
    for effective in (from_series(series), blocking.effective()):
        assert np.isnan(effective.samples[0]).all()
        assert (effective.samples[1] == 40).all()
        assert (mean_sigma(moments, effective)[1] == 0.0).all()


def test_damage_is_found():
    arrays = both(autoregressive(0.0, 8, (2, 2)))[1].to_arrays()
    for name in arrays:
        with pytest.raises(SeriesError):
            Blocking.from_arrays({key: value for key, value in arrays.items() if key != name})
        with pytest.raises(SeriesError):
            Blocking.from_arrays(arrays | {name: arrays[name] * np.nan if name != "pairs" else np.array(0)})
    with pytest.raises(SeriesError, match="grids"):
        Blocking.nothing((2, 3)).merge_with(Blocking.nothing((3, 2)))
    with pytest.raises(SeriesError, match="n, ny, nx"):
        from_series(np.zeros((3, 4, 5)))


def test_few_pairs_are_not_called_a_slow_flow():
    """24 pairs that have nothing to do with each other: nothing shows that they do, or that they do not."""
    few, enough = (both(autoregressive(0.0, count, (8, 8)))[1].effective() for count in (24, 4 * ENOUGH_PAIRS))
    assert "24 pairs are too few" in few.warning(24)
    assert "slowest motion" not in few.warning(24)
    assert not enough.warning(4 * ENOUGH_PAIRS)
    assert "slowest motion" in both(autoregressive(0.98, 128, (8, 8)))[1].effective().warning(128)
