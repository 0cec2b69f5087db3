"""Particles of a frame: their positions, to a hundredth of a pixel, and their uncertainties.

A maximum of the slightly blurred frame that stands well above the noise is fitted by a Gaussian (height, place,
width) on 5 x 5 px, by least squares. What is left of the pixels after the fit must be no more than noise and the
few per cent by which a pixel's mean differs from a Gaussian's middle; two images that overlap leave more and are
given up. Photons make bright pixels noisier: variance = noise^2 + gain model, with the gain from what the fits of
all particles leave. The covariance of the fit under that noise, or the rest if it is larger, is the uncertainty:

    C = N^-1 (sum_k s_k s_k^T variance_k) N^-1,   N = sum_k s_k s_k^T,   s_k = d model_k / d parameters
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLUR_PX = 0.8
ABOVE = 6.0  # times the blurred noise a maximum must stand above the background
BLURRED = 0.35  # of a pixel's noise is left by the blur
MISFIT, UNEVEN = 3.0, 0.03  # rest over what is expected; share of the height by which a pixel is no Gaussian
WIDEST_PX, FARTHEST_PX = 1.6, 1.0  # standard deviation of an image; its middle from the highest pixel
WORST_PX = 1.0  # a place known no better is none
QUARTILE = 0.78  # lower quartile of chi-squared over its mean, 25 pixels less 4 parameters
STEPS = 8
SIDE = np.arange(-2, 3)
ACROSS, DOWN = (part.ravel().astype(float) for part in np.meshgrid(SIDE, SIDE))


class Particles(NamedTuple):
    """Places u, v (N, 2) [px], their standard uncertainties (N, 2), and heights (N,) in counts."""

    place_px: Floats
    sigma_px: Floats
    height: Floats


def find_particles(frame: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> Particles:
    """Particle images of a frame that stand alone.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        Intensities.
    valid : ndarray of bool, shape (H, W), optional
        True where it shows the flow; an image counts if all its 5 x 5 px do.
    """
    values = np.asarray(frame, float)
    usable = np.isfinite(values) if valid is None else np.isfinite(values) & valid
    if not usable.any():
        return Particles(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    values = np.where(usable, values - np.median(values[usable]), 0.0)
    noise = _noise(values, usable)
    smooth = scipy.ndimage.gaussian_filter(values, BLUR_PX)
    peaks = (smooth == scipy.ndimage.maximum_filter(smooth, 3)) & (smooth > ABOVE * BLURRED * noise)
    peaks &= scipy.ndimage.binary_erosion(usable, np.ones((5, 5), bool))
    rows, columns = np.nonzero(peaks)
    pixels = values[rows[:, None] + DOWN.astype(int), columns[:, None] + ACROSS.astype(int)]
    height, place, width, covariance, rest = _fit(pixels, noise)
    alone = (rest < MISFIT * np.hypot(noise, UNEVEN * height)) & (width < WIDEST_PX)
    alone &= (np.abs(place) < FARTHEST_PX).all(axis=1) & (covariance < WORST_PX**2).all(axis=1)
    middle = np.stack([columns, rows], axis=-1) + place
    return Particles(middle[alone], np.sqrt(covariance[alone]), height[alone])


def _noise(values: Floats, usable: NDArray[np.bool_]) -> float:
    """Standard deviation of a pixel's noise, from differences of neighbours, most of which show no particle."""
    both = usable[:, 1:] & usable[:, :-1]
    apart = np.abs((values[:, 1:] - values[:, :-1])[both])
    return max(float(np.median(apart)) * 1.4826 / np.sqrt(2.0), 1e-9) if apart.size else 1e-9


def _fit(pixels: Floats, noise: float) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Height (N,), place (N, 2), width (N,), variances of the place (N, 2) and rest (N,) of pixels (N, 25)."""
    count = len(pixels)
    height, place, width = 1.1 * pixels[:, 12], np.zeros((count, 2)), np.full(count, 0.85)
    for _ in range(STEPS):
        slopes, model = _slopes(height, place, width)
        normal = np.einsum("nki,nkj->nij", slopes, slopes) + 1e-9 * np.eye(4)
        step = np.linalg.solve(normal, np.einsum("nki,nk->ni", slopes, pixels - model)[..., None])[..., 0]
        height = np.maximum(height + step[:, 0], 1e-6)
        place = np.clip(place + np.clip(step[:, 1:3], -0.5, 0.5), -1.2, 1.2)
        width = np.clip(width + np.clip(step[:, 3], -0.3, 0.3), 0.3, 3.0)
    slopes, model = _slopes(height, place, width)
    rest = np.sqrt(np.square(pixels - model).sum(axis=1) / (pixels.shape[1] - 4))
    pixel_variance = noise**2 + _gain(model, rest, noise) * model
    inverse = np.linalg.inv(np.einsum("nki,nkj->nij", slopes, slopes) + 1e-9 * np.eye(4))
    lever = np.einsum("nij,nkj->nki", inverse[:, 1:3], slopes)  # d place / d pixel
    variances = np.einsum("nki,nk->ni", np.square(lever), pixel_variance)
    variances *= np.maximum(np.square(rest) / pixel_variance.mean(axis=1), 1.0)[:, None]
    return height, place, width, variances, rest


def _gain(model: Floats, rest: Floats, noise: float) -> float:
    """Variance that a count of light adds, from the rest (N,) of fitted models (N, 25).

    The lower quartile speaks for images that stand alone; chance makes it `QUARTILE` of the mean.
    """
    if not len(rest):
        return 0.0
    added = (np.square(rest) / QUARTILE - noise**2) / model.mean(axis=1)
    return max(float(np.percentile(added, 25.0)), 0.0)


def _slopes(height: Floats, place: Floats, width: Floats) -> tuple[Floats, Floats]:
    """Derivatives (N, 25, 4) of the Gaussian by height, place and width, and its values (N, 25)."""
    x, y = ACROSS - place[:, :1], DOWN - place[:, 1:]
    square, wide = x**2 + y**2, width[:, None]
    shape = np.exp(-0.5 * square / wide**2)
    model = height[:, None] * shape
    slopes = np.stack([shape, model * x / wide**2, model * y / wide**2, model * square / wide**3], axis=-1)
    return slopes, model
