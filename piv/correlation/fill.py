"""Filling of masked pixels, and its uncertainty.

**Regions** take a blur of what is valid around them, so that the spline through the frame makes no step
there; they weigh nothing afterwards.

**Single dead pixels** among valid ones are another matter: without them four of five pixels are left, but only
two of five products of neighbours in both frames, and windows full of gaps are noisier than the loss accounts for
(20 % scattered: 3.6 times the error). What a missing pixel shows can be guessed from its neighbours, because
particle images are wider than a pixel. A picture of particle images of variance s^2 correlates over r as
exp(-r^2/(4 s^2)); with the noise beside it the best linear guess and the variance e of its error follow from one
small system of equations a pixel (simple kriging; the same for both frames). What is so filled weighs less where
both frames meet (`piv.correlation.deform`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.kernels.kriging import krige

FILL_BLUR_PX = 1.0  # standard deviation of the weights that fill regions
# By these weights so much around a hole is valid
FILL_AROUND_PX = 2.0
HOLE = 0.5
NEAR_PX2 = 10  # squared distance of the neighbours that a hole learns from
LEAST_NOISE = 0.007  # of the picture's variance: what sampling alone makes of particle images

Floats = NDArray[np.float32]
NEAR = np.array(
    [(j, i) for j in range(-3, 4) for i in range(-3, 4) if 0 < j * j + i * i <= NEAR_PX2], dtype=np.int64
)


class Texture(NamedTuple):
    """Texture of a frame: variance of a particle image [px^2], and of a pixel's noise over the picture's."""

    spread_px2: float
    noise: float


class FilledPixels(NamedTuple):
    """Variance (H, W) of what single pixels were filled with, 0 elsewhere, and of noise; over the picture's."""

    variance: Floats
    noise: float


def without_gaps(a: Floats, b: Floats, seen: NDArray[np.bool_], texture: Texture) -> FilledPixels | None:
    """Fill both levelled frames in place where they are not seen.

    Parameters
    ----------
    a, b : ndarray of float32, shape (H, W)
        Levelled frames.
    seen : ndarray of bool, shape (H, W)
        Pixels to learn from.
    texture : Texture
        What frames look like.

    Returns
    -------
    FilledPixels, optional
        How unsure what stands in single pixels is; None if there are none.
    """
    weight = seen.astype(np.float32)
    missing = ~seen
    # NumPy gives Fortran order but for a single row, and the kernel would be compiled for both orders
    holes = np.ascontiguousarray(
        np.argwhere(missing & ~_region(missing) & (blur_frame(weight, FILL_AROUND_PX) > HOLE))
    )
    filled = np.empty((len(holes), 3))
    alike = np.exp(-np.square(np.arange(8.0)) / (4.0 * texture.spread_px2))

    def guess(first: int, last: int) -> None:
        count = len(NEAR)
        scratch = np.empty((count, 2), np.int64), np.empty((count, count)), np.empty(count)
        krige(a, b, seen, holes, NEAR, alike, texture.noise, *scratch, first, last, filled)

    run_rows(guess, len(holes))
    share = np.maximum(blur_frame(weight, FILL_BLUR_PX), np.float32(0.05))[missing]
    for frame in (a, b):
        frame[missing] = blur_frame(frame * weight, FILL_BLUR_PX)[missing] / share
    if not len(holes):
        return None
    at = tuple(holes.T)
    a[at], b[at] = filled[:, 0], filled[:, 1]
    variance = np.zeros(a.shape, np.float32)
    variance[at] = filled[:, 2]
    return FilledPixels(variance, max(texture.noise, LEAST_NOISE))


def _region(missing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) within and beside what is missing over 3 x 3 px and more, whose edge may be ragged."""
    import cv2

    square = np.ones((3, 3), np.uint8)
    region = cv2.morphologyEx(missing.view(np.uint8), cv2.MORPH_OPEN, square)
    region = cv2.dilate(region, square, iterations=2)
    return np.asarray(region > 0)


def blur_frame(frame: Floats, sigma_px: float) -> Floats:
    """Frame under a Gaussian of standard deviation `sigma_px`."""
    import cv2

    return np.asarray(cv2.GaussianBlur(frame, (0, 0), sigma_px), np.float32)
