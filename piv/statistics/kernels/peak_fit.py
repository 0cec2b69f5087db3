"""Least squares of a Gaussian on a pedestal through a correlation peak.

    G(s) = A exp(-1/2 (s - m)^T P (s - m)) + c,      p = (A, m_u, m_v, P_uu, P_vv, P_uv, c),

by Levenberg and Marquardt's steps. P is the inverse of the peak's covariance. All displacements weigh alike: the
noise of a plane is the same everywhere.
"""

import numpy as np

from ground.jit import Array, kernel
from ground.kernels.cholesky import factorise, solve

PARAMETERS = 7
MAX_FIT_STEPS = 60
ENOUGH = 1e-5  # px and relative change after which a fit is done


@kernel
def gaussian(p: Array, x: float, y: float, slope: Array) -> float:
    """Value of the model at x, y, and its derivatives (7,) by the parameters."""
    dx, dy = x - p[1], y - p[2]
    g = np.exp(-0.5 * (p[3] * dx * dx + p[4] * dy * dy) - p[5] * dx * dy)
    slope[0] = g
    slope[1] = p[0] * g * (p[3] * dx + p[5] * dy)
    slope[2] = p[0] * g * (p[4] * dy + p[5] * dx)
    slope[3] = -0.5 * p[0] * g * dx * dx
    slope[4] = -0.5 * p[0] * g * dy * dy
    slope[5] = -p[0] * g * dx * dy
    slope[6] = 1.0
    return p[0] * g + p[6]  # type: ignore[no-any-return]


@kernel
def misfit(p: Array, plane: Array, lags: Array, slope: Array) -> float:
    """Sum of squared residuals."""
    total = 0.0
    for n in range(plane.size):
        rest = plane[n] - gaussian(p, lags[n, 1], lags[n, 0], slope)
        total += rest * rest
    return total


@kernel
def fit_peak(plane: Array, lags: Array, free: Array, work: Array, p: Array) -> bool:
    """Fit from the start values in p (7,) float64; False where no peak was found.

    plane (L,) and lags (L, 2) float64; free (7,) bool, parameters that may change; work (20, 7) float64 scratch.
    """
    normal, lower, slope, right, step, trial = work[:7], work[7:14], work[14], work[15], work[16], work[17]
    damping = 1e-3
    best = misfit(p, plane, lags, slope)
    for _ in range(MAX_FIT_STEPS):
        for k in range(PARAMETERS):
            right[k] = 0.0
            for m in range(PARAMETERS):
                normal[k, m] = 0.0
        for n in range(plane.size):
            rest = plane[n] - gaussian(p, lags[n, 1], lags[n, 0], slope)
            for k in range(PARAMETERS):
                if free[k]:
                    right[k] += slope[k] * rest
                    for m in range(k + 1):
                        normal[k, m] += slope[k] * slope[m]
        for k in range(PARAMETERS):
            for m in range(k + 1):
                if not (free[k] and free[m]):
                    normal[k, m] = 1.0 if k == m else 0.0
        moved = False
        while damping < 1e8:
            if factorise(normal, damping, lower):
                solve(lower, right, step)
                for k in range(PARAMETERS):
                    trial[k] = p[k] + (step[k] if free[k] else 0.0)
                if trial[0] > 0.0 and trial[3] > 0.0 and trial[4] > 0.0 and trial[3] * trial[4] > trial[5] ** 2:
                    value = misfit(trial, plane, lags, slope)
                    if value <= best:
                        moved = True
                        break
            damping *= 4.0
        if not moved:
            break
        damping = max(damping * 0.2, 1e-9)
        best = value
        change = abs(step[1]) + abs(step[2])
        change += (abs(step[3]) + abs(step[4]) + abs(step[5])) / (p[3] + p[4]) + abs(step[0]) / p[0]
        for k in range(PARAMETERS):
            p[k] = trial[k]
        if change < ENOUGH:
            return True
    return bool(best == best) and damping >= 1e8


@kernel
def start_values(plane: Array, lags: Array, variance: float, p: Array) -> bool:
    """Start p (7,) from the highest value near the plane's middle and a round peak; False if there is none."""
    reach = 0.0
    low, high, at = np.inf, -np.inf, 0
    for n in range(plane.size):
        reach = max(reach, abs(lags[n, 0]))
    for n in range(plane.size):
        low = min(low, plane[n])
        inner = max(abs(lags[n, 0]), abs(lags[n, 1])) <= 0.6 * reach
        if inner and plane[n] > high:
            high, at = plane[n], n
    if not high > max(low, 0.0):
        return False
    p[0], p[1], p[2] = high, lags[at, 1], lags[at, 0]
    p[3], p[4], p[5], p[6] = 1.0 / variance, 1.0 / variance, 0.0, 0.0
    return True


@kernel
def template_slopes(p: Array, lags: Array, variance: float, slope: Array, out: Array) -> None:
    """Derivatives of the sums over `templates` by the parameters: out (7, 7) float64."""
    for k in range(PARAMETERS):
        for m in range(PARAMETERS):
            out[k, m] = 0.0
    for n in range(lags.shape[0]):
        x, y = lags[n, 1], lags[n, 0]
        gaussian(p, x, y, slope)
        g = np.exp(-0.5 * (x * x + y * y) / variance)
        for m in range(PARAMETERS):
            out[0, m] += g * slope[m]
            out[1, m] += x * g * slope[m]
            out[2, m] += y * g * slope[m]
            out[3, m] += x * x * g * slope[m]
            out[4, m] += y * y * g * slope[m]
            out[5, m] += x * y * g * slope[m]
            out[6, m] += slope[m]


@kernel
def fit_row(
    planes: Array,
    lags: Array,
    free: Array,
    variance: Array,
    work: Array,
    plane: Array,
    fits: Array,
    slopes: Array,
) -> None:
    """Fit a row of windows.

    planes (L, n) float64; lags (L, 2) float64; free (7,) bool: without its place free, the peak stands at no
    displacement (autocorrelation); variance (n,) float64, of a round peak to start from; work (20, 7) and plane
    (L,) float64 scratch; fits (n, 7) float64 becomes the parameters, NaN where there is no peak; slopes (n, 7, 7)
    float64 those of `template_slopes`.
    """
    for i in range(fits.shape[0]):
        for n in range(plane.size):
            plane[n] = planes[n, i]
        found = start_values(plane, lags, variance[i], fits[i])
        if found and not free[1]:
            fits[i, 1] = 0.0
            fits[i, 2] = 0.0
        found = found and fit_peak(plane, lags, free, work, fits[i])
        if found:
            template_slopes(fits[i], lags, variance[i], work[14], slopes[i])
        else:
            fits[i] = np.nan
            slopes[i] = np.nan
