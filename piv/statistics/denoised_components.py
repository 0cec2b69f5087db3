"""Noise filter of velocities with three components, applied after views were combined and not to the views.

What a view shows is u - a w (`piv.statistics.three_components`), and behind glass the slope a changes from place
to place.  Where a w is weaker than the noise of one vector, the filter of a pair (`piv.correlation.denoise`) takes
that change off in every pair, so that the mean of any number of pairs lacks it: u - a w was wrong by 0.1 w behind
two balls at 0 and 15 degrees.  u, v and w themselves do not change with the glass.  So views are evaluated without
the filter, and it is applied to w first and then to

    u = ~u + ~a w,        v = ~v + ~b w

with the filtered w.  Places without w have other noise, and a perspective error; they are filtered by themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piv.correlation.denoise import remove_noise
from piv.correlation.refine import window_weights
from piv.correlation.response import levels_of, noise_growth, parts_of, smoothings_of, total_response
from piv.correlation.settings import PivSettings
from piv.statistics.three_components import ThreeComponents

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseFilter:
    """Noise filter of a field on the grid of an evaluation.

    Parameters
    ----------
    levels_steps : tuple of float
        Standard deviation of the weights of each smoothing [grid steps].
    growths : tuple of float
        Noise of each part of a field over that of the field.
    beta : float
        How many times its noise a part must exceed; 0: no filter.
    """

    levels_steps: tuple[float, ...]
    growths: tuple[float, ...]
    beta: float

    @classmethod
    def of(cls, settings: PivSettings, step_px: int, beta: float) -> "NoiseFilter":
        """Return the filter of vectors that were evaluated with these settings, `step_px` apart."""
        side, levels = settings.windows_px[-1], levels_of(settings, step_px)
        weights, between = window_weights(side, settings.window_sigma), smoothings_of(settings, side, step_px)
        whole = noise_growth(weights, step_px, between, total_response)
        parts = (noise_growth(weights, step_px, between, part) / whole for part in parts_of(levels))
        return cls(tuple(levels), tuple(parts), beta)

    @property
    def least(self) -> float:
        """Share of the noise (standard deviation) that stays where a field is smooth."""
        return self.growths[-1] if self.beta else 1.0

    def filter_w(self, w: Floats, variance: Floats) -> tuple[Floats, Floats, Floats]:
        """Filter one component (ny, nx), NaN where it is not known: values, noise variance, variance taken off."""
        both = [np.repeat(part[..., None], 2, axis=-1) for part in (w, variance)]
        values, noise, taken = (part[..., 0] for part in self.filter_vectors(both[0], both[1], np.isfinite(w)))
        return np.where(np.isfinite(w), values, np.nan), noise, taken

    def apply(
        self, found: ThreeComponents, uvw: Floats, noise: Floats, filtered_w: tuple[Floats, Floats, Floats]
    ) -> tuple[Floats, Floats, Floats]:
        """Filter the velocities of one time, or a mean.

        Parameters
        ----------
        found : ThreeComponents
            How they depend on each other.
        uvw, noise : ndarray of float64, shape (ny, nx, 3)
            Velocities and the variance of their noise.
        filtered_w : tuple of ndarray of float64, shape (ny, nx)
            What `filter_w` returned for w there, and of more places around if there is w.

        Returns
        -------
        tuple of ndarray, shape (ny, nx, 3), (ny, nx, 3, 3), (ny, nx, 3)
            Velocities, covariance of their noise, and variance of the flow that was taken off with the noise.
        """
        has_w = np.isfinite(uvw[..., 2])
        lever = np.where(has_w[..., None], found.covariance[..., :2, 2], 0.0)
        lever = lever / np.where(has_w, found.covariance[..., 2, 2], 1.0)[..., None]  # ~a, ~b
        w = np.where(has_w, filtered_w[0], np.nan)
        noise_w, taken_w = (np.where(has_w, part, 0.0) for part in filtered_w[1:])
        change = np.where(has_w, w - uvw[..., 2], 0.0)[..., None]
        # ~u and w have independent errors: that of w is replaced.
        own = np.maximum(noise[..., :2] - np.square(lever) * noise[..., 2:], 0.0)
        uv, both = uvw[..., :2] + lever * change, own + np.square(lever) * noise_w[..., None]
        noise_uv, taken_uv = both.copy(), np.square(lever) * taken_w[..., None]
        for good in (has_w, ~has_w & np.isfinite(uv[..., 0])):
            values, variance, taken = self.filter_vectors(uv, both, good)
            uv, noise_uv = (
                np.where(good[..., None], new, old) for new, old in ((values, uv), (variance, noise_uv))
            )
            taken_uv = taken_uv + np.where(good[..., None], taken, 0.0)
        column = np.concatenate((lever, np.ones((*has_w.shape, 1))), axis=-1)
        covariance = column[..., :, None] * column[..., None, :] * noise_w[..., None, None]
        for axis in (0, 1):
            covariance[..., axis, axis] = noise_uv[..., axis]
        taken = np.concatenate((taken_uv, taken_w[..., None]), axis=-1)
        return np.concatenate((uv, w[..., None]), axis=-1), covariance, taken

    def filter_vectors(
        self, values: Floats, variance: Floats, good: NDArray[np.bool_]
    ) -> tuple[Floats, Floats, Floats]:
        """Filter two components (ny, nx, 2) of the places `good` (ny, nx); returns as `filter_w`."""
        if not (self.beta and good.any()):
            return values, variance, np.zeros_like(variance)
        growths = [np.full(good.shape, growth) for growth in self.growths]
        sigma = np.sqrt(np.where(good[..., None], variance, np.nan))
        found = remove_noise(np.nan_to_num(values), good, sigma, growths, self.levels_steps, self.beta)
        taken = np.broadcast_to(np.square(found.taken_px)[..., None], variance.shape)
        return found.vectors_px, np.square(found.sigma_px), taken
