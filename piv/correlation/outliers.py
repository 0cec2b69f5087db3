"""Outlier detection: vectors that contradict their neighbours.

Universal outlier detection (Westerweel, Scarano, Exp. Fluids 39, 1096 (2005)): a vector is compared with the
median of its 5 x 5 neighbourhood, in units of the median deviation of those neighbours plus the usual noise
epsilon = 0.1 px; beyond 2 it is rejected.  At an edge all neighbours lie on one side, and any gradient looks
like an outlier.  So a second round judges the rejected vectors and their neighbours anew: without the rejected
ones as witnesses, and after the trend of the accepted vectors has been taken off.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.kernels.median import median_residual
from piv.correlation.planes import FILL_SIGMA, smooth_field

RADIUS = 2  # 5 x 5 neighbourhood
MIN_NEIGHBOURS = 5  # fewer do not make a median worth the name


def outliers(
    field: NDArray[np.float64],
    candidates: NDArray[np.bool_],
    threshold: float,
    epsilon_px: float,
    threads: int | None = None,
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
    threads : int, optional
        Threads to use; by default `ground.rows.thread_count`.

    Returns
    -------
    ndarray of bool, shape (ny, nx)
        Rejected vectors.  A vector with fewer than five neighbours is not rejected.
    """
    rejected: NDArray[np.bool_] = candidates & (
        _residual(field, candidates, candidates, epsilon_px, threshold, threads) > threshold
    )
    accepted = candidates & ~rejected
    if not rejected.any() or not accepted.any():
        return rejected
    side = 2 * RADIUS + 1
    judged: NDArray[np.bool_] = candidates & scipy.ndimage.binary_dilation(rejected, np.ones((side, side), bool))
    trend = smooth_field(field, accepted, FILL_SIGMA)
    judged &= _residual(field - trend, accepted, judged, epsilon_px, threshold, threads) > threshold
    return judged


def _residual(
    field: NDArray[np.float64],
    usable: NDArray[np.bool_],
    judged: NDArray[np.bool_],
    epsilon_px: float,
    threshold: float,
    threads: int | None,
) -> NDArray[np.float64]:
    """Normalised median residual of the judged vectors (ny, nx), exact where it may exceed `threshold`.

    NaN elsewhere or without neighbours; 0 where all neighbours lie so near that it cannot.
    """
    near = threshold * epsilon_px
    residual = np.full(usable.shape, np.nan)
    field = np.ascontiguousarray(field)  # a kernel is compiled once more for slices
    usable, judged = np.ascontiguousarray(usable), np.ascontiguousarray(judged)

    def rows(first: int, last: int) -> None:
        work = np.empty((2 * RADIUS + 1) ** 2)
        median_residual(
            field, usable, judged, RADIUS, epsilon_px, near, MIN_NEIGHBOURS, first, last, work, residual
        )

    run_rows(rows, len(field), threads=threads)
    return residual
