"""Uncertainty of a mean of correlated pairs: by their effective number.

Successive pairs see nearly the same flow where it changes slowly. With the autocorrelation rho_k between pairs k
apart, the mean of n of them has the uncertainty of N = n/T independent pairs,

    T = 1 + 2 sum_k rho_k,      var(mean) = R_uu/N.

s/sqrt(n) instead covers 19 % of the errors, not 68 %, at rho_1 = 0.9. T comes by one of two ways:

**Series kept** (`from_series`): rho_k is added up to its first zero; beyond it there is noise alone.

**Streams** (`Blocking`): the means of blocks of 2^l successive pairs scatter the more independently the longer
they are: V_l, the variance of the mean as blocks of level l tell it, rises to a plateau (Flyvbjerg, Petersen,
J. Chem. Phys. 91, 461 (1989)). What a level still lacks falls as 1/length, so that 2 V_l - V_(l-1) is there
earlier. The first level beyond which the field's average does not rise is taken for all vectors, among levels
with at least LEAST_BLOCKS blocks; if none of them is confirmed by a longer one, the result says so. Blocks with
gaps count by their vectors: V_l = B/(B - 1) sum_b n_b^2 (m_b - m)^2/(sum_b n_b)^2 over B blocks with n_b
vectors of mean m_b. The tree of `piv.statistics.merge_tree` makes the blocks: a node over 2^l pairs is one of
level l.

**Stresses** (`stress_sigma`): var(R_uu) = 2 R_uu^2/N', var(R_uv) = (R_uu R_vv + R_uv^2)/(N' - 1) for Gaussian
fluctuations. Squares forget faster: their autocorrelation is rho_k^2, and for rho_k = rho^k that is T' = (T +
1/T)/2. Rare strong events (intermittency) make both larger than said here.

What the map of the glass is unsure of is the same in every pair, so that no N makes it smaller: it is kept apart
(`correction.fitted.map_sigma`) and added (root sum of squares) only for comparison with a truth.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piv.errors import SeriesError
from piv.statistics.moments import Moments, check_arrays

MIN_INDEPENDENT_BLOCKS = 31  # of a level: sigma is then known to 13 %
ENOUGH_PAIRS = (
    2 * MIN_INDEPENDENT_BLOCKS
)  # of which the means of pairs of pairs can be compared with the pairs themselves
LEAST_TIMES = 20.0  # T that a series must hold: the mean taken off it hides T/n of its autocorrelation
RISE = 0.04  # of the field's average from one level to any longer one that counts as a plateau
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EffectiveSamples:
    """Effective number of independent vectors of a series.

    Parameters
    ----------
    samples : ndarray of float64, shape (ny, nx, 2)
        N for u and v; NaN below two vectors.
    way : str
        How it was found, for files and pages.
    converged : bool
        False: the series is too short for its slowest motion, and N is an upper limit.
    """

    samples: Floats
    way: str
    converged: bool

    def warning(self, pairs: int) -> str:
        """Warning about the samples in a mean of this number of pairs; "" if there is none."""
        if self.converged:
            return ""
        if pairs < ENOUGH_PAIRS:
            return (
                f"{pairs} pairs are too few to estimate the correlation time ({ENOUGH_PAIRS} are enough): if "
                "consecutive pairs are correlated, the sigma of the mean is a lower limit"
            )
        return "the series is too short for its slowest motion: the sigma of the mean is a lower limit"


def mean_sigma(moments: Moments, effective: EffectiveSamples) -> Floats:
    """Random standard uncertainty of the mean (ny, nx, 2); the map's is not in it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(moments.covariance[..., :2] / effective.samples)


def stress_sigma(moments: Moments, effective: EffectiveSamples) -> Floats:
    """Random standard uncertainty of R_uu, R_vv, R_uv (ny, nx, 3), see the top."""
    total = moments.covariance
    n = moments.count[..., None].astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        slow = n / effective.samples
        faster = np.maximum(n / (0.5 * (slow + 1.0 / slow)), 1.0)
        normal = total[..., :2] * np.sqrt(2.0 / faster)
        mixed = np.sqrt(faster[..., 0] * faster[..., 1])
        product = total[..., 0] * total[..., 1] + total[..., 2] ** 2
        shear = np.sqrt(product / np.where(mixed > 1.0, mixed - 1.0, np.nan))
    return np.concatenate((normal, shear[..., None]), axis=-1)


