"""Mean and six Reynolds stresses of velocities with three components, summed pair by pair.

Sums are taken of deviations from a reference, a velocity near the mean, so that a small variance on a large mean
loses nothing:  with d = u - u_0 and n vectors

    mean = u_0 + sum d / n,        R_ij = (sum d_i d_j - sum d_i sum d_j / n) / (n - 1) - mean(C_ij)

C_ij is the covariance of the errors of a vector.  Unlike with one camera its mixed parts count: u, v and w of
several views have errors in common (`piv.statistics.three_components`).
"""

from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # uu, vv, ww, uv, uw, vw
NEIGHBOUR_SIDE = 7  # places a side over which variances of few pairs are averaged
NEIGHBOUR_FREEDOM = 8.0  # degrees of freedom of their mean
Floats = NDArray[np.float64]


@dataclass(eq=False)
class StressSums:
    """Sums over pairs of vectors that have all three components.

    Parameters
    ----------
    reference : ndarray of float64, shape (ny, nx, 3)
        A velocity near the mean; NaN counts as 0.
    """

    reference: Floats
    count: NDArray[np.int64] = field(init=False)
    _first: Floats = field(init=False)
    _second: Floats = field(init=False)
    _noise: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.reference = np.nan_to_num(self.reference)
        grid = self.reference.shape[:2]
        self.count = np.zeros(grid, np.int64)
        self._first = np.zeros((*grid, 3))
        self._second, self._noise = np.zeros((*grid, 3, 3)), np.zeros((*grid, 3, 3))

    def add(self, uvw: Floats, covariance: Floats) -> None:
        """Add the vectors (ny, nx, 3) of a pair with the covariance (ny, nx, 3, 3) of their errors."""
        good: NDArray[np.bool_] = np.asarray(np.isfinite(uvw).all(axis=-1))
        off = np.where(good[..., None], uvw - self.reference, 0.0)
        self.count += good
        self._first += off
        self._second += off[..., :, None] * off[..., None, :]
        self._noise += np.where(good[..., None, None], covariance, 0.0)

    @property
    def mean(self) -> Floats:
        """Mean (ny, nx, 3); NaN where there is none."""
        n = self.count[..., None]
        return np.where(n > 0, self.reference + self._first / np.maximum(n, 1), np.nan)

    @property
    def covariance(self) -> Floats:
        """R (ny, nx, 3, 3) as measured, noise included; NaN below two vectors."""
        n = self.count[..., None, None]
        product = self._first[..., :, None] * self._first[..., None, :]
        return np.where(n > 1, (self._second - product / np.maximum(n, 1)) / np.maximum(n - 1, 1), np.nan)

    @property
    def noise(self) -> Floats:
        """Mean variance (ny, nx, 3) of the errors of a vector."""
        total = np.diagonal(self._noise, axis1=-2, axis2=-1)
        return np.asarray(total / np.maximum(self.count, 1)[..., None])

    @property
    def fluctuation(self) -> Floats:
        """Variance (ny, nx, 3) of u, v, w from pair to pair beyond their noise; NaN below two vectors.

        n - 1 differences tell a variance to sqrt(2/(n - 1)) of itself.  So instead of F = s^2 - <C>

            F + k/(k + n - 1) (<F> - F)

        counts, with the mean <F> over `NEIGHBOUR_SIDE` places a side: with many pairs the place itself, with few
        what is around.
        """
        more = np.diagonal(self.covariance, axis1=-2, axis2=-1) - self.noise
        known = np.isfinite(more)
        share, around = (
            scipy.ndimage.uniform_filter(part, (NEIGHBOUR_SIDE, NEIGHBOUR_SIDE, 1), mode="constant")
            for part in (known.astype(np.float64), np.where(known, more, 0.0))
        )
        pull = NEIGHBOUR_FREEDOM / (NEIGHBOUR_FREEDOM + np.maximum(self.count - 1, 1))[..., None]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.maximum(more + pull * (around / share - more), 0.0))

    @property
    def stresses(self) -> Floats:
        """R_uu, R_vv, R_ww, R_uv, R_uw, R_vw (ny, nx, 6) without the noise of the vectors."""
        found = self.covariance - self._noise / np.maximum(self.count, 1)[..., None, None]
        return np.stack([found[..., i, j] for i, j in COMPONENTS], axis=-1)

    def stress_sigma(self, samples: Floats) -> Floats:
        """Random standard uncertainty (ny, nx, 6) of the stresses for so many independent pairs (ny, nx).

        Gaussian fluctuations have  var(R_ij) = (R_ii R_jj + R_ij^2)/(N - 1).
        """
        total = self.covariance
        parts = [total[..., i, i] * total[..., j, j] + total[..., i, j] ** 2 for i, j in COMPONENTS]
        return np.sqrt(np.stack(parts, axis=-1) / np.maximum(samples - 1.0, 1.0)[..., None])
