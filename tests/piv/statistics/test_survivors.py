"""Means over pairs of which some have lost their vector: none where most have, unsure where several have."""

import numpy as np
import pytest

from piv.statistics.moments import Moments
from piv.statistics.unresolved import MIN_PAIR_SHARE, Unresolved, is_measured_often, selection_sigma
from tests.piv.correlation.flows import shaken_jet
from tests.piv.fixed_windows import evaluate_pair

SHAPE = (5, 7)


def moments_of(values, valid):
    moments = Moments.nothing(SHAPE)
    for field, there in zip(values, valid, strict=True):
        moments = moments.add(field, there)
    return moments


def test_below_half_of_the_pairs_that_looked_there_is_no_mean():
    valid = np.ones((10, *SHAPE), bool)
    valid[:6, 2, 3] = False  # 4 of 10
    valid[:5, 2, 4] = False  # 5 of 10
    valid[2:, 1, 1] = False  # 2, but only 3 have looked
    moments = moments_of(np.ones((10, *SHAPE, 2)), valid)
    looked = np.full(SHAPE, 10)
    looked[1, 1] = 3
    often = is_measured_often(moments, looked)
    assert not often[2, 3]
    assert often.sum() == often.size - 1
    alone = np.zeros((10, *SHAPE), bool)
    alone[:, 2, 3] = True  # in all pairs, and nothing is around it
    assert not is_measured_often(moments_of(np.ones((10, *SHAPE, 2)), alone), np.full(SHAPE, 10)).any()
    kept = moments.only(often)
    assert np.isnan(kept.mean_uv[2, 3]).all()
    assert kept.count[2, 3] == kept.sigma_count[2, 3] == 0
    assert kept.lowest[2, 3, 0] == np.inf
    for name, values in kept.to_arrays().items():
        np.testing.assert_array_equal(values[often], moments.to_arrays()[name][often])


def test_what_was_lost_may_be_anything_that_stands_around():
    """Vectors of a bimodal place are lost when it moves fast: its mean is low, by less than three sigma."""
    rng = np.random.default_rng(3)
    values, valid = np.zeros((400, *SHAPE, 2)), np.ones((400, *SHAPE), bool)
    values[:, 3:, :, 0] = 12.0
    fast = rng.uniform(size=400) < 0.5
    values[fast, 2, 3, 0] = 12.0
    valid[fast & (rng.uniform(size=400) < 0.6), 2, 3] = False
    moments = moments_of(values, valid)
    looked = np.full(SHAPE, 400)
    sigma = selection_sigma(moments, looked)
    off = moments.mean_uv[2, 3, 0] - values[:, 2, 3, 0].mean()
    assert off < -1.0
    assert abs(off) < 3.0 * sigma[2, 3]
    assert sigma[2, 3] < 3.0
    assert (np.delete(sigma.ravel(), 2 * SHAPE[1] + 3) == 0.0).all()
    even = moments_of(np.full((400, *SHAPE, 2), 12.0), valid)
    assert selection_sigma(even, looked)[2, 3] == 0.0


@pytest.mark.slow
def test_the_mean_of_a_steep_jet_is_that_of_the_flow(particle_pair):
    """24 pairs of a core of 31 px that moves 12 px, sways and pulses: kept, and without bias beyond its sigma."""
    moments = unresolved = looked = None
    true = 0.0
    for seed in range(24):
        flow = shaken_jet(seed)
        field = evaluate_pair(*particle_pair(flow, (256, 512), seed=100 + seed, ppp=0.03, noise=0.02))
        vectors = np.stack((field.u_px, field.v_px), axis=-1)
        one = Moments.of(vectors, field.valid), Unresolved.of(vectors, field.valid, field.steady_px, 1)
        moments = one[0] if moments is None else moments.merge_with(one[0])
        unresolved = one[1] if unresolved is None else unresolved.merge_with(one[1])
        looked = 0 * field.flags.astype(np.int64) + 24
        true = true + np.stack(flow(*np.moveaxis(field.grid_px, -1, 0)), axis=-1) / 24
    assert MIN_PAIR_SHARE == 0.5
    often = is_measured_often(moments, looked)
    moments = moments.only(often)
    systematic = np.hypot(unresolved.share_of_mean(moments.mean_uv), selection_sigma(moments, looked))
    random = np.sqrt(moments.covariance[..., :2] / moments.count[..., None])
    sigma = np.hypot(random, systematic[..., None])
    inner = np.s_[2:-2, 2:-2]
    core = (true[..., 0] > 1.0)[inner]
    off = (moments.mean_uv - true)[inner]
    assert (moments.count[inner][core] / 24).mean() > 0.95
    assert often[inner].all()
    assert np.mean(np.abs(off[core]) > 3.0 * sigma[inner][core]) < 0.02
    assert np.sqrt(np.mean(np.square(off[core]))) < 0.15
