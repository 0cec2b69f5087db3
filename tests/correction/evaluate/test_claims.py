"""The test of a sigma: how often chance alone makes it fail."""

import numpy as np

from correction.evaluate.claims import claim_of, independent_share


def rms(rng, sigma, count, share):
    """Rms of vectors of which blocks have the same error, as overlapping windows nearly have."""
    alone = max(1, round(count * share))
    return float(np.sqrt(np.mean(rng.normal(0.0, sigma, (alone, 2)) ** 2)))


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