def from_series(vectors: Floats) -> EffectiveSamples:
    """Effective samples of a series that is kept.

    Parameters
    ----------
    vectors : ndarray of float64, shape (n, ny, nx, 2)
        In their order in time, evenly spaced; NaN where there is none.
    """
    vectors = np.asarray(vectors, np.float64)
    if vectors.ndim != 4 or vectors.shape[3] != 2:
        raise SeriesError(f"a series comes as (n, ny, nx, 2), not {vectors.shape}")
    n = len(vectors)
    flat = vectors.reshape(n, -1)
    known = np.isfinite(flat)
    count = known.sum(axis=0)
    off = np.where(known, flat, 0.0)
    off = np.where(known, off - off.sum(axis=0) / np.maximum(count, 1), 0.0)
    square = (off * off).sum(axis=0) / np.maximum(count, 1)
    slow = np.ones(flat.shape[1])
    left = np.flatnonzero((count > 1) & (square > 0.0))
    for lag in range(1, n):
        if not left.size:
            break
        x, seen = off[:, left], known[:, left]
        pairs = (seen[lag:] & seen[:-lag]).sum(axis=0)
        rho = (x[lag:] * x[:-lag]).sum(axis=0) / np.maximum(pairs, 1) / square[left]
        still = (pairs > 0) & (rho > 0.0)
        left, rho = left[still], rho[still]
        slow[left] += 2.0 * (1.0 - lag / n) * rho
    samples = np.where(count > 1, np.maximum(count / slow, 1.0), np.nan)
    seen = count > 1
    long_enough = not seen.any() or n >= LEAST_TIMES * float(slow[seen].mean())
    return EffectiveSamples(
        samples.reshape(vectors.shape[1:]), "autocorrelation to its first zero", converged=long_enough
    )


class Levels(NamedTuple):
    """Blocks of 2^l pairs for l = 0, 1, ...: all (L, ny, nx), the last two (L, ny, nx, 2).

    `weight` is sum n_b^2 of the `blocks` that hold a vector, `samples` sum n_b; `mean` and `squares` are the mean
    of the blocks' means and the sum of their squared deviations from it, both weighted by n_b^2.
    """

    blocks: Floats
    samples: Floats
    weight: Floats
    mean: Floats
    squares: Floats

    def merge_with(self, other: "Levels") -> "Levels":
        """Blocks of both, level by level; levels that only one has stay as they are."""
        longer, shorter = (self, other) if len(self.blocks) >= len(other.blocks) else (other, self)
        both = len(shorter.blocks)
        a, b = Levels(*(x[:both] for x in self)), Levels(*(x[:both] for x in other))
        weight = a.weight + b.weight
        share = (b.weight / np.maximum(weight, 1.0))[..., None]
        d = b.mean - a.mean
        joined = Levels(
            a.blocks + b.blocks,
            a.samples + b.samples,
            weight,
            np.where(share == 1.0, b.mean, a.mean + d * share),
            a.squares + b.squares + d**2 * share * a.weight[..., None],
        )
        return Levels(*(np.concatenate((x, y[both:])) for x, y in zip(joined, longer, strict=True)))

    def variance(self, mean: Floats) -> Floats:
        """V_l (L, ny, nx, 2) about the mean (ny, nx, 2) of all; NaN below two blocks."""
        blocks = np.where(self.blocks > 1.0, self.blocks, np.nan)
        squares = self.squares + self.weight[..., None] * (self.mean - mean) ** 2
        variance: Floats = squares * (blocks / (blocks - 1.0) / np.maximum(self.samples, 1.0) ** 2)[..., None]
        return variance


