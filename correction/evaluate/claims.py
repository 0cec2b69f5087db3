"""Test whether the errors of vectors scatter as their sigma claims.

Errors of N vectors are not N numbers.  Windows of w px that stand s px apart share particles, and with them their
errors: of N vectors at least N min(1, (s / w)^2) are independent, those whose windows do not overlap.  With two
components each that makes n = 2 N (s / w)^2 degrees of freedom.

A sigma claims that errors scatter by it: n (scatter / sigma)^2 then follows chi^2 with n degrees of freedom (and
68.3 % of normal errors lie within 1 sigma, 95.4 % within 2).  Outside the middle 95 %, and by more than 10 %, the
sigma is called too small or too large.
"""

from typing import Literal

import numpy as np
import scipy

MAX_SIGMA_FACTOR = 1.1  # by which a sigma may be off
MIDDLE_95 = (0.025, 0.975)  # quantiles

Claim = Literal["as claimed", "too small", "too large", "too few vectors"]


def independent_share(step_px: float, window_px: float) -> float:
    """Return the share of vectors whose windows do not overlap, 0 to 1."""
    return min(1.0, (step_px / window_px) ** 2)


def claim_of(scatter: float, sigma: float, count: int, share: float) -> Claim:
    """Compare the scatter of `count` vectors with their sigma, both rms of a component."""
    free = 2.0 * share * count
    if free < 2.0 or not (np.isfinite([scatter, sigma]).all() and sigma > 0.0):
        return "too few vectors"
    ratio = scatter / sigma
    low, high = np.sqrt(2.0 * scipy.special.gammaincinv(0.5 * free, MIDDLE_95) / free)  # of chi-square
    if low <= ratio <= high or 1.0 / MAX_SIGMA_FACTOR <= ratio <= MAX_SIGMA_FACTOR:
        return "as claimed"
    return "too small" if ratio > high else "too large"
