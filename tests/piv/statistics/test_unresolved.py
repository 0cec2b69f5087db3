"""What many pairs do not average away, against fields that bend always, never, and anew each time."""

import numpy as np
import pytest

from piv.errors import SeriesError
from piv.statistics.merge_tree import merge_in_order
from piv.statistics.moments import Moments
from piv.statistics.unresolved import Unresolved
from tests.piv.sigma_table import figures, flows_of, of_means

SHAPE, PAIRS = (24, 30), 64
ALL = np.ones(SHAPE, np.bool_)
X = np.broadcast_to(np.arange(30.0), SHAPE)
INNER = (slice(4, -4), slice(4, -4))


def waves(pairs, seed=1):
    """Fields of short waves whose phase is drawn anew for each pair."""
    rng = np.random.default_rng(seed)
    y = np.broadcast_to(np.arange(24.0)[:, None], SHAPE)
    for _ in range(pairs):
        one, other = rng.uniform(0.0, 2.0 * np.pi, 2)
        yield np.stack((np.sin(2 * np.pi * y / 6 + one), np.sin(2 * np.pi * X / 6 + other)), axis=-1)


def of_fields(fields, missing):
    """Shared resolution, its share in stresses, and moments; each pair misses `missing` of it."""
    fields = list(fields)
    parts = [Unresolved.of(field, ALL, np.full(SHAPE, missing), 1) for field in fields]
    total, moments = merge_in_order(enumerate(parts)), merge_in_order(enumerate(map(Moments.of, fields)))
    shared = total.share_of_mean(moments.mean_uv)
    return shared, total.of_stresses(shared, moments.covariance), moments


def test_a_steady_flow_is_missed_in_every_pair():
    shared, stresses, _ = of_fields([next(waves(1))] * 16, 0.03)
    assert shared[INNER] == pytest.approx(0.03)
    assert np.abs(stresses[INNER]).max() < 1e-8


def test_what_bends_anew_each_time_is_missed_now_here_now_there():
    shared, stresses, moments = of_fields(waves(PAIRS), 0.04)
    assert np.sqrt(np.mean(np.square(shared[INNER]))) == pytest.approx(0.04 / np.sqrt(PAIRS), rel=0.15)
    deviation = np.sqrt(moments.covariance[..., 0])
    np.testing.assert_allclose(stresses[INNER][..., 0], (2 * deviation * 0.04 + 0.0016)[INNER], rtol=0.1)


def test_only_what_the_mean_keeps_of_the_bending_stays():
    steady = next(waves(1, 9))
    shared, _, _ = of_fields((steady + 2.0 * wave for wave in waves(PAIRS)), 0.05)
    assert np.median(shared[INNER]) == pytest.approx(0.05 / np.sqrt(5.0), rel=0.25)


def test_vectors_without_a_resolution_do_not_count():
    field, told = next(waves(1)), np.full(SHAPE, 0.02)
    told[:, :10] = np.nan
    few = Unresolved.of(field, ALL & (X < 25), told, 1)
    assert few.count.sum() == 24 * 15
    shared = few.merge_with(few).share_of_mean(field)
    assert np.isnan(shared[:, :10]).all()
    assert shared[6:-6, 14:20] == pytest.approx(0.02)
    nothing = Unresolved.of(field, ALL, np.full(SHAPE, np.nan), 1)
    assert np.isnan(nothing.share_of_mean(field)).all()
    with pytest.raises(SeriesError, match="cannot be merged"):
        few.merge_with(Unresolved.nothing(SHAPE, 2))


@pytest.mark.slow
def test_what_seeding_makes_of_pairs_is_not_said_of_their_mean():
    """Vortices that all pairs show alike: errors were 0.36 to 0.39 of sigma."""
    off, sigma = of_means(lambda seed: flows_of(seed)["vortices"], 451, 2.4, "clear")
    assert 0.6 < figures(off, sigma)[1] < 1.2
