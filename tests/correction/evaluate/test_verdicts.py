"""Rules for "better" and for a sigma that keeps what it claims: how often chance alone fools them."""

import numpy as np
import pytest

from correction.evaluate.routes import claim_of, independent_share, smaller


def rms(rng, sigma, count, share):
    """Rms of vectors of which blocks have the same error, as overlapping windows nearly have."""
    alone = max(1, round(count * share))
    return float(np.sqrt(np.mean(rng.normal(0.0, sigma, (alone, 2)) ** 2)))


@pytest.mark.parametrize(("count", "share"), [(12, 0.25), (40, 0.25), (400, 0.25), (100, 1.0)])
def test_noise_alone_is_called_equal(count, share):
    rng = np.random.default_rng(count)
    found = [smaller(rms(rng, 1.0, count, share), rms(rng, 1.0, count, share), (count, count), share)
             for _ in range(600)]  # fmt: skip
    assert found.count("equal") / len(found) > 0.92


@pytest.mark.parametrize("count", [40, 400])
def test_a_true_difference_is_found_and_told_the_right_way_round(count):
    rng = np.random.default_rng(5)
    ways = [
        smaller(rms(rng, 1.0, count, 0.25), rms(rng, 3.0, count, 0.25), (count, count), 0.25) for _ in range(99)
    ]
    assert ways.count("first") > 95
    assert smaller(0.03, 0.01, (count, count), 0.25) == "second"


def test_what_cannot_be_known_or_is_not_worth_a_word_is_equal():
    assert smaller(0.010, 0.030, (2, 4000), 0.25) == "equal"  # one vector would decide
    assert smaller(0.0100, 0.0102, (10**8, 10**8), 0.25) == "equal"  # sure, and nothing
    assert smaller(np.nan, 0.01, (400, 400), 0.25) == "equal"
    assert smaller(0.0, 0.0, (400, 400), 0.25) == "equal"
    assert smaller(0.0, 0.01, (400, 400), 0.25) == "first"
    assert smaller(0.01, 0.0, (400, 400), 0.25) == "second"


def test_windows_that_overlap_count_by_the_part_that_is_their_own():
    assert independent_share(16, 32) == 0.25
    assert independent_share(48, 32) == 1.0


def test_a_sigma_is_held_to_its_claim():
    rng = np.random.default_rng(8)
    right = [claim_of(rms(rng, 1.0, 200, 0.25), 1.0, 200, 0.25) for _ in range(400)]
    assert right.count("as claimed") > 370
    assert claim_of(2.0, 1.0, 200, 0.25) == "too small"
    assert claim_of(0.5, 1.0, 200, 0.25) == "too large"
    assert claim_of(1.05, 1.0, 10**6, 0.25) == "as claimed"  # 5 % is no fault
    assert claim_of(2.0, 1.0, 3, 0.25) == "too few vectors"
    assert claim_of(np.nan, 1.0, 300, 0.25) == "too few vectors"
