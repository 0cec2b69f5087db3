"""Which vectors do not belong to their neighbourhood, and what stands there instead.

Universal outlier detection (Westerweel, Scarano, Exp. Fluids 39, 1096 (2005)): a vector is compared with the
median of its 5 x 5 neighbourhood, in units of the median deviation of those neighbours plus the usual noise
epsilon = 0.1 px; beyond 2 it is rejected.  At an edge all neighbours lie on one side, and any gradient looks
like an outlier.  So a second round judges the rejected vectors and their neighbours anew: without the rejected
ones as witnesses, and after the trend of the accepted vectors has been taken off.

Gaps are filled by a plane through the valid neighbours, weighted by a Gaussian of their distance: unlike a
mean or a median it continues gradients, also out of the valid area, where one-sided neighbours would otherwise
shift it.  All moments of the fit are Gaussian convolutions.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.kernels.median import normalised_residual

RADIUS = 2  # 5 x 5 neighbourhood
MIN_NEIGHBOURS = 5  # fewer do not make a median worth the name
FILL_SIGMA = 1.5  # grid steps; the fit sees neighbours up to 6 steps away


def outliers(
    field: NDArray[np.float64], candidates: NDArray[np.bool_], threshold: float, epsilon_px: float
) -> NDArray[np.bool_]:
    """Find vectors that contradict their neighbours.

    Parameters
    ----------
    field : ndarray of float64, shape (ny, nx, 2)
        Displacements [px].
    candidates : ndarray of bool, shape (ny, nx)
        Vectors that were measured; only these are judged and used.
    threshold : float
        Largest accepted normalised residual.
    epsilon_px : float
        Usual noise [px].

    Returns
    -------
    ndarray of bool, shape (ny, nx)
        Rejected vectors.  A vector with fewer than five neighbours is not rejected.
    """
    rejected: NDArray[np.bool_] = candidates & (
        _residual(field, candidates, candidates, epsilon_px, threshold) > threshold
    )
    accepted = candidates & ~rejected
    if not rejected.any() or not accepted.any():
        return rejected
    side = 2 * RADIUS + 1
    judged: NDArray[np.bool_] = candidates & scipy.ndimage.binary_dilation(rejected, np.ones((side, side), bool))
    trend = smoothed(field, accepted, FILL_SIGMA)
    judged &= _residual(field - trend, accepted, judged, epsilon_px, threshold) > threshold
    return judged


def _residual(
    field: NDArray[np.float64],
    usable: NDArray[np.bool_],
    judged: NDArray[np.bool_],
    epsilon_px: float,
    threshold: float,
) -> NDArray[np.float64]:
    """Normalised median residual of the judged vectors (ny, nx), exact where it may exceed `threshold`.

    NaN elsewhere or without neighbours; 0 where all neighbours lie so near that it cannot.
    """
    near = threshold * epsilon_px
    residual, work = np.full(usable.shape, np.nan), np.empty((2 * RADIUS + 1) ** 2)
    normalised_residual(
        field, usable, judged, RADIUS, epsilon_px, near, MIN_NEIGHBOURS, 0, len(field), work, residual
    )
    return residual


def filled(field: NDArray[np.float64], valid: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Put the plane through valid neighbours wherever a vector is not valid.

    Parameters
    ----------
    field : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], anything where not valid.
    valid : ndarray of bool, shape (ny, nx)
        Vectors to keep and to learn from; at least one.

    Returns
    -------
    ndarray of float64, shape (ny, nx, 2)
        The field; valid vectors unchanged.  Far from any valid vector it takes the nearest value.
    ndarray of bool, shape (ny, nx)
        Vectors with at least three valid ones among their 5 x 5 neighbours: near enough to be interpolated.
    """
    if valid.all():
        return field, valid
    weight = valid.astype(float)
    near = scipy.ndimage.convolve(weight, np.ones((5, 5)), mode="constant") >= 3
    values = np.where(valid[..., None], field, 0.0)
    plane, supported = _weighted_plane(values, weight, FILL_SIGMA, 1e-3)
    fill = np.where(valid[..., None], field, plane)
    known = valid | supported
    if not known.all():
        nearest: Any = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        fill = fill[nearest[0], nearest[1]]
    return fill, near


def _weighted_plane(
    values: NDArray[np.float64], weight: NDArray[np.float64], sigma_steps: float, least: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Gaussian-weighted plane fit around every node, and where the weight around exceeds `least`."""
    ny, nx = weight.shape
    y, x = np.mgrid[0.0:ny, 0.0:nx]

    def moment(quantity: NDArray[np.float64]) -> NDArray[np.float64]:
        blurred: NDArray[np.float64] = scipy.ndimage.gaussian_filter(
            weight * quantity, sigma_steps, mode="constant"
        )
        return blurred

    one = np.ones_like(weight)
    w = moment(one)
    supported = w > least
    w = np.where(supported, w, 1.0)
    mx, my = moment(x) / w, moment(y) / w
    # A small ridge keeps slopes finite where neighbours stand in one line.
    xx = moment(x * x) / w - mx * mx + 0.02
    yy = moment(y * y) / w - my * my + 0.02
    xy = moment(x * y) / w - mx * my
    determinant = xx * yy - xy * xy
    plane = np.empty_like(values)
    for axis in range(2):
        f = values[..., axis]
        mf = moment(f) / w
        xf, yf = moment(x * f) / w - mx * mf, moment(y * f) / w - my * mf
        slope_x = (yy * xf - xy * yf) / determinant
        slope_y = (xx * yf - xy * xf) / determinant
        plane[..., axis] = mf + slope_x * (x - mx) + slope_y * (y - my)
    return plane, supported


def smoothed(
    field: NDArray[np.float64],
    valid: NDArray[np.bool_],
    sigma_steps: float,
    order: int = 1,
    trust: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Field of the valid vectors, smoothed over `sigma_steps` nodes and continued where there are none.

    A local plane again: inside it is plain Gaussian smoothing, at edges it still follows gradients.

    Parameters
    ----------
    field : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], anything where not valid.
    valid : ndarray of bool, shape (ny, nx)
        At least one is True.
    sigma_steps : float
        Standard deviation of the Gaussian in grid steps; 0 fills only.
    order : int
        How often what the smoothing has left out is smoothed and added: long waves then pass whole, and the
        step from those that pass to those that do not is steeper.
    trust : ndarray of float64, shape (ny, nx), optional
        Weights of the valid vectors, about 1; default all 1.

    Returns
    -------
    ndarray of float64, shape (ny, nx, 2)
        Finite everywhere.
    """
    fill, _ = filled(field, valid)
    if sigma_steps <= 0.0 or min(valid.shape) < 2:
        return fill
    result, rest = np.zeros_like(fill), np.where(valid[..., None], field, 0.0)
    weight = valid.astype(float) if trust is None else np.where(valid, trust, 0.0)
    for _ in range(order):
        plane, supported = _weighted_plane(rest, weight, sigma_steps, 0.02)
        result += plane
        rest = np.where(valid[..., None], rest - plane, 0.0)
    return np.where(supported[..., None], result, fill)
