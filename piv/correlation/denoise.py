"""The last filter: detail stays where it is stronger than the noise, of every size that is worth asking about.

The field is split by local fits into what is smooth over two windows, what is smooth over one but not over two,
and the rest. The rest holds the short waves and most of the noise. Correlation statistics know how strong noise
alone would be in each part of each vector (its variance n). The mean square of what is no noise is estimated over
the neighbours, those with little noise counting most,

    s = max(0, sum w (part^2 - beta n) / sum w),      w = 1/n^2,

where a vector whose own part^2 exceeds 10 n speaks for itself: beside a step its quiet neighbours have no rest.
Each part of each vector is multiplied by s^2/(s^2 + n^2): a local Wiener filter (Lee, IEEE Trans. PAMI 2, 165
(1980)), but steeper, since in a flow of strong gradients part of n is the flow itself. A uniform flow loses four
fifths of its noise; a wave of two windows and 1 px loses nothing; where the amplitude of a wave is that of the
noise, about half of what the windows have seen of it goes. No filter without knowledge of the noise can do both:
the noise of a linear one is the integral of its gain^2 over all waves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.planes import smooth_field

LEVELS = 0.625, 1.25  # of the window's side: standard deviation of the weights of what is smooth
ORDER = 3
OWN = 10.0  # times its noise at which a vector's part speaks for itself: chance hardly reaches it
MAX_TRUSTED_SIGMA_PX = 0.2  # beyond which correlation statistics mean little
LOWER = 1.4  # times its noise beyond which a part is flow, by more neighbours
LOUDEST = 5.0  # times its noise: the most that a place says of others
NEIGHBOURS = 0.8  # of a level's deviation: how far those are asked how strong a part is
MORE = 2.0  # of a level's deviation: that of the weights of more neighbours

Floats = NDArray[np.float64]


class Denoised(NamedTuple):
    """Vectors and their random sigma (ny, nx, 2), and the deviation of a component of what was taken (ny, nx)."""

    vectors_px: Floats
    sigma_px: Floats
    taken_px: Floats


def remove_noise(
    vectors: Floats,
    good: NDArray[np.bool_],
    sigma_px: Floats,
    growths: Sequence[Floats],
    levels_steps: Sequence[float],
    beta: float,
) -> Denoised:
    """Take the detail off that is no stronger than its noise.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], anything where not good.
    good : ndarray of bool, shape (ny, nx)
        Vectors that count.
    sigma_px : ndarray of float64, shape (ny, nx, 2)
        Standard deviation of the noise of one correlation; NaN where not known.
    growths : sequence of ndarray of float64, shape (ny, nx)
        What such noise is in each part of a field, as a factor, from the finest part to the smoothest: one more
        than levels (`piv.correlation.response.noise_growth`).
    levels_steps : sequence of float
        Standard deviation of the weights of each smoothing [grid steps], the finest first.
    beta : float
        How many times its noise a part must exceed.
    """
    known = good & np.isfinite(sigma_px).all(axis=-1)
    stated = np.where(known[..., None], sigma_px, np.inf)
    noises = [np.square(np.minimum(stated, MAX_TRUSTED_SIGMA_PX) * growth[..., None]) for growth in growths]
    whole = [np.square(np.where(known[..., None], sigma_px, 0.0) * growth[..., None]) for growth in growths]
    trust = _trust(noises[-1].sum(axis=-1), good, known)
    fields = [np.where(good[..., None], vectors, 0.0)]
    fields += [smooth_field(vectors, good, level, ORDER, trust) for level in levels_steps]
    fields[0] = np.where(good[..., None], vectors, fields[1])
    around = [_Around(trust, known, level) for level in levels_steps]
    result, variance, taken = fields[-1].copy(), around[-1].mean(whole[-1]), np.zeros(good.shape)
    for number in reversed(range(len(levels_steps))):
        part = fields[number] - fields[number + 1]
        # The finest part is each vector's own, the others are made of many.
        noise = around[number - 1].mean(noises[number]) if number else noises[0]
        alone = noise if number else np.square(stated * growths[0][..., None])
        share, lost = wiener_share(
            np.square(part).sum(axis=-1), noise.sum(axis=-1), alone.sum(axis=-1), good if number else known, beta,
            levels_steps[number],
        )  # fmt: skip
        result += share[..., None] * part
        own = around[number - 1].mean(whole[number]) if number else whole[0]
        variance = variance + np.square(share)[..., None] * own
        taken += 0.5 * lost
    unknown = (good & ~known)[..., None]
    return Denoised(result, np.where(unknown, np.nan, np.sqrt(variance)), np.sqrt(taken))


def wiener_share(
    strength: Floats,
    noise: Floats,
    alone: Floats,
    known: NDArray[np.bool_],
    beta: float,
    level_steps: float,
) -> tuple[Floats, Floats]:
    """Share (ny, nx) of a part that is kept, 1 where no noise is known around; and the flow's square that goes.

    Parameters
    ----------
    strength, noise : ndarray of float64, shape (ny, nx)
        Square of the part, and its variance if it were noise alone, as far as that can be believed.
    alone : ndarray of float64, shape (ny, nx)
        That variance as it is stated, for a vector that speaks for itself.
    known : ndarray of bool, shape (ny, nx)
        Where both are.
    beta : float
        How many times the noise it must exceed.
    level_steps : float
        Standard deviation of the weights of what is smooth [grid steps].
    """
    known = known & (noise > 0.0)
    noise = np.where(known, noise, 1.0)
    weight = np.where(known, noise**-2, 0.0)
    weights, above = (_around(part, level_steps) for part in (weight, weight * (strength - beta * noise)))
    signal = np.maximum(0.0, above / np.where(weights > 0.0, weights, 1.0))
    signal = np.maximum(signal, np.where(known, strength - OWN * alone, 0.0))
    share = np.where(weights > 0.0, signal**2 / np.maximum(signal**2 + noise**2, 1e-30), 1.0)
    # What goes may be weaker than the noise, and still be flow: more neighbours say how much. A jet beside it
    # says no more than what would be seen here.
    weights, above = (
        _blur(part, MORE * level_steps)
        for part in (weight, weight * (np.minimum(strength, LOUDEST * noise) - LOWER * noise))
    )
    flow = np.maximum(0.0, above / np.where(weights > 0.0, weights, 1.0))
    return share, np.square(1.0 - share) * np.maximum(flow, signal)


class _Around:
    """Means over the vectors around each node, as a smoothing weighs them."""

    def __init__(self, trust: Floats, known: NDArray[np.bool_], level_steps: float) -> None:
        self._reach, self._known = level_steps / np.sqrt(2.0), known
        self._weight = np.where(known, trust, 0.0)
        total = np.maximum(_blur(self._weight, self._reach), 1e-6)
        # At an edge the fit has half the vectors, and a plane from one side is twice as unsure again.
        self._total = total**2 * np.maximum(_blur(known.astype(float), self._reach), 0.05)

    def mean(self, noise: Floats) -> Floats:
        """Mean of variances (ny, nx, 2) by trust and by the square of the fit's weights."""
        weighted = np.square(self._weight)[..., None] * noise
        mean = np.stack([_blur(weighted[..., axis], self._reach) for axis in range(2)], axis=-1)
        found: Floats = mean / self._total[..., None]
        return found


def _trust(noise: Floats, good: NDArray[np.bool_], known: NDArray[np.bool_]) -> Floats:
    """Weights (ny, nx) of vectors in what is smooth: at most twice that of a usual one."""
    usual = float(np.median(noise[known])) if known.any() else 0.0
    return np.where(known, 2.0 * usual / (noise + usual), 0.1) if usual > 0.0 else good.astype(float)


def _blur(values: Floats, sigma_steps: float) -> Floats:
    result: Floats = scipy.ndimage.gaussian_filter(values, sigma_steps, mode="constant")
    return result


def _around(values: Floats, level_steps: float) -> Floats:
    """Sum over all neighbours that a level asks: 3 x 3 where windows are half a window apart."""
    side = 2 * max(1, round(NEIGHBOURS * level_steps)) + 1
    total: Floats = scipy.ndimage.convolve(values, np.ones((side, side)), mode="constant")
    return total
