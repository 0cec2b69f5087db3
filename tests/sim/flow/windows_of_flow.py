"""A known flow as a window measures it: averages over its area and across the sheet.

A vector is, at best, the mean of the velocity over the window's area, weighted across the sheet by what both
pulses light: a particle counts by the product of its light in A and B, so exp(-16 z^2/w^2), narrower than the
sheet itself. The mean of many vectors is that average of the mean; their variance is that of the averaged
fluctuation, less than the stress itself where the turbulence is finer than the window.
"""

import numpy as np
from numpy.polynomial.hermite import hermgauss
from numpy.typing import NDArray

from sim.flow.fields import Flow
from sim.flow.modes import RandomModes
from sim.flow.particles import LightSheet

Float64 = NDArray[np.float64]

ACROSS = 8  # places along each edge of a window
DEEP = 5  # Gauss-Hermite nodes across the sheet
BLOCK_WINDOWS = 256


def window_places(window_mm: float, sheet: LightSheet, weight_sigma_mm: float = 0.0) -> tuple[Float64, Float64]:
    """Places (S, 3) within a window about its middle, and their weights (S,), which add up to 1.

    Parameters
    ----------
    window_mm : float
        Edge of the window.
    sheet : LightSheet
        Whose depth is averaged over.
    weight_sigma_mm : float
        Of Gaussian windows; 0 counts all places of the window alike.
    """
    along = (np.arange(ACROSS) + 0.5) / ACROSS * window_mm - 0.5 * window_mm
    nodes, depth_weights = hermgauss(DEEP)
    z = sheet.offset_mm + nodes * sheet.thickness_mm / 4.0
    flat = np.exp(-0.5 * np.square(along / weight_sigma_mm)) if weight_sigma_mm > 0.0 else np.ones(ACROSS)
    x, y, deep = np.meshgrid(along, along, z, indexing="ij")
    weights = flat[:, None, None] * flat[None, :, None] * depth_weights[None, None, :]
    return np.column_stack((x.ravel(), y.ravel(), deep.ravel())), (weights / weights.sum()).ravel()


def window_mean(flow: Flow, points_mm: Float64, places_mm: Float64, weights: Float64) -> Float64:
    """Mean velocity (N, 3) [mm/s] over windows about points (N, 3) on the plane."""
    at = (points_mm[:, None, :] + places_mm[None, :, :]).reshape(-1, 3)
    values = flow.mean(at).reshape(len(points_mm), len(places_mm), 3)
    return np.asarray(np.einsum("s,nsi->ni", weights, values))


def window_stresses(flow: Flow, points_mm: Float64, places_mm: Float64, weights: Float64) -> Float64:
    """Covariance (N, 3, 3) [mm^2/s^2] of the velocity averaged over windows about points (N, 3)."""
    if flow.modes is None:
        return np.zeros((len(points_mm), 3, 3))
    out = np.empty((len(points_mm), 3, 3))
    for first in range(0, len(points_mm), BLOCK_WINDOWS):
        part = points_mm[first : first + BLOCK_WINDOWS]
        at = (part[:, None, :] + places_mm[None, :, :]).reshape(-1, 3)
        strengths = flow.base.amplitude(at).reshape(len(part), len(places_mm), 3, 3)
        out[first : first + BLOCK_WINDOWS] = mean_covariance(flow.modes, places_mm, weights, strengths)
    return out


def mean_covariance(modes: RandomModes, offsets_mm: Float64, weights: Float64, amplitudes: Float64) -> Float64:
    """Covariance (N, 3, 3) of weighted sums of A q: what a window of that shape and strength A still sees.

    Parameters
    ----------
    modes : RandomModes
        The fluctuations.
    offsets_mm : ndarray
        Places (S, 3) in the window.
    weights : ndarray
        (S,), their sum is 1.
    amplitudes : ndarray
        A (N, S, 3, 3) at those places of N windows; an N of 1 will do where A is the same everywhere.
    """
    waves, _, _, a, b = modes._modes
    angle = offsets_mm @ waves.T  # (S, M)
    # A mode seen from a window: (a - i b) exp(i(angle + phase)), whose phase is drawn evenly.
    rotating = weights[:, None] * np.exp(1j * angle)
    out = np.zeros((len(amplitudes), 3, 3))
    for m in range(len(waves)):
        seen = np.einsum("s,nsij,j->ni", rotating[:, m], amplitudes, a[m] - 1j * b[m])
        out += 0.5 * np.real(seen[:, :, None] * np.conj(seen[:, None, :]))
    return out
