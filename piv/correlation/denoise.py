"""The last filter: detail finer than a window resolves stays where it is stronger than the noise.

The field is split by a local fit into what is smooth over about a window, and the rest. The rest holds the short
waves and most of the noise. Correlation statistics know how strong noise alone would be in each vector (its
variance n). The mean square of what is no noise is estimated over 3 x 3 vectors, those with little noise
counting most,

    s = max(0, sum w (rest^2 - beta n) / sum w),      w = 1/n^2,

where a vector whose own rest^2 exceeds 10 n speaks for itself: beside a step its quiet neighbours have no rest.
The rest of each vector is multiplied by s^2/(s^2 + n^2): a local Wiener filter (Lee, IEEE Trans. PAMI 2, 165
(1980)), but steeper, since in a flow of strong gradients part of n is the flow itself. A uniform flow loses two
thirds of its noise; a wave of two windows and 1 px loses nothing; where the amplitude of a wave is that of the
noise, about half of what the windows have seen of it goes. No filter without knowledge of the noise can do both:
the noise of a linear one is the integral of its gain^2 over all waves.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.planes import smoothed

SMOOTH = 0.625  # of the window's side: standard deviation of the smooth part's weights
ORDER = 3
OWN = 10.0  # times its noise at which a vector's rest speaks for itself: chance hardly reaches it
LARGEST_SIGMA_PX = 0.2  # beyond which correlation statistics mean little

Floats = NDArray[np.float64]


class Parts(NamedTuple):
    """A field in two parts, all (ny, nx, 2) and finite, and the standard deviation of the noise of one vector."""

    smooth: Floats
    rest: Floats
    smooth_sigma_px: Floats


def split(vectors: Floats, good: NDArray[np.bool_], sigma_px: Floats, window_px: int, step_px: int) -> Parts:
    """Smooth part and rest of the good vectors.

    The fit trusts a vector by its uncertainty sigma_px (ny, nx, 2), at most twice as much as a usual one. What
    noise of single vectors counts for in the smooth part is their mean by trust and by the square of the fit's
    weights.
    """
    noise = _noise(sigma_px)
    known = good & np.isfinite(noise)
    usual = float(np.median(noise[known])) if known.any() else 0.0
    trust = np.where(known, 2.0 * usual / (noise + usual), 0.1) if usual > 0.0 else good.astype(float)
    reach = SMOOTH * window_px / step_px
    smooth = smoothed(vectors, good, reach, ORDER, trust)
    reach /= np.sqrt(2.0)
    weight = np.where(known, trust, 0.0)
    total = np.maximum(_blurred(weight, reach), 1e-6)
    weighted = np.where(known[..., None], np.square(weight[..., None] * np.nan_to_num(sigma_px)), 0.0)
    single = np.stack([_blurred(weighted[..., axis], reach) for axis in range(2)], axis=-1)
    # At an edge the fit has half the vectors, and a plane from one side is twice as unsure again.
    single /= (total**2 * np.maximum(_blurred(known.astype(float), reach), 0.05))[..., None]
    return Parts(smooth, np.where(good[..., None], vectors - smooth, 0.0), np.sqrt(single))


def kept_share(rest: Floats, good: NDArray[np.bool_], sigma_px: Floats, beta: float) -> tuple[Floats, Floats]:
    """Share of the rest that is kept, and how much of the flow goes with what is not.

    Parameters
    ----------
    rest : ndarray of float64, shape (ny, nx, 2)
        From `split`.
    good : ndarray of bool, shape (ny, nx)
        Vectors that count.
    sigma_px : ndarray of float64, shape (ny, nx, 2)
        Standard deviation of the rest if it were noise alone; NaN where not known.
    beta : float
        How many times the noise it must exceed.

    Returns
    -------
    share : ndarray of float64, shape (ny, nx)
        From 0 to 1; 1 where no noise is known around.
    loss_px : ndarray of float64, shape (ny, nx)
        Standard deviation of a component of the flow's detail that is taken off, (1 - share) sqrt(s/2).
    """
    noise = _noise(sigma_px)
    known = good & np.isfinite(noise) & (noise > 0.0)
    noise = np.where(known, noise, 1.0)
    weight = np.where(known, noise**-2, 0.0)
    strength = np.square(rest).sum(axis=-1)
    above = strength - beta * noise
    weights = _around(weight)
    signal = np.maximum(0.0, _around(weight * above) / np.where(weights > 0.0, weights, 1.0))
    own = strength - OWN * np.where(known, np.square(sigma_px).sum(axis=-1), np.inf)
    signal = np.maximum(signal, own)
    share = np.where(weights > 0.0, signal**2 / np.maximum(signal**2 + noise**2, 1e-30), 1.0)
    return share, (1.0 - share) * np.sqrt(0.5 * signal)


def _noise(sigma_px: Floats) -> Floats:
    """Variance (ny, nx) of both components together, as far as statistics can be believed."""
    noise: Floats = np.minimum(np.square(sigma_px).sum(axis=-1), 2.0 * LARGEST_SIGMA_PX**2)
    return noise


def _blurred(values: Floats, sigma_steps: float) -> Floats:
    result: Floats = scipy.ndimage.gaussian_filter(values, sigma_steps, mode="constant")
    return result


def _around(values: Floats) -> Floats:
    """Sum over 3 x 3 neighbours."""
    total: Floats = scipy.ndimage.convolve(values, np.ones((3, 3)), mode="constant")
    return total