@dataclass(frozen=True)
class Blocking:
    """Sums over blocks of successive pairs, to be merged by the numbers of the pairs.

    A pair without vectors keeps its place in time by `nothing`.

    Parameters
    ----------
    pairs : int
        Pairs in these sums, with or without a vector.
    count : ndarray of float64, shape (ny, nx)
        Vectors.
    mean : ndarray of float64, shape (ny, nx, 2)
        Their mean.
    levels : Levels
        Their blocks.
    """

    pairs: int
    count: Floats
    mean: Floats
    levels: Levels

    @classmethod
    def nothing(cls, shape: tuple[int, int]) -> "Blocking":
        """One pair without a vector."""
        return cls.of(np.full((*shape, 2), np.nan))

    @classmethod
    def of(cls, vectors: Floats, valid: NDArray[np.bool_] | None = None) -> "Blocking":
        """One pair; as `Moments.of`."""
        one = Moments.of(vectors, valid)
        count, mean = one.count.astype(np.float64), one.mean
        return cls(1, count, mean, _block(count, mean))

    def merge_with(self, other: "Blocking") -> "Blocking":
        """These pairs and those that follow.

        Raises
        ------
        SeriesError
            They belong to different grids.
        """
        if self.count.shape != other.count.shape:
            raise SeriesError(f"blocks on grids of {self.count.shape} and {other.count.shape} cannot be merged")
        count = self.count + other.count
        share = (other.count / np.maximum(count, 1.0))[..., None]
        mean = np.where(share == 1.0, other.mean, self.mean + (other.mean - self.mean) * share)
        levels = self.levels.merge_with(other.levels)
        pairs = self.pairs + other.pairs
        if self.pairs == other.pairs and pairs & (pairs - 1) == 0:  # both whole: a block of the next level
            whole = _block(count, mean)
            levels = Levels(*(np.concatenate((x, y)) for x, y in zip(levels, whole, strict=True)))
        return Blocking(pairs, count, mean, levels)

    def effective(self) -> EffectiveSamples:
        """Effective samples by the plateau, see the top."""
        several = self.count > 1.0
        blocks = self.levels.blocks[:, several]
        usable = 1
        if several.any():
            enough = np.median(blocks, axis=1) >= MIN_INDEPENDENT_BLOCKS
            usable = max(1, int(np.argmin(enough)) if not enough.all() else len(enough))
        variance = self.levels.variance(self.mean)[:usable]
        with np.errstate(invalid="ignore", divide="ignore"):
            slow = np.where(variance[:1] > 0.0, variance / variance[:1], np.nan)
        reached = slow.copy()
        reached[1:] = np.maximum(2.0 * slow[1:] - slow[:-1], slow[:-1])
        moving = np.isfinite(slow).all(axis=(0, 3))
        average = slow[:, moving].mean(axis=(1, 2)) if moving.any() else np.ones(1)
        ahead = np.concatenate((average[:1], 2.0 * average[1:] - average[:-1]))
        level = next(n for n in range(len(ahead)) if (ahead[n + 1 :] <= (1.0 + RISE) * ahead[n]).all())
        longest = np.where(np.isfinite(reached[level]), np.maximum(reached[level], 0.1), 1.0)
        samples = np.where(several[..., None], np.maximum(self.count[..., None] / longest, 1.0), np.nan)
        way = "pairs as they are" if level == 0 else f"blocks of {2 ** (level - 1)} and {2**level} pairs"
        return EffectiveSamples(samples, f"{way} (level {level})", converged=level + 1 < len(ahead))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays by name, for a file; those of the levels have the level as their last axis."""
        arrays = {name: np.moveaxis(values, 0, -1) for name, values in self.levels._asdict().items()}
        return {"pairs": np.array(self.pairs), "count": self.count, "mean_of_all": self.mean} | arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Blocking":
        """Blocks from `to_arrays`, bit for bit.

        Raises
        ------
        SeriesError
            An array is missing, has another shape or kind, or holds what no sum can be.
        """
        depth = np.shape(arrays.get("blocks", ()))[-1:]
        tails: dict[str, tuple[int, ...]] = {"count": (), "mean_of_all": (2,), "blocks": depth, "samples": depth}
        tails |= {"weight": depth, "mean": (2, *depth), "squares": (2, *depth)}
        found = check_arrays(arrays, tails, ())
        pairs = int(arrays["pairs"]) if "pairs" in arrays and np.ndim(arrays["pairs"]) == 0 else 0
        if pairs < 1 or not depth or depth[0] != pairs.bit_length() or not _sound(found):
            raise SeriesError("sums over blocks are not finite or too many; the file is damaged")
        levels = Levels(*(np.moveaxis(found[name], -1, 0) for name in Levels._fields))
        return cls(pairs, found["count"], found["mean_of_all"], levels)


def _block(count: Floats, mean: Floats) -> Levels:
    """One block of `count` vectors as a level of its own."""
    there = (count > 0.0).astype(np.float64)
    return Levels(there[None], count[None], count[None] ** 2, mean[None], np.zeros((1, *mean.shape)))


def _sound(found: Mapping[str, NDArray[Any]]) -> bool:
    counts = ("count", "blocks", "samples", "weight", "squares")
    return all(np.isfinite(x).all() for x in found.values()) and all((found[name] >= 0).all() for name in counts)
