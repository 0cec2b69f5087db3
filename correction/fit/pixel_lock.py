"""The lock of edges on the rows of pixels, found from the frames themselves and taken off.

A pixel sums the light over its square, which no smooth edge model knows exactly.  An edge that runs along a row
is then drawn by an error that repeats with its place in the pixel (peak locking, as particle images have it):

    e = sum over m of  (a_m sin 2 pi m u + b_m cos 2 pi m u) sinc(m L),        m = 1, 2,

u the place of the corner, L how far [px] the edge leans over the arms of the window: edges that cross pixels mean
it away.  On a sharp frame a_1 is 0.02-0.1 px, several times what noise leaves, and alike in neighbouring corners.
Its terms are found together with the scene, apart for u and v and beside and behind glass, each believed to be
LOCK_PX at most or so.  With S the terms in sigmas and J the derivatives of the residuals r by the free vector x,

    (x step, c) = -(G^T G + P)^-1 (G^T r + P (x, c)),        G = (J, -S),

and the information on x is what is left of the whole when c is unknown (Schur's complement).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LOCK_PX = 0.03
HARMONICS = (1, 2)
TERMS = 4 * len(HARMONICS)
ARMS = 0.84  # length of an edge in a window, squares


def lock_terms(
    pixel: NDArray[np.float64], axes_px: NDArray[np.float64], behind: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Pull (N, 2, 2 TERMS) of corners by a unit of every term, those beside glass first.

    Parameters
    ----------
    pixel : (N, 2) float64
        u, v.
    axes_px : (N, 2, 2) float64
        Columns: displacement by one square along the board's +x and +y.
    behind : (N,) bool
        Seen through glass.
    """
    out = np.zeros((len(pixel), 2, 2 * TERMS))
    for axis in range(2):  # u is held by the edge that runs more along v, and the other way round
        along, across = np.abs(axes_px[:, 1 - axis]), np.abs(axes_px[:, axis])
        edge = np.argmin(across / np.maximum(along, 1e-9), axis=1)
        lean = ARMS * np.take_along_axis(across, edge[:, None], 1)[:, 0]
        for number, m in enumerate(HARMONICS):
            turn, first = 2.0 * np.pi * m * pixel[:, axis], TERMS // 2 * axis + 2 * number
            for term, wave in enumerate((np.sin(turn), np.cos(turn))):
                out[:, axis, first + term] = np.sinc(m * lean) * wave
    return np.concatenate((out[..., :TERMS] * ~behind[:, None, None], out[..., :TERMS] * behind[:, None, None]), 2)


@dataclass(frozen=True)
class LockedCorners:
    """Corners of one frame for the search for the lock.

    Parameters
    ----------
    terms : (N, 2, 2 TERMS) float64
        `lock_terms`, in sigmas.
    value : (N, 2) float64
        Residuals in sigmas, the terms found so far taken off; corners that are not asked are 0.
    rate : (N, 2, P) float64
        Their derivatives by the free vector; 0 as well.
    """

    terms: NDArray[np.float64]
    value: NDArray[np.float64]
    rate: NDArray[np.float64]


def better_lock(
    lock: NDArray[np.float64], x: NDArray[np.float64], frames: Sequence[LockedCorners]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the terms anew, together with a step of the free vector that others will take.

    Parameters
    ----------
    lock : (2 TERMS,) float64
        Terms so far [px].
    x : (P,) float64
        Free vector.
    frames : sequence of LockedCorners

    Returns
    -------
    lock : (2 TERMS,) float64
        Terms [px].
    taken : (P, P) float64
        Information on x that is lost because the terms are not known.
    """
    free = len(x)
    prior = np.concatenate((np.ones(free), np.full(len(lock), LOCK_PX**-2.0)))
    normal, slope = np.diag(prior), prior * np.concatenate((x, lock))
    for frame in frames:
        both = np.concatenate((frame.rate, -frame.terms), axis=2).reshape(-1, free + len(lock))
        normal += both.T @ both
        slope += both.T @ frame.value.ravel()
    step = -np.linalg.solve(normal, slope)
    across = normal[:free, free:]
    return lock + step[free:], np.asarray(across @ np.linalg.solve(normal[free:, free:], across.T))
