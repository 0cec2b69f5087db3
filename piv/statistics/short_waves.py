"""Waves that windows do not show, from the mean of many pairs: they are the same in every pair of a steady flow.

What windows miss of a pair is in part by where particles lie, which is new in every pair.  How much of it is not,
pairs do not tell (`VectorField.steady_px` takes a part off).  Their mean does: noise and seeding in its fourth
differences D^2 are known from the scatter of the pairs, by no model.  With <d^2> of n pairs and D^2 of their mean

    S^2 = (D^2 - <d^2>/n) n/(n - 1),      by chance  (<d^2> - D^2)/(n - 1),

are those of the steady flow and of what changes, of vectors before the noise filter.  S over a quarter and over
half a window tell how steeply the spectrum falls, and with it what is missed of waves shorter than two windows, as
`piv.correlation.finer_waves` has it.  Shorter differences than there, which only a mean has above its noise, tell
a spectrum that goes on from one that ends above a window.

Of windows of usual size only, as that is the size of the table: where one pair in ten has smaller ones nothing is
said, nor where nodes are not a quarter of a window apart.  It is never more than pairs say of themselves.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.finer_waves import AROUND, EXPONENTS, Evaluated, clear_share, differences, tail_of
from piv.correlation.planes import fill_gaps

FOURTH = 4
MIN_USUAL_SHARE = 0.9  # of the pairs, whose vector comes from a window of usual size
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ShortWaves:
    """Sums over pairs, place by place; to be merged by the numbers of the pairs.

    Parameters
    ----------
    how : Evaluated
        Usual windows.
    count : ndarray of int64, shape (ny, nx)
        Vectors whose resolution was known.
    bent_squares : ndarray of float64, shape (ny, nx, 2)
        Sums of the squares of fourth differences over a quarter and over half a window.
    usual : ndarray of int64, shape (ny, nx)
        Vectors that come from windows of usual size.
    missed_squares : ndarray of float64, shape (ny, nx)
        Sum of the squares of their resolution.
    """

    how: Evaluated
    count: NDArray[np.int64]
    bent_squares: Floats
    usual: NDArray[np.int64]
    missed_squares: Floats

    @classmethod
    def nothing(cls, shape: tuple[int, int], how: Evaluated) -> "ShortWaves":
        """Of no pair."""
        none = np.zeros(shape, np.int64)
        return cls(how, none, np.zeros((*shape, 2)), none, np.zeros(shape))

    @classmethod
    def of(
        cls,
        vectors: Floats,
        valid: NDArray[np.bool_],
        resolution: Floats,
        usual: NDArray[np.bool_],
        how: Evaluated,
    ) -> "ShortWaves":
        """One pair.

        Parameters
        ----------
        vectors : ndarray of float64, shape (ny, nx, 2)
            Its vectors before the noise filter.
        valid, usual : ndarray of bool, shape (ny, nx)
            Those that were measured; those that come from windows of usual size.
        resolution : ndarray of float64, shape (ny, nx)
            Standard uncertainty by what windows do not resolve, in the unit of the vectors; NaN where not known.
        how : Evaluated
            Usual windows.
        """
        good = valid & np.isfinite(vectors).all(axis=-1) & np.isfinite(resolution)
        if not good.any():
            return cls.nothing(good.shape, how)
        bent = _difference_squares(vectors, good, how) * good[..., None]
        missed = np.where(good, np.square(resolution), 0.0)
        return cls(how, good.astype(np.int64), bent, (good & usual).astype(np.int64), missed)

    def merge_with(self, other: "ShortWaves") -> "ShortWaves":
        """Of both."""
        return ShortWaves(
            self.how,
            self.count + other.count,
            self.bent_squares + other.bent_squares,
            self.usual + other.usual,
            self.missed_squares + other.missed_squares,
        )

    def short_wave_sigma(self, mean: Floats) -> Floats:
        """Standard deviation (ny, nx) of a component of the mean (ny, nx, 2) by waves that no window shows.

        0 where nothing is known.
        """
        known = np.isfinite(mean).all(axis=-1) & (self.count > 1)
        quarter = self.how.half_window_steps // 2
        if not (known.any() and quarter):
            return np.zeros(known.shape)
        n = np.maximum(self.count, 2)[..., None]
        bent, each = _difference_squares(mean, known, self.how), self.bent_squares / n
        reach = AROUND * self.how.side_px / self.how.step_px
        weight = _around(known.astype(np.float64)[..., None], reach)
        steady, chance = (
            np.maximum(_around(np.where(known[..., None], part, 0.0), reach) / np.maximum(weight, 1e-3), 1e-30)
            for part in ((bent - each / n) * n / (n - 1), (each - bent) / (n - 1))
        )
        tail = tail_of(self.how, ((FOURTH, quarter), (FOURTH, 2 * quarter)))
        steepness = 0.5 * np.log(steady[..., 0] / steady[..., 1])
        exponent = np.interp(-steepness, -np.log(tail.steepness), EXPONENTS)
        factor = np.exp(np.interp(exponent, EXPONENTS, np.log(tail.missed * tail.steepness)))
        missed = factor * np.sqrt(clear_share(steady[..., 0], chance[..., 0]) * steady[..., 1])
        limit = np.sqrt(self.missed_squares / n[..., 0])
        is_usual = known & (self.usual >= MIN_USUAL_SHARE * self.count)
        return np.where(is_usual, np.minimum(missed, limit), 0.0)


def _difference_squares(vectors: Floats, good: NDArray[np.bool_], how: Evaluated) -> Floats:
    """Squares (ny, nx, 2) of fourth differences over a quarter and over half a window; gaps are filled."""
    field, _ = fill_gaps(np.where(good[..., None], vectors, 0.0), good)
    quarter = max(1, how.half_window_steps // 2)
    return np.stack([differences(field, FOURTH, apart) for apart in (quarter, 2 * quarter)], axis=-1)


def _around(values: Floats, reach_steps: float) -> Floats:
    found: Floats = scipy.ndimage.gaussian_filter(values, (reach_steps, reach_steps, 0.0), mode="nearest")
    return found
