"""Systematic error of a mean of many pairs: detail that no pair resolves, and vectors that were lost.

**What all pairs miss.** A vector is unsure by what its window does not resolve, beside noise
(`piv.correlation.resolution`). Part of that is by where particles lie, which changes from pair to pair: it is in
the scatter of the vectors. The other part, r, is in proportion to how much the field bends. What bends in the same
way in every pair is missed in every pair, and no number of pairs makes it smaller; what bends anew each time
(turbulence, noise) is missed now to one side and now to the other. How much is which, second differences say: b of
single fields, whose mean square is <b^2>, and B of the mean field,

    R^2 = min(<r>^2, <r^2> B^2/<b^2>).

The square of the mean r is less where halving shows some by chance (`piv.correlation.halving`), elsewhere each
time. Both say how much is new in each pair, so the lesser counts and not their product.

In a steady flow R is r; where nothing but fluctuations bends B is b/sqrt(N), and so is R. What remains, f^2 =
<r^2> - R^2, is missing in the fluctuations. It moves with what is seen of them, so stresses may lack up to

    2 sqrt(R_uu) f + f^2,      and R_uv  (sqrt(R_uu) + sqrt(R_vv)) f + f^2.

**Vectors that were lost.** Those that are left are not like them. Outlier tests and weak peaks drop vectors
where a window holds a shear layer or a core narrower than itself, and which pairs are dropped depends on what
the flow did in them. So a mean over those that are left is biased, and neither their number nor their scatter
says so. With p, the share of the pairs that looked at a place and have a vector there:

* below `MIN_PAIR_SHARE` there is no mean: most of what it would be of is missing;
* a place alone among others without a mean has none either: nothing supports it;
* elsewhere, what was lost may have moved by anything that the mean shows around. With the range D of a component
  over 3 x 3 places, all of it alike, the mean is off by (1 - p) times a number of mean square D^2/3.

Where dropped vectors are chance, D is small, and so is this.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.planes import fill_gaps
from piv.correlation.resolution import second_differences
from piv.errors import SeriesError
from piv.statistics.moments import Moments, require_shape

MIN_PAIR_SHARE = 0.5
Floats = NDArray[np.float64]


def is_measured_often(moments: Moments, looked: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return where (ny, nx) enough of the pairs that looked, `looked` in number, have a vector; none alone."""
    often = (moments.count > 0) & (moments.count >= MIN_PAIR_SHARE * np.maximum(looked, 1))
    here_and_around = scipy.ndimage.convolve(often.astype(np.int64), np.ones((3, 3), np.int64), mode="constant")
    return np.asarray(often & ((here_and_around > 1) | (often.size == 1)))


def selection_sigma(moments: Moments, looked: NDArray[np.int64]) -> Floats:
    """Standard uncertainty (ny, nx) of a component of the mean by the vectors that were lost, see the top.

    Parameters
    ----------
    moments : Moments
        Of the vectors that are left; places without any do not count.
    looked : ndarray of int64, shape (ny, nx)
        Pairs in which the place was not masked.

    Returns
    -------
    ndarray of float64, shape (ny, nx)
        In the unit of the vectors; NaN where there is no mean.
    """
    here = moments.count > 0
    lost = 1.0 - moments.count / np.maximum(looked, 1)
    mean = np.where(here[..., None], moments.mean_uv, 0.0)
    ends = [np.where(here[..., None], sign * mean, -np.inf) for sign in (1.0, -1.0)]
    high, low = (scipy.ndimage.maximum_filter(end, (3, 3, 1)) for end in ends)
    with np.errstate(invalid="ignore"):
        square = np.square(high + low).mean(axis=-1)
    return np.where(here, np.maximum(lost, 0.0) * np.sqrt(square / 3.0), np.nan)


