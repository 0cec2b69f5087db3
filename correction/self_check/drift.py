"""Slow drift of balls during a run, from views that see the same particles.

The disparity of pair k (`correction.light_sheet.two_cameras`) is fitted by positions of all balls together with
the cameras and the light sheet, so that what these do is not taken for a ball: a position p_k with noise for each
ball and axis.  Its position is taken as a random walk of unknown rate, p_k = x_k + noise: a straight drift, a
wave and a settling are all likely paths of one.  The cosine transform (DCT-II) of K pairs has independent
coefficients

    c_j of variance r (1 + lambda g_j),        g_j = 1/(4 sin^2(pi j/(2 K))),        j = 1 ... K - 1,

with r the variance of the noise and lambda that of a step over r.  lambda is the one of greatest likelihood; the
path is c_j lambda g_j/(1 + lambda g_j), of variance r lambda g_j/(1 + lambda g_j), counted from the first pair.
Before and after a knock stand paths of their own, with r and lambda in common.

**Alarm.**  If nothing drifts, twice the logarithm of the likelihood over that of lambda = 0 exceeds x with a
probability of at most half of P(chi^2_1 > x): 20 000 runs of 18 to 1000 pairs, normal noise and Student's with 5
degrees of freedom.  A drift is reported where that is below `DRIFT_ALARMS` over the number of balls and axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.self_check.knocks import Candidate, WhiteDisparity, position_fit

DRIFT_ALARMS = 1e-3  # in a run in which nothing drifts
RATES = np.concatenate(([0.0], np.logspace(-7.0, 1.0, 33)))  # lambda; factors of 1.8 are finer than it is known
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BallPath:
    """Path of a ball during a run.

    Parameters
    ----------
    name : str
        Of the candidate.
    position, sigma : ndarray of float64, shape (K, 3)
        In each pair, from that in the first one, and its standard uncertainty [mm].
    probability : float
        Of as clear a drift by chance, in any ball; 1 where none is looked for.
    """

    name: str
    position: Floats
    sigma: Floats
    probability: float

    @property
    def drifts(self) -> bool:
        """True if it drifts by more than chance."""
        return self.probability < DRIFT_ALARMS


def follow_balls(
    disparity: Floats, balls: Sequence[Candidate], others: Sequence[Candidate], knocked_at: Sequence[int] = ()
) -> list[BallPath]:
    """Follow balls through the pairs of a run.

    Parameters
    ----------
    disparity : ndarray of float64, shape (K, N, 2)
        Of each pair [mm]; NaN where it is not known.
    balls, others : sequence of Candidate
        Balls, with three numbers each; and what else may move.
    knocked_at : sequence of int
        Pairs before which something was knocked, rising.

    Returns
    -------
    list of BallPath
        One a ball; without a path where too few places show it, or fewer than two pairs.
    """
    white = WhiteDisparity.of(disparity, [*balls, *others])
    if white is None or not balls:
        return []
    everything = Candidate(
        "all",
        np.concatenate([one.rates for one in (*balls, *others)], axis=-1),
        np.concatenate([one.prior for one in (*balls, *others)]),
    )
    shown = np.isfinite(white.values).any(axis=(1, 2))
    pairs, size = np.flatnonzero(shown), 3 * len(balls)
    found = position_fit(everything, white)[shown][:, :size]
    bounds = [0, *np.searchsorted(pairs, knocked_at), len(pairs)]
    parts = [found[a:b] for a, b in pairwise(bounds) if b > a]
    path, sigma, gain = np.zeros((len(disparity), size)), np.zeros((len(disparity), size)), np.zeros(size)
    for k in range(size):
        segments, gain[k] = _smooth([part[:, k] for part in parts])
        joined = np.concatenate([one for one, _ in segments])
        path[:, k] = np.interp(np.arange(len(disparity)), pairs, joined - joined[0])
        sigma[:, k] = np.interp(np.arange(len(disparity)), pairs, np.concatenate([one for _, one in segments]))
    chance = 0.5 * size * scipy.special.chdtrc(1.0, gain).reshape(-1, 3).min(axis=1)
    return [
        BallPath(one.name, path[:, 3 * n : 3 * n + 3], sigma[:, 3 * n : 3 * n + 3], float(min(chance[n], 1.0)))
        for n, one in enumerate(balls)
    ]


def _smooth(parts: Sequence[Floats]) -> tuple[list[tuple[Floats, Floats]], float]:
    """Path of each part with its uncertainty from the first pair of all; twice the gain in log likelihood."""
    modes = [scipy.fft.dct(part, norm="ortho") for part in parts]
    growth = [0.25 / np.square(np.sin(0.5 * np.pi * np.arange(1, len(part)) / len(part))) for part in parts]
    square, g = np.square(np.concatenate([c[1:] for c in modes])), np.concatenate(growth)
    if not square.size:
        return [(part, np.zeros_like(part)) for part in parts], 0.0
    wide = 1.0 + RATES[:, None] * g
    noise = np.maximum((square / wide).mean(axis=-1), 1e-30)
    likely = -0.5 * (square.size * np.log(noise) + np.log(wide).sum(axis=-1))
    best = int(np.argmax(likely))
    rate, r = RATES[best], noise[best]
    found, start = list[tuple[Floats, Floats]](), 0.0
    for number, (c, of_part) in enumerate(zip(modes, growth, strict=True)):
        kept = rate * of_part / (1.0 + rate * of_part)
        path = scipy.fft.idct(np.concatenate((c[:1], kept * c[1:])), norm="ortho")
        waves = scipy.fft.idct(np.eye(len(c)), norm="ortho", axis=0)  # (pairs, modes)
        variance = np.concatenate(([r], r * kept))
        if number == 0:
            start, waves = float(np.square(waves[0]) @ variance), waves - waves[0]
            spread = np.square(waves) @ variance
        else:  # another stretch: independent of the first
            spread = start + np.square(waves) @ variance
        found.append((path, np.sqrt(spread)))
    return found, 2.0 * float(likely[best] - likely[0])
