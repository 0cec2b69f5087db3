"""Slow drift of a ball, a camera or the light sheet during a run, from views that see the same particles.

The disparity of pair k (`correction.self_check.knocks`) gives the position p_k of a candidate as if nothing else
moved.  It is taken as a random walk of unknown rate, p_k = x_k + noise: straight drifts, waves and settling are
all likely paths of one.  The cosine transform (DCT-II) of K pairs has independent coefficients

    c_j of variance r (1 + lambda g_j),        g_j = 1/(4 sin^2(pi j/(2 K))),        j = 1 ... K - 1,

with r the variance of the noise and lambda that of a step over r.  lambda is the one of greatest likelihood; the
path is c_j lambda g_j/(1 + lambda g_j), of variance r lambda g_j/(1 + lambda g_j), counted from the first pair.
Before and after a knock stand paths of their own, with r and lambda in common; a knock by which the path after it
does not begin elsewhere than the one before it ends is a fast drift.  The smoothed path of a straight drift is
flat at its ends, so a jump must also show beside a straight line.

**Alarm.**  If nothing drifts, twice the logarithm of the likelihood over that of lambda = 0 exceeds x with a
probability of at most half of P(chi^2_1 > x): 20 000 runs of 18 to 1000 pairs, normal noise and Student's with 5
degrees of freedom.  A drift is reported where that is below `DRIFT_ALARMS` over the number of all positions.  One
thing that drifts spoils p_k of others as well: that is named which explains most of what the disparity at the end
and at the beginning differ by, and those that explain nearly as much.  (All together are not determined: behind
balls in a row, at 0 and 15 degrees, with two cameras unknown a ball scatters by 57 um a pair instead of 5.)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.self_check.knocks import FALSE_ALARMS, Candidate, Follower, Knock, WhiteDisparity, find_knock
from correction.self_check.moved_sphere import AS_GOOD

DRIFT_ALARMS = 1e-3  # in a run in which nothing drifts
RATES = np.concatenate(([0.0], np.logspace(-7.0, 1.0, 33)))  # lambda; factors of 1.8 are finer than it is known
END = 3  # share of the pairs that are its end, or beginning: one in so many
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CandidatePath:
    """Path of a candidate during a run, as if nothing else moved.

    Parameters
    ----------
    name : str
        Of the candidate.
    position, sigma : ndarray of float64, shape (K, P)
        In each pair, from that in the first one, and its standard uncertainty.
    probability : float
        Of as clear a drift by chance, of anything.
    explained : float
        How much of the change of the disparity it explains, in its scatter.
    jump_chance : float
        Probability by chance of as large a jump at the knock; 1 without one.
    """

    name: str
    position: Floats
    sigma: Floats
    probability: float
    explained: float
    jump_chance: float = 1.0


def follow(
    disparity: Floats, candidates: Sequence[Candidate], knocked_at: int | None = None
) -> list[CandidatePath]:
    """Follow each candidate through the pairs of a run.

    Parameters
    ----------
    disparity : ndarray of float64, shape (K, N, 2)
        Of each pair, in the unit of the derivatives; NaN where it is not known.
    candidates : sequence of Candidate
        What may move.
    knocked_at : int, optional
        Pair before which something was knocked.

    Returns
    -------
    list of CandidatePath
        One a candidate, in their order; none where too few places are seen.
    """
    white = WhiteDisparity.of(disparity, candidates)
    if white is None:
        return []
    pairs = np.flatnonzero(np.isfinite(white.values).any(axis=(1, 2)))
    knocks = [] if knocked_at is None else [int(np.searchsorted(pairs, knocked_at))]
    parts = [slice(a, b) for a, b in pairwise([0, *knocks, len(pairs)]) if b > a]
    change = np.zeros(white.values.shape[1:])
    for part in parts:
        own, end = white.values[pairs[part]], max((part.stop - part.start) // END, 1)
        first, last = (np.nan_to_num(some).mean(axis=0) for some in (own[:end], own[-end:]))
        change += last - first
    found, every = list[CandidatePath](), np.arange(len(disparity))
    size = sum(len(one.prior) for one in candidates)
    for one in candidates:
        follower = Follower.of(one, white)
        positions = follower.positions(white.values)[pairs]
        path, sigma, gain = (np.zeros((len(disparity), len(one.prior))) for _ in range(3))
        jump = np.zeros(len(one.prior))
        for k, values in enumerate(positions.T):
            segments, gain[:, k] = _smooth([values[part] for part in parts])
            place, unsure = (
                np.concatenate([getattr(some, name) for some in segments]) for name in ("path", "sigma")
            )
            for before, after in pairwise(segments):
                variance = before.ends[1] + after.ends[0]
                walked = np.square(after.path[0] - before.path[-1]) / max(variance, 1e-30)
                jump[k] = min(walked, _straight_jump(pairs, values, pairs >= pairs[parts[1].start]))
            path[:, k] = np.interp(every, pairs, place - place[0])
            sigma[:, k] = np.interp(every, pairs, unsure)
        chance = 0.5 * size * float(scipy.special.chdtrc(1.0, gain.max()))
        explained = follower.explanation(change)
        by_chance = float(scipy.special.chdtrc(len(jump), jump.sum()))
        found.append(CandidatePath(one.name, path, sigma, min(chance, 1.0), explained, by_chance))
    return found


def find_changes(disparity: Floats, candidates: Sequence[Candidate]) -> tuple[Knock | None, list[CandidatePath]]:
    """Return the clearest knock, unless it may be a part of a drift, and the path of each candidate.

    The pair and the candidate of a knock are those of the largest change, so its jump is tested as that of any of
    them (Bonferroni): several things that drift at once make the positions of a third one bend.
    """
    knock = find_knock(disparity, candidates)
    if knock is not None:
        paths = follow(disparity, candidates, knock.after)
        jump = next(one.jump_chance for one in paths if one.name == knock.names[0])
        if jump * len(disparity) * len(candidates) < FALSE_ALARMS:
            return knock, paths
    return None, follow(disparity, candidates)


def drifting(paths: Sequence[CandidatePath]) -> list[CandidatePath]:
    """Return what drifts, and what explains it nearly as well; nothing where that may be chance."""
    if not paths or min(path.probability for path in paths) >= DRIFT_ALARMS:
        return []
    likely = sorted(paths, key=lambda path: -path.explained)
    return [path for path in likely if path.explained >= AS_GOOD * likely[0].explained]


def _straight_jump(pairs: NDArray[np.intp], values: Floats, is_after: NDArray[np.bool_]) -> float:
    """Square of the step in its uncertainty where both parts drift along one straight line beside it."""
    rows: Floats = np.column_stack((np.ones(len(pairs)), pairs, is_after)).astype(np.float64)
    normal = np.asarray(np.linalg.pinv(rows.T @ rows), np.float64)
    fit: Floats = normal @ (rows.T @ values)
    noise = float(np.square(values - rows @ fit).sum()) / max(len(pairs) - rows.shape[1], 1)
    return float(np.square(fit[2]) / max(noise * float(normal[2, 2]), 1e-30))


class _Stretch(NamedTuple):
    """Path of a part of the run, its uncertainty from the first pair of all, and the variances of its two ends."""

    path: Floats
    sigma: Floats
    ends: tuple[float, float]


def _smooth(parts: Sequence[Floats]) -> tuple[list[_Stretch], float]:
    """Path of each part with its uncertainty from the first pair of all; twice the gain in log likelihood."""
    modes = [scipy.fft.dct(part, norm="ortho") for part in parts]
    growth = [0.25 / np.square(np.sin(0.5 * np.pi * np.arange(1, len(part)) / len(part))) for part in parts]
    square, g = np.square(np.concatenate([c[1:] for c in modes])), np.concatenate(growth)
    if not square.size:
        return [_Stretch(part, np.zeros_like(part), (0.0, 0.0)) for part in parts], 0.0
    wide = 1.0 + RATES[:, None] * g
    noise = np.maximum((square / wide).mean(axis=-1), 1e-30)
    likely = -0.5 * (square.size * np.log(noise) + np.log(wide).sum(axis=-1))
    best = int(np.argmax(likely))
    rate, r = RATES[best], noise[best]
    found, start = list[_Stretch](), 0.0
    for number, (c, of_part) in enumerate(zip(modes, growth, strict=True)):
        kept = rate * of_part / (1.0 + rate * of_part)
        path = scipy.fft.idct(np.concatenate((c[:1], kept * c[1:])), norm="ortho")
        waves = scipy.fft.idct(np.eye(len(c)), norm="ortho", axis=0)  # (pairs, modes)
        variance = np.concatenate(([r], r * kept))
        ends = float(np.square(waves[0]) @ variance), float(np.square(waves[-1]) @ variance)
        if number == 0:
            start, waves = ends[0], waves - waves[0]
            spread = np.square(waves) @ variance
        else:  # another stretch: independent of the first
            spread = start + np.square(waves) @ variance
        found.append(_Stretch(path, np.sqrt(spread), ends))
    return found, 2.0 * float(likely[best] - likely[0])