@dataclass(frozen=True)
class Unresolved:
    """Sums over pairs, vector by vector, in the unit of the vectors; to be merged by the numbers of the pairs.

    Parameters
    ----------
    apart : int
        Nodes over which second differences are taken: half a window.
    count : ndarray of int64, shape (ny, nx)
        Vectors whose resolution was known.
    missed : ndarray of float64, shape (ny, nx, 2)
        Sum of their r, and of its square.
    bent_squares : ndarray of float64, shape (ny, nx)
        Sum of the squares of second differences of these pairs' fields.
    """

    apart: int
    count: NDArray[np.int64]
    missed: Floats
    bent_squares: Floats

    @classmethod
    def nothing(cls, shape: tuple[int, int], apart: int) -> "Unresolved":
        """Of no pair."""
        return cls(apart, np.zeros(shape, np.int64), np.zeros((*shape, 2)), np.zeros(shape))

    @classmethod
    def of(cls, vectors: Floats, valid: NDArray[np.bool_], resolution: Floats, apart: int) -> "Unresolved":
        """One pair.

        Parameters
        ----------
        vectors : ndarray of float64, shape (ny, nx, 2)
            Its vectors.
        valid : ndarray of bool, shape (ny, nx)
            Those that were measured.
        resolution : ndarray of float64, shape (ny, nx)
            The part of it that is the same in every pair of a steady flow (`VectorField.steady_px`); NaN where
            not known.
        apart : int
            See above.

        Raises
        ------
        SeriesError
            Arrays of different grids.
        """
        valid = require_shape("valid", np.asarray(valid, np.bool_), vectors.shape[:2])
        resolution = require_shape("resolution", np.asarray(resolution, np.float64), vectors.shape[:2])
        good: NDArray[np.bool_] = np.asarray(valid & np.isfinite(vectors).all(axis=-1) & np.isfinite(resolution))
        if not good.any():
            return cls.nothing((len(valid), len(valid[0])), apart)
        bent = _curvature(vectors, good, apart)
        missed = np.where(good, resolution, 0.0)[..., None] ** (1, 2)
        return cls(apart, good.astype(np.int64), missed, np.where(good, np.square(bent), 0.0))

    def with_resolution(self, resolution: Floats) -> "Unresolved":
        """The same pair, of which this resolution (ny, nx) is known, where any was: that of unfiltered vectors."""
        missed = np.where(self.count > 0, resolution, 0.0)[..., None] ** (1, 2)
        return replace(self, missed=missed)

    def merge_with(self, other: "Unresolved") -> "Unresolved":
        """Of both; SeriesError if they belong to different grids."""
        if self.count.shape != other.count.shape or self.apart != other.apart:
            raise SeriesError(
                "what two grids do not resolve cannot be merged; evaluate all pairs with the same windows"
            )
        return Unresolved(
            self.apart,
            self.count + other.count,
            self.missed + other.missed,
            self.bent_squares + other.bent_squares,
        )

    def share_of_mean(self, mean: Floats) -> Floats:
        """R (ny, nx): what the mean (ny, nx, 2) of these pairs is unsure of; NaN where no resolution was known."""
        known: NDArray[np.bool_] = np.asarray(np.isfinite(mean).all(axis=-1))
        if not known.any():
            return np.full(self.count.shape, np.nan)
        bent = np.square(_curvature(mean, known, self.apart)) * self.count
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(self.bent_squares > 0.0, np.minimum(bent / self.bent_squares, 1.0), 1.0)
            mean, square = np.moveaxis(self.missed / self.count[..., None], -1, 0)
            return np.where(self.count > 0, np.sqrt(np.minimum(mean**2, square * share)), np.nan)

    def of_stresses(self, shared: Floats, stresses: Floats) -> Floats:
        """By how much stresses (ny, nx, 3) may be too small, see the top; `share_of_mean` is R."""
        with np.errstate(invalid="ignore", divide="ignore"):
            single = np.where(self.count > 0, self.missed[..., 1] / self.count, np.nan)
        f = np.sqrt(np.maximum(single - np.square(shared), 0.0))[..., None]
        deviation = np.sqrt(np.maximum(stresses[..., :2], 0.0))
        both = np.concatenate((2.0 * deviation, deviation.sum(axis=-1, keepdims=True)), axis=-1)
        result: Floats = both * f + f**2
        return result


def _curvature(vectors: Floats, good: NDArray[np.bool_], apart: int) -> Floats:
    """Second differences (ny, nx) of the good vectors, and of a plane through them where they lack."""
    field, _ = fill_gaps(np.where(good[..., None], vectors, 0.0), good)
    return second_differences(field, apart)
