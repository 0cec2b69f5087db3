"""When a difference of errors may be called one: rules for "better", and for a sigma that keeps what it claims.

Errors of N vectors are not N numbers.  Windows of w px that stand s px apart share particles, and with them their
errors: of N vectors at least N min(1, (s / w)^2) are independent, those whose windows do not overlap.  With two
components each that makes n = 2 N (s / w)^2 degrees of freedom.

BETTER.  The ratio of two mean square errors follows Fisher's F with n1 and n2 degrees of freedom if both have the
same expectation.  One is called better only if the ratio lies outside the middle 95 % of that distribution, and
the errors differ by 5 % at least, which is worth a word; else they are equal.  Both routes of a pair see the same
frames, so their errors go together and the rule errs towards "equal".

AS CLAIMED.  A sigma claims that errors scatter by it: n (scatter / sigma)^2 then follows chi^2 with n degrees of
freedom (and 68.3 % of normal errors lie within 1 sigma, 95.4 % within 2).  Outside the middle 95 %, and by more
than 10 %, the sigma is called too small or too large.
"""

from typing import Literal

import numpy as np
import scipy

CLEARLY = 0.95  # a smaller error is worth a word below this share of the other
FAIRLY = 1.1  # a sigma may be off by this factor
MIDDLE = (0.025, 0.975)  # of a distribution: where chance leads

Order = Literal["first", "second", "equal"]
Claim = Literal["as claimed", "too small", "too large", "too few vectors"]


def independent_share(step_px: float, window_px: float) -> float:
    """Share of the vectors whose windows do not overlap, 0 to 1."""
    return min(1.0, (step_px / window_px) ** 2)


def clearly_smaller(first: float, second: float) -> Order:
    """Which of two is smaller by 5 % at least: enough for mean sigmas, which chance hardly moves."""
    if not (np.isfinite([first, second]).all() and max(first, second) > 0.0):
        return "equal"
    if CLEARLY * max(first, second) <= min(first, second):
        return "equal"
    return "first" if first < second else "second"


def smaller(first: float, second: float, counts: tuple[int, int], share: float) -> Order:
    """Which of two rms errors is smaller, beyond chance.

    Parameters
    ----------
    first, second : float
        Root mean square errors of a component.
    counts : (int, int)
        Vectors behind each.
    share : float
        Of the vectors that are independent, see `independent_share`.
    """
    free = [2.0 * share * count for count in counts]
    order = clearly_smaller(first, second)
    if order == "equal" or min(free) < 2.0:
        return "equal"
    low, high = scipy.special.fdtri(*free, MIDDLE)  # quantiles of F, without waiting for scipy.stats
    is_chance = second > 0.0 and low <= (first / second) ** 2 <= high
    return "equal" if is_chance else order


def claim_of(scatter: float, sigma: float, count: int, share: float) -> Claim:
    """Whether the errors of `count` vectors scatter as their sigma claims; both are rms of a component."""
    free = 2.0 * share * count
    if free < 2.0 or not (np.isfinite([scatter, sigma]).all() and sigma > 0.0):
        return "too few vectors"
    ratio = scatter / sigma
    low, high = np.sqrt(2.0 * scipy.special.gammaincinv(0.5 * free, MIDDLE) / free)  # of chi-square
    if low <= ratio <= high or 1.0 / FAIRLY <= ratio <= FAIRLY:
        return "as claimed"
    return "too small" if ratio > high else "too large"
