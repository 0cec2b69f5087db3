"""Figures of merit of a particle image: density, particle diameter, contrast, saturation.

Diameter and signal to noise come from the autocorrelation R of the frame.  A Gaussian particle image of e^-2
diameter d has sigma = d/4, its autocorrelation sqrt(2) times that, so with the lags of 1 and 2 px

    sigma_ac^2 = 3 / (2 ln(R(1)/R(2))),      d = 4 sigma_ac / sqrt(2),
    signal variance = R(1) (R(1)/R(2))^(1/3)     (the Gaussian, continued to lag 0),

while pixel noise sits at lag 0 alone: noise variance = R(0) - signal variance.  A recorded particle is wider
than its optical image, d^2 + 16/12 px^2, since a pixel integrates over its area.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.errors import FrameError
from piv.resampling.sample import checked_frame

BINS = 256
DETECTION = 5.0  # noise standard deviations above the background


@dataclass(frozen=True)
class ImageFigures:
    """Figures of one frame.

    Parameters
    ----------
    particles_per_px : float
        Detected particle images per valid pixel; images that touch count as one.
    diameter_u_px, diameter_v_px : float
        e^-2 diameter along u and v; NaN where the autocorrelation does not fall.
    signal_to_noise : float
        Standard deviation of the particle signal over that of the pixel noise; inf without noise.
    background, noise : float
        Median intensity, and standard deviation of the pixel noise [counts].
    saturated : float
        Share of valid pixels at or above full scale.
    histogram, edges : ndarray, shapes (256,), (257,)
        Number of valid pixels by intensity from 0 to full scale, and the limits of the bins [counts].
    valid_pixels, nan_pixels : int
        Pixels used; pixels that the mask called valid but which are NaN or infinite, and left out.
    """

    particles_per_px: float
    diameter_u_px: float
    diameter_v_px: float
    signal_to_noise: float
    background: float
    noise: float
    saturated: float
    histogram: NDArray[np.int64]
    edges: NDArray[np.float64]
    valid_pixels: int
    nan_pixels: int


def image_figures(frame: NDArray[Any], full_scale: float, valid: NDArray[np.bool_] | None = None) -> ImageFigures:
    """Evaluate one particle image.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        uint8, uint16 or float32 intensities [counts].
    full_scale : float
        Intensity of a saturated pixel [counts], 4095 for 12 bit; a uint16 frame does not tell.
    valid : ndarray of bool, shape (H, W), optional
        True where the frame shows particles.

    Raises
    ------
    FrameError
        No frame, a mask of another shape, no valid pixel, a constant frame, or a full scale that is none.
    """
    frame = checked_frame(frame)
    if not full_scale > 0:
        raise FrameError(f"full_scale is the intensity of a saturated pixel, not {full_scale}")
    if valid is None:
        valid = np.ones(frame.shape, bool)
    if valid.shape != frame.shape or valid.dtype != np.bool_:
        raise FrameError(f"the mask is {valid.dtype} {valid.shape}; pass bool {frame.shape}, True where valid")
    finite = np.isfinite(frame)
    usable = valid & finite
    if not usable.any():
        raise FrameError("no pixel is valid; check the mask (True = valid) and the frame for NaN")
    values = frame[usable].astype(np.float64)
    if values.min() == values.max():
        raise FrameError(f"the frame is constant ({values[0]:g}) over its valid pixels; it shows no particles")
    background = float(np.median(values))
    level = np.where(usable, frame.astype(np.float64) - values.mean(), 0.0)
    # Noise differs from pixel to pixel, so it adds to the autocorrelation at no shift alone.
    zero = float((level**2).sum() / usable.sum())
    along_u, along_v = _gaussian_fit(level, usable, 1), _gaussian_fit(level, usable, 0)
    signal = float(np.mean([along_u[1], along_v[1]]))
    noise = float(np.sqrt(max(0.0, zero - signal))) if np.isfinite(signal) else float("nan")
    histogram, edges = np.histogram(values, BINS, (0.0, float(full_scale)))
    return ImageFigures(
        particles_per_px=_particles(frame, usable, background, noise) / int(usable.sum()),
        diameter_u_px=along_u[0],
        diameter_v_px=along_v[0],
        signal_to_noise=float(np.sqrt(signal)) / noise if noise != 0.0 else float("inf"),
        background=background,
        noise=noise,
        saturated=float((values >= full_scale).mean()),
        histogram=histogram.astype(np.int64),
        edges=edges,
        valid_pixels=int(usable.sum()),
        nan_pixels=int(np.count_nonzero(valid & ~finite)),
    )


def _gaussian_fit(level: NDArray[np.float64], usable: NDArray[np.bool_], axis: int) -> tuple[float, float]:
    """Particle diameter [px] and signal variance from the autocorrelation at lags 1 and 2 along an axis."""
    level, usable = np.moveaxis(level, axis, 0), np.moveaxis(usable, axis, 0)
    correlation: list[float] = []
    for lag in (1, 2):
        shared = int(np.count_nonzero(usable[lag:] & usable[:-lag]))
        correlation.append(float((level[lag:] * level[:-lag]).sum()) / max(shared, 1))
    one, two = correlation
    if not one > two > 0.0:
        return float("nan"), float("nan")
    sigma = np.sqrt(1.5 / np.log(one / two))
    return float(4.0 * sigma / np.sqrt(2.0)), float(one * (one / two) ** (1 / 3))


def _particles(frame: NDArray[Any], usable: NDArray[np.bool_], background: float, noise: float) -> int:
    """Number of local maxima that rise out of the noise, after a light smoothing that hides its own maxima."""
    import cv2

    smooth = scipy.ndimage.gaussian_filter(np.where(usable, frame, background).astype(np.float64), 0.7)
    threshold = background + DETECTION * (noise if np.isfinite(noise) else 0.0)
    peak = (smooth == cv2.dilate(smooth, np.ones((3, 3), np.uint8))) & (smooth > threshold) & usable
    _, count = scipy.ndimage.label(peak, np.ones((3, 3)))  # neighbours of equal height are one particle
    return int(count)
