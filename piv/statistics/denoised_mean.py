"""Noise filter of a mean of one camera, applied after pairs are averaged and not to the pairs.

The filter of a pair (`piv.correlation.denoise`) takes detail that is weaker than the noise of that pair, in every
pair the same: behind glass, where the slopes of rays change from place to place, a mean of any number of pairs
lacks it.  The mean of n pairs has noise 1/sqrt(n) as strong, so that a filter of the mean takes far less.

**Which vectors are used.**  The mean is that of unfiltered vectors, filtered once by their own noise divided by n,
and not by their scatter, which is the flow's where it fluctuates.  Everything else is about single pairs and uses
filtered vectors: stresses, extremes, effective samples, time series, spectra.  The noise of an unfiltered vector
has five times the variance of a filtered one and is known to some 30 %, which stresses could not bear.  What the
filter takes from fluctuations is in the limit that stands beside them (`piv.statistics.unresolved`).

**Sigma.**  With the scatter S of filtered vectors, n_e effective pairs, the noise N of a filtered vector and that
of the filtered mean F,

    sigma^2 = S/n_e + max(F - N/n, 0):

the scatter is as it was measured, and the noise that the mean keeps beyond the pairs is as it is stated.  Flow
that the filter may have taken off the mean is a part of its resolution (`taken`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.effective_samples import EffectiveSamples, mean_sigma
from piv.statistics.moments import Moments

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DenoisedMean:
    """Mean of unfiltered vectors after the noise filter.

    Parameters
    ----------
    unfiltered : Moments
        Of vectors before the noise filter, from which the mean of several series is made.
    filter : NoiseFilter
        The filter.
    mean : ndarray of float64, shape (ny, nx, 2)
        Mean, NaN where there is none.
    noise : ndarray of float64, shape (ny, nx)
        Variance of a component by noise beyond that of the mean of filtered vectors.
    taken : ndarray of float64, shape (ny, nx)
        Standard deviation of a component of the flow that the filter took.
    """

    unfiltered: Moments
    filter: NoiseFilter
    mean: Floats
    noise: Floats
    taken: Floats

    @classmethod
    def of(cls, unfiltered: Moments, filtered: Moments, how: NoiseFilter) -> "DenoisedMean":
        """Filter the mean of pairs.

        Parameters
        ----------
        unfiltered, filtered : Moments
            Of the vectors of the same pairs before and after the noise filter.
        how : NoiseFilter
            The filter.
        """
        mean, n = unfiltered.mean_uv, np.maximum(unfiltered.count, 1)[..., None]
        good = (unfiltered.count > 0) & np.isfinite(unfiltered.noise).all(axis=-1)
        values, noise, taken = how.filter_vectors(mean, unfiltered.noise / n, good)
        beyond = np.maximum(noise - filtered.noise / n, 0.0).mean(axis=-1)
        return cls(
            unfiltered,
            how,
            np.where(good[..., None], values, mean),
            np.where(good, beyond, 0.0),
            np.where(good, np.sqrt(taken.mean(axis=-1)), 0.0),
        )

    def sigma(self, filtered: Moments, effective: EffectiveSamples) -> Floats:
        """Random standard uncertainty (ny, nx, 2) of the mean, see the top; NaN where `mean_sigma` is."""
        return np.hypot(mean_sigma(filtered, effective), np.sqrt(self.noise)[..., None])
