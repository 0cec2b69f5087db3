"""Statistics of many vector fields on one grid that need no field kept: mean, stresses, skewness, extremes.

Every vector has a number n of its own, since masks and outliers differ from pair to pair. One field is a set of
n = 1 (or 0), and sets A and B are merged by (Chan, Golub, LeVeque, Am. Stat. 37, 242 (1983); Pebay, SAND2008-6212)

    d = mean_B - mean_A,                             mean = mean_A + d n_B/n,
    S_uv = sum (u - mean_u)(v - mean_v)              = S_uv,A + S_uv,B + d_u d_v n_A n_B/n,
    T_u = sum (u - mean_u)^3                         = T_u,A + T_u,B + d_u^3 n_A n_B (n_A - n_B)/n^2
                                                                 + 3 d_u (n_A S_uu,B - n_B S_uu,A)/n;

with n_B = 1 this is Welford's update (Technometrics 4, 419 (1962)). The mean is kept in two numbers, what float64
holds and what is left over, so that a small variance on a large mean loses nothing. Sums depend on the order of
merging in their last bits: merge by `piv.statistics.merge_tree`, and they do not depend on who was ready first.

**Noise.** What correlation adds to each vector with the variance sigma^2 ends up in the Reynolds stresses, not
in the mean: R_uu = S_uu/(n - 1) - mean(sigma_u^2) (Sciacchitano, Wieneke, Meas. Sci. Technol. 27, 084006
(2016)). R_uv has none, as the errors of u and v are taken as independent. The difference may be negative where
nothing fluctuates: it stays so, or averages over it would be biased.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from piv.errors import SeriesError

Floats = NDArray[np.float64]
Some = TypeVar("Some", bound=NDArray[Any])
TAILS = {
    "count": (),
    "mean": (2,),
    "mean_rest": (2,),
    "second": (3,),
    "third": (2,),
    "lowest": (2,),
    "highest": (2,),
    "sigma_count": (),
    "sigma_squares": (2,),
}


@dataclass(frozen=True)
class Moments:
    """Moments of vectors up to the third, vector by vector, in the unit of the vectors that were added.

    Parameters
    ----------
    count : ndarray of int64, shape (ny, nx)
        Number n of vectors.
    mean, mean_rest : ndarray of float64, shape (ny, nx, 2)
        Mean, and what float64 could not hold of it; 0 where n = 0: ask `mean_uv`.
    second : ndarray of float64, shape (ny, nx, 3)
        Sums S_uu, S_vv, S_uv of products of deviations from the mean.
    third : ndarray of float64, shape (ny, nx, 2)
        Sums T_u, T_v of cubes of deviations.
    lowest, highest : ndarray of float64, shape (ny, nx, 2)
        Extremes; +inf and -inf where n = 0.
    sigma_count : ndarray of int64, shape (ny, nx)
        Vectors whose uncertainty was known in both components.
    sigma_squares : ndarray of float64, shape (ny, nx, 2)
        Sum of their sigma^2.
    """

    count: NDArray[np.int64]
    mean: Floats
    mean_rest: Floats
    second: Floats
    third: Floats
    lowest: Floats
    highest: Floats
    sigma_count: NDArray[np.int64]
    sigma_squares: Floats

    @classmethod
    def nothing(cls, shape: tuple[int, int]) -> "Moments":
        """Moments of no field on a grid of `shape` (ny, nx): merged with others, it leaves their bits."""
        return cls.of(np.full((*shape, 2), np.nan))

    @classmethod
    def of(cls, vectors: Floats, valid: NDArray[np.bool_] | None = None, sigma: Floats | None = None) -> "Moments":
        """Moments of one field.

        Parameters
        ----------
        vectors : ndarray of float64, shape (ny, nx, 2)
            Components u, v in any one unit. A vector that is not finite does not count.
        valid : ndarray of bool, shape (ny, nx), optional
            Vectors that count; only measured ones should, not what outlier detection has replaced.
        sigma : ndarray of float64, shape (ny, nx, 2), optional
            Random standard uncertainty of u, v in the same unit; NaN where not known.

        Raises
        ------
        SeriesError
            Arrays of different grids.
        """
        vectors = np.asarray(vectors, np.float64) + 0.0  # no -0: adding nothing would make it +0
        if vectors.ndim != 3 or vectors.shape[2] != 2:
            raise SeriesError(f"vectors come as (ny, nx, 2), not {vectors.shape}")
        grid = vectors.shape[:2]
        good: NDArray[np.bool_] = np.asarray(np.isfinite(vectors).all(axis=-1), np.bool_)
        if valid is not None:
            good = good & require_shape("valid", np.asarray(valid, np.bool_), grid)
        has_sigma: NDArray[np.bool_] = np.zeros(grid, np.bool_)
        squares = np.zeros((*grid, 2))
        if sigma is not None:
            sigma = require_shape("sigma", np.asarray(sigma, np.float64), (*grid, 2))
            has_sigma = good & (np.isfinite(sigma) & (sigma >= 0.0)).all(axis=-1)
            squares = np.where(has_sigma[..., None], np.square(np.where(has_sigma[..., None], sigma, 0.0)), 0.0)
        here = good[..., None]
        return cls(
            count=good.astype(np.int64),
            mean=np.where(here, vectors, 0.0),
            mean_rest=np.zeros((*grid, 2)),
            second=np.zeros((*grid, 3)),
            third=np.zeros((*grid, 2)),
            lowest=np.where(here, vectors, np.inf),
            highest=np.where(here, vectors, -np.inf),
            sigma_count=has_sigma.astype(np.int64),
            sigma_squares=squares,
        )

    def add(
        self, vectors: Floats, valid: NDArray[np.bool_] | None = None, sigma: Floats | None = None
    ) -> "Moments":
        """These moments with one field more, see `of`."""
        return self.merge_with(Moments.of(vectors, valid, sigma))

    def merge_with(self, other: "Moments") -> "Moments":
        """Moments of both sets; `self` comes first where order shows in the last bits.

        Raises
        ------
        SeriesError
            They belong to different grids.
        """
        if self.count.shape != other.count.shape:
            raise SeriesError(
                f"statistics on grids of {self.count.shape} and {other.count.shape} vectors cannot be merged;"
                " evaluate all pairs with the same windows"
            )
        n = self.count + other.count
        n_a, n_b = self.count[..., None].astype(np.float64), other.count[..., None].astype(np.float64)
        total = np.maximum(n_a + n_b, 1.0)
        both = (n_a > 0.0) & (n_b > 0.0)
        d = np.where(both, (other.mean - self.mean) + (other.mean_rest - self.mean_rest), 0.0)
        mean, rest = _two_sum(self.mean, self.mean_rest + d * (n_b / total))
        only_b = (n_a == 0.0) & (n_b > 0.0)
        mean, rest = np.where(only_b, other.mean, mean), np.where(only_b, other.mean_rest, rest)
        products = np.stack((d[..., 0] ** 2, d[..., 1] ** 2, d[..., 0] * d[..., 1]), axis=-1)
        squares_a, squares_b = self.second[..., :2], other.second[..., :2]
        return Moments(
            count=n,
            mean=mean,
            mean_rest=rest,
            second=self.second + other.second + products * (n_a * n_b / total),
            third=self.third
            + other.third
            + d**3 * (n_a * n_b * (n_a - n_b) / total**2)
            + 3.0 * d * (n_a * squares_b - n_b * squares_a) / total,
            lowest=np.minimum(self.lowest, other.lowest),
            highest=np.maximum(self.highest, other.highest),
            sigma_count=self.sigma_count + other.sigma_count,
            sigma_squares=self.sigma_squares + other.sigma_squares,
        )

    def only(self, where: NDArray[np.bool_]) -> "Moments":
        """These moments where `where` (ny, nx) is True, and nothing elsewhere."""
        empty = Moments.nothing((self.count.shape[0], self.count.shape[1])).to_arrays()
        return Moments(
            **{
                name: np.where(where.reshape(where.shape + (1,) * (values.ndim - 2)), values, empty[name])
                for name, values in self.to_arrays().items()
            }
        )

    @property
    def mean_uv(self) -> Floats:
        """Mean (ny, nx, 2); NaN where there is none."""
        return np.where(self.count[..., None] > 0, self.mean + self.mean_rest, np.nan)

    @property
    def covariance(self) -> Floats:
        """Reynolds stresses R_uu, R_vv, R_uv (ny, nx, 3) as measured, noise included; NaN below n = 2."""
        n = self.count[..., None]
        return np.where(n > 1, self.second / np.maximum(n - 1, 1), np.nan)

    @property
    def noise(self) -> Floats:
        """Mean of sigma_u^2, sigma_v^2 (ny, nx, 2); NaN where no sigma was known."""
        known = self.sigma_count[..., None]
        return np.where(known > 0, self.sigma_squares / np.maximum(known, 1), np.nan)

    @property
    def reynolds_stresses(self) -> Floats:
        """R_uu, R_vv, R_uv (ny, nx, 3) without the noise of correlation; see the top of the file."""
        stresses: Floats = self.covariance.copy()
        stresses[..., :2] -= self.noise
        return stresses

    @property
    def skewness(self) -> Floats:
        """Third moment over the second to the power 3/2 (ny, nx, 2), about 0 +- sqrt(6/n) without skewness."""
        n = self.count[..., None]
        squares = self.second[..., :2]
        with np.errstate(divide="ignore", invalid="ignore"):
            skew = np.sqrt(n) * self.third / squares**1.5
        return np.where((n > 2) & (squares > 0.0), skew, np.nan)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays by name, for a file; `from_arrays` leads back, bit for bit."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Moments":
        """Moments from `to_arrays`.

        Raises
        ------
        SeriesError
            An array is missing, has another shape or kind, or holds what no moment can be.
        """
        ints = ("count", "sigma_count")
        found = check_arrays(arrays, TAILS, ints)
        if any((found[name] < 0).any() for name in ints) or (found["sigma_count"] > found["count"]).any():
            raise SeriesError(
                "statistics with counts that cannot be; the file is damaged, evaluate its pairs again"
            )
        finite = [found[name] for name in ("mean", "mean_rest", "second", "third", "sigma_squares")]
        if not all(np.isfinite(values).all() for values in finite) or (found["second"][..., :2] < 0.0).any():
            raise SeriesError("statistics are not finite; the file is damaged, evaluate its pairs again")
        return cls(**found)


def _two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Sum of a and b, and what rounding took off it, exactly (Knuth, TAOCP 2, 4.2.2)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def require_shape(name: str, values: Some, shape: tuple[int, ...]) -> Some:
    """The same array; SeriesError if it has another shape."""
    if values.shape != shape:
        raise SeriesError(f"{name} is {values.shape} where {shape} is needed; both must lie on one grid")
    return values


def check_arrays(
    arrays: Mapping[str, NDArray[Any]], tails: Mapping[str, tuple[int, ...]], whole: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Arrays of one grid by name, from a file, of the shapes and kinds that they must have.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        What a file holds; others than those of `tails` are left alone.
    tails : mapping of str to tuple of int
        Last axes of each, after those of the grid (ny, nx).
    whole : sequence of str
        Names of whole numbers; the others are float64.

    Raises
    ------
    SeriesError
        One is missing, of another shape, or of another kind.
    """
    missing = [name for name in tails if name not in arrays]
    if missing:
        raise SeriesError(f"statistics lack {', '.join(missing)}; the file is damaged or from another version")
    found = {name: np.asarray(arrays[name]) for name in tails}
    first = next(iter(found.values()))
    for name, values in found.items():
        if values.dtype.kind not in ("iu" if name in whole else "f"):
            raise SeriesError(f"{name} holds {values.dtype}; the file is damaged or from another version")
        require_shape(name, values, (*first.shape[:2], *tails[name]))
        found[name] = values.astype(np.int64 if name in whole else np.float64)
    return found
