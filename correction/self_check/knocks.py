"""A knock of a ball, a camera or the light sheet during a run, from views that see the same particles.

The disparity d_k of pair k (`correction.light_sheet.two_cameras`) is the same in all pairs of a run, but for noise
and the heights of the particles that happen to be there, unless something moves.  For each candidate c, with the
derivatives G_c of the disparity by its position,

    p_k = (G' W G + 1/prior^2)^-1 G' W (d_k - <d>)

is its position in pair k as if nothing else moved, W the inverse of the variance of a place's disparity.  How much
p_k scatters is seen from pair to pair, C = <(p_k+1 - p_k)(p_k+1 - p_k)'>/2, which slow drift hardly enters, and of
which the change that is tested is no part.  Means over up to `MEAN_PAIRS` pairs before and after pair k differ by
D, and if nothing was knocked

    T^2 = n m/(n + m) D' C^-1 D,        T^2 (f - P + 1)/(f P) < F(P, f - P + 1)

(Hotelling; P numbers, f degrees of freedom of C).  An alarm is a probability below `FALSE_ALARMS` over the number
of pairs and candidates (Bonferroni).  One thing that moves spoils p_k of others as well: the one is named that
explains most of what the disparities before and after differ by, and those that explain nearly as much.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.self_check.moved_sphere import AS_GOOD

MEAN_PAIRS = 10  # pairs before and after a knock whose means are compared
MIN_SIDE = 3  # pairs on either side
FALSE_ALARMS = 1e-3  # in a run in which nothing moves
CLEAR_T2 = 9.0  # by how much T^2 of a pair is less than that of the knock, to leave it out
MIN_SEEN = 0.7  # of the pairs in which a place must be seen
WINSOR = 6.0  # deviations beyond which a disparity counts as so many
DIFFERENCE_FREEDOM = 2.0 / 3.0  # of successive differences, which overlap
TO_SIGMA = 1.4826  # of a median deviation
Floats = NDArray[np.float64]


class Candidate(NamedTuple):
    """Thing that may be knocked.

    Parameters
    ----------
    name : str
        Its name.
    rates : ndarray of float64, shape (N, 2, P)
        Derivatives of the disparities by its position (and rotation); NaN where they are not known.
    prior : ndarray of float64, shape (P,)
        Standard deviation of a move that is looked for.
    """

    name: str
    rates: Floats
    prior: Floats


@dataclass(frozen=True, eq=False)
class Knock:
    """Knock during a run.

    Parameters
    ----------
    names : tuple of str
        What moved; the most likely first.
    before, after : int
        Last pair that lies surely before it, and first one that lies surely after it.
    move, sigma : ndarray of float64, shape (P,)
        Move of the first, and its standard uncertainty.
    probability : float
        Of as large a difference by chance, anywhere in the run.
    """

    names: tuple[str, ...]
    before: int
    after: int
    move: Floats
    sigma: Floats
    probability: float


def alarm_t2(pairs: int, size: int, candidates: int) -> float:
    """Return T^2 of an alarm for a candidate of `size` numbers."""
    freedom = DIFFERENCE_FREEDOM * (pairs - 2)
    left = freedom - size + 1.0
    ratio = scipy.special.fdtri(size, left, 1.0 - FALSE_ALARMS / (pairs * candidates))
    return float(ratio * freedom * size / left)


def weakest_sigma(covariance: Floats) -> float:
    """Return the standard deviation of a move along the first two numbers, in its least sure direction."""
    return float(np.linalg.eigvalsh(np.linalg.inv(covariance)[:2, :2])[0] ** -0.5)


def least_move(covariance: Floats, pairs: int, first: int, candidates: int) -> float:
    """Return the least move along the first two numbers that half of such runs show, whatever its direction.

    Parameters
    ----------
    covariance : ndarray of float64, shape (P, P)
        Of the position by one pair.
    pairs, first : int
        Pairs of the run, and the one before which it moves.
    candidates : int
        That are tested.
    """
    before, after = (min(count, MEAN_PAIRS) for count in (first, pairs - first))
    share = 1.0 / before + 1.0 / after
    return float(np.sqrt(alarm_t2(pairs, len(covariance), candidates) * share)) * weakest_sigma(covariance)


def least_knocks(
    disparity: Floats, candidates: Sequence[Candidate], names: Collection[str], places: Sequence[int]
) -> dict[str, list[float]]:
    """Return the least knock of some candidates before each of some pairs that half of such runs would show."""
    white = WhiteDisparity.of(disparity, candidates)
    if white is None or len(disparity) < min_pairs(candidates):
        return {}
    found = dict[str, list[float]]()
    for one in candidates:
        if one.name in names:
            follower = Follower.of(one, white)
            positions, count = follower.positions(white.values), len(disparity)
            found[one.name] = [
                least_move(follower.covariance(positions, first), count, first, len(candidates))
                for first in places
            ]
    return found


def min_pairs(candidates: Sequence[Candidate]) -> int:
    """Pairs from which the scatter of all candidates is known."""
    return 2 * (max(len(one.prior) for one in candidates) + MIN_SIDE)


def find_knock(disparity: Floats, candidates: Sequence[Candidate]) -> Knock | None:
    """Look for a knock in the disparities of a run.

    Parameters
    ----------
    disparity : ndarray of float64, shape (K, N, 2)
        Of each pair, in the unit of the derivatives; NaN where it is not known.
    candidates : sequence of Candidate
        What may have moved.

    Returns
    -------
    Knock or None
        The clearest; None if there is none, or fewer pairs than `min_pairs`.
    """
    if len(disparity) < min_pairs(candidates):
        return None
    found = WhiteDisparity.of(disparity, candidates)
    if found is None:
        return None
    white = found.values
    parts = [Follower.of(one, found) for one in candidates]
    tests = np.stack([part.test(white) for part in parts])
    chances = tests[:, :, 1]
    least = float(chances.min()) * chances.size
    if not least < FALSE_ALARMS:
        return None
    first = int(np.argmin(chances.min(axis=0)))
    step = np.nan_to_num(_step(white, first)[0])
    explained = np.array([part.explanation(step) for part in parts])
    order = np.argsort(explained)[::-1]
    likely = [k for k in order if explained[k] >= AS_GOOD * explained[order[0]]]
    names = tuple(candidates[k].name for k in likely)
    best = parts[order[0]]
    squares = tests[order[0], :, 0]
    first = int(np.argmax(squares))
    near = np.flatnonzero(squares > squares[first] - CLEAR_T2)
    near = near[np.abs(near - first) < MIN_SIDE]
    move, sigma = best.step(white, first)
    return Knock(names, int(near.min()) - 1, int(near.max()), move, sigma, least)


@dataclass(frozen=True, eq=False)
class WhiteDisparity:
    """Changes of the disparity in units of their scatter, at places that most pairs show.

    Parameters
    ----------
    values : ndarray of float64, shape (K, M, 2)
        From the median of the run; NaN where not known.
    known : ndarray of bool, shape (N,)
        The places.
    scatter : ndarray of float64, shape (M, 2)
        Standard deviation of a pair.
    """

    values: Floats
    known: NDArray[np.bool_]
    scatter: Floats

    @classmethod
    def of(cls, disparity: Floats, candidates: Sequence[Candidate]) -> "WhiteDisparity | None":
        """Return that of disparities (K, N, 2); None where no place is known well enough."""
        known = np.isfinite(disparity).all(axis=-1).mean(axis=0) >= MIN_SEEN
        for one in candidates:
            known &= np.isfinite(one.rates).all(axis=(1, 2))
        if len(disparity) < 2 or not known.any():
            return None
        off = disparity[:, known]
        off = off - np.nanmedian(off, axis=0)
        change = np.abs(np.diff(off, axis=0))  # which a knock enters once
        typical = np.nanmedian(change, axis=0) / np.sqrt(2.0)
        scatter = np.maximum(TO_SIGMA * typical, 1e-12)
        return cls(np.clip(off / scatter, -WINSOR, WINSOR), known, scatter)


@dataclass(frozen=True, eq=False)
class Follower:
    """Weighted derivatives (M, P) of a candidate, its normal matrix with the prior, and the inverse."""

    rows: Floats
    normal: Floats
    inverse: Floats

    @classmethod
    def of(cls, one: Candidate, white: WhiteDisparity) -> "Follower":
        """Return that of a candidate at the places of a run."""
        rows = one.rates[white.known] / white.scatter[..., None]
        rows = rows.reshape(-1, len(one.prior))
        normal = rows.T @ rows + np.diag(np.square(1.0 / one.prior))
        return cls(rows, normal, np.asarray(np.linalg.inv(normal), np.float64))

    def positions(self, white: Floats) -> Floats:
        """Return the position (K, P) in each pair by the places that it shows; one without any has not moved."""
        values = white.reshape(len(white), -1)
        found = np.zeros((len(values), len(self.inverse)))
        for number, one in enumerate(values):
            lost = np.isnan(one)
            if not lost.all():
                hidden = self.rows[lost]
                normal = self.normal - hidden.T @ hidden
                found[number] = np.linalg.solve(normal, np.nan_to_num(one) @ self.rows)
        return found

    def covariance(self, found: Floats, first: int) -> Floats:
        """Covariance (P, P) of a position by its changes from pair to pair, but that to pair `first`."""
        change = np.delete(np.diff(found, axis=0), first - 1, axis=0)
        return np.asarray(0.5 * change.T @ change / len(change))

    def test(self, white: Floats) -> Floats:
        """T^2 and its probability (K, 2) for a knock before each pair; 0 and 1 near the ends."""
        found = self.positions(white)
        count, size = found.shape
        freedom = DIFFERENCE_FREEDOM * (count - 2)
        left = freedom - size + 1.0
        result = np.tile((0.0, 1.0), (count, 1))
        for first in range(MIN_SIDE, count - MIN_SIDE + 1):
            step, share = _step(found, first)
            square = step @ np.linalg.pinv(self.covariance(found, first)) @ step / share
            ratio = square * left / (freedom * size)
            result[first] = square, scipy.special.fdtrc(size, left, ratio)
        return result

    def explanation(self, step: Floats) -> float:
        """Return how much of a change (M, 2) of the disparity it explains, in its scatter."""
        gain = self.rows.T @ step.ravel()
        return float(gain @ self.inverse @ gain)

    def step(self, white: Floats, first: int) -> tuple[Floats, Floats]:
        """Move (P,) before a pair and its standard uncertainty."""
        found = self.positions(white)
        step, share = _step(found, first)
        return step, np.sqrt(share * np.diag(self.covariance(found, first)))


def _step(values: Floats, first: int) -> tuple[Floats, float]:
    """Mean after pair `first` less that before, and its variance over that of a pair."""
    before = values[max(first - MEAN_PAIRS, 0) : first]
    after = values[first : first + MEAN_PAIRS]
    step = np.nanmean(after, axis=0) - np.nanmean(before, axis=0)
    return np.asarray(step), 1.0 / len(before) + 1.0 / len(after)
