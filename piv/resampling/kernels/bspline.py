"""Exact resampling at any position: quintic B-spline and bilinear, with float weights.

    f(u, v) = sum_j sum_i beta5(v - j) beta5(u - i) c[j, i],     c from ``piv.resampling.kernels.prefilter``

beta5 is the B-spline of fifth degree: 6 x 6 coefficients around the position count.  The frame continues by
mirroring at its outermost pixel centres.

Interpolation of a particle image of 3 px diameter by this spline moves its centroid by 0.0003 px rms;
positions rounded to 1/32 px, as common remapping routines do, would cost 0.01 px.
"""

import numpy as np

from ground.jit import Array, kernel
from piv.resampling.kernels.lanes import WIDE, footprint_sum
from piv.resampling.kernels.prefilter import mirrored

NON_NEGATIVE = 0x7FFFFFFF  # i & NON_NEGATIVE tells the compiler that i >= 0: no test for negative indices
_BEHIND = WIDE - 3  # columns from a position's pixel on that a row of its footprint is read over
_NAN = np.float32(np.nan)
_ONE = np.float32(1.0)
_C1 = np.float32(1 / 120)
_C5 = np.float32(5 / 120)
_C10 = np.float32(10 / 120)
_C20 = np.float32(20 / 120)
_C26 = np.float32(26 / 120)
_C30 = np.float32(30 / 120)
_C50 = np.float32(50 / 120)
_C60 = np.float32(60 / 120)
_C66 = np.float32(66 / 120)


@kernel
def bilinear_at(image: Array, u: float, v: float) -> np.float32:
    """Bilinear value of image (H, W) at the pixel position (u, v); NaN outside the pixel centres."""
    height, width = image.shape
    if not (u >= 0.0 and v >= 0.0 and u <= width - 1.0 and v <= height - 1.0):
        return _NAN
    i = min(int(u), width - 2) & NON_NEGATIVE
    j = min(int(v), height - 2) & NON_NEGATIVE
    s = np.float32(u - i)
    t = np.float32(v - j)
    above = np.float32(image[j, i]) * (_ONE - s) + np.float32(image[j, i + 1]) * s
    below = np.float32(image[j + 1, i]) * (_ONE - s) + np.float32(image[j + 1, i + 1]) * s
    return above * (_ONE - t) + below * t


@kernel
def weight_outer(t: np.float32) -> np.float32:
    """beta5(2 + t) for 0 <= t <= 1."""
    s = _ONE - t
    return s * s * s * s * s * _C1


@kernel
def weight_middle(t: np.float32) -> np.float32:
    """beta5(1 + t) for 0 <= t <= 1."""
    return _C26 + t * (-_C50 + t * (_C20 + t * (_C20 + t * (-_C20 + t * _C5))))


@kernel
def weight_inner(t: np.float32) -> np.float32:
    """beta5(t) for 0 <= t <= 1."""
    q = t * t
    return _C66 + q * (-_C60 + q * (_C30 - _C10 * t))


@kernel
def quintic_border(coefficients: Array, i: int, j: int, s: np.float32, t: np.float32) -> np.float32:
    """Spline value at (i + s, j + t) where the coefficients continue mirrored beyond the frame."""
    height, width = coefficients.shape
    s1, t1 = _ONE - s, _ONE - t
    y = (weight_outer(t), weight_middle(t), weight_inner(t), weight_inner(t1), weight_middle(t1), weight_outer(t1))
    x = (weight_outer(s), weight_middle(s), weight_inner(s), weight_inner(s1), weight_middle(s1), weight_outer(s1))
    value = np.float32(0.0)
    for n in range(6):
        row = mirrored(j - 2 + n, height)
        line = np.float32(0.0)
        for m in range(6):
            line += x[m] * coefficients[row, mirrored(i - 2 + m, width)]
        value += y[n] * line
    return value


@kernel
def quintic_at(coefficients: Array, u: float, v: float) -> np.float32:
    """Quintic B-spline value at the pixel position (u, v) from coefficients (H, W) float32.

    Positions are float64, weights exact to float32; NaN outside the outermost pixel centres.
    """
    height, width = coefficients.shape
    if not (u >= 0.0 and v >= 0.0 and u <= width - 1.0 and v <= height - 1.0):
        return _NAN
    i, j = int(u), int(v)
    s, t = np.float32(u - i), np.float32(v - j)
    if not (i >= 2 and j >= 2 and i < width - _BEHIND and j < height - 3):
        return quintic_border(coefficients, i, j, s, t)
    t1, flat = _ONE - t, coefficients.reshape(height * width)
    y0, y1, y2 = weight_outer(t), weight_middle(t), weight_inner(t)
    y3, y4, y5 = weight_inner(t1), weight_middle(t1), weight_outer(t1)
    return footprint_sum(flat, (j - 2) * width + i - 2, width, s, (y0, y1, y2, y3, y4, y5))


@kernel
def sample_bilinear(image: Array, positions: Array, first: int, last: int, out: Array) -> None:
    """out[k] = bilinear value at positions[k] = (u, v), for first <= k < last; positions (N, 2) float64."""
    for k in range(first, last):
        out[k] = bilinear_at(image, positions[k, 0], positions[k, 1])


@kernel
def sample_quintic(coefficients: Array, positions: Array, first: int, last: int, out: Array) -> None:
    """out[k] = spline value at positions[k] = (u, v), for first <= k < last; positions (N, 2) float64."""
    for k in range(first, last):
        out[k] = quintic_at(coefficients, positions[k, 0], positions[k, 1])
