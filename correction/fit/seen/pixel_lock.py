"""The lock of edges on the rows of pixels, found from the frames themselves and taken off.

A pixel sums the light over its square, which no smooth edge model knows exactly.  An edge that runs along a row
is then drawn by an error that repeats with its place in the pixel (peak locking, as particle images have it):

    e = sum over m of  (a_m sin 2 pi m u + b_m cos 2 pi m u) sinc(m L),        m = 1, 2,

u the place of the corner, L how far [px] the edge leans over the arms of the window: edges that cross pixels mean
it away.  On a sharp frame a_1 is 0.02-0.1 px, several times what noise leaves, and alike in neighbouring corners.
Its terms are unknowns of the fit like all others, apart for u and v and beside and behind glass.  They stand
behind the free vector x, as columns that move nothing in the scene.

How large they may be the frame says by how wide its edges are.  Of an edge with variance b^2, pixel included, what
repeats with the pixel is a share exp(-2 pi^2 b^2) (aliasing).  So sines are believed to be

    a_1 = (SHARP_PX^2 exp(-4 pi^2 b^2) + LEAST_PX^2)^1/2,        a_2 = a_1 / 3,

and cosines EVEN_PX, as a pixel is the same from left and from right.  Found by the corner fit in edges of
b^2 = 0.04, 0.07, 0.12, 0.14, 0.18, 0.28, 0.52 px^2: a_1 = 0.108, 0.077, 0.030, 0.025, 0.010, 0.006, 0.018 px,
a_2 no more than a third of it, b_m below 0.002.

u is where the scene shows the corner, never where it was measured.  On a board that hangs straight, with squares
of whole pixels, u is the same for all corners; the noise of what was measured would then be all that differs, and
a_1 = 1/(2 pi) would explain every bit of it.  There the lock is one unknown with the place of the board, or, where
u drifts, with its scale: the belief decides, and the covariance holds what it leaves open.

A lock whose slope along u comes near -1 would undo whatever the scene does: the camera could go anywhere, and a
board of pure noise is fitted best far from its place.  Sines as small as they are believed do not reach it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.seen.measurement import MeasuredFrame
from correction.fit.solve.solver import Corners, Residuals
from correction.fit.solve.unknowns import Unknowns

SHARP_PX, LEAST_PX = 0.25, 0.012  # what is believed of a_1: of edges without width, and of any
EVEN_PX = 0.003  # what is believed of b_m
UNMEASURED_PX2 = 0.12  # variance of an edge as the sharpest lens draws it
HARMONICS = (1, 2)
TERMS = 4 * len(HARMONICS)
NAMES = tuple(
    f"lock {axis} {wave}{m} {region}"
    for region in ("beside", "behind")
    for axis in "uv"
    for m in HARMONICS
    for wave in ("sin", "cos")
)
ARMS = 0.84  # length of an edge in a window, squares


def lock_prior_px(frame: MeasuredFrame) -> NDArray[np.float64]:
    """Prior sigma (2 TERMS,) of every term in a frame, beside the glass if corners are seen there."""
    beside, variance = ~frame.behind, frame.spread.variance_px2
    measured = variance[beside if beside.any() else ~beside] if len(variance) else variance
    known = np.isfinite(measured).any()
    b2 = max(float(np.nanmedian(measured)), 0.0) if known else UNMEASURED_PX2
    sine = float(np.hypot(SHARP_PX * np.exp(-2.0 * np.pi**2 * b2), LEAST_PX))
    return np.tile([sine, EVEN_PX, sine / 3.0, EVEN_PX], len(NAMES) // 4)


def fade_of(axes_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fraction of the lock that remains where edges lean: sinc(m L) (N, 2, M) along u and v, for every harmonic m.

    Parameters
    ----------
    axes_px : (N, 2, 2) float64
        Columns: displacement by one square along the board's +x and +y.
    """
    lean = np.empty(axes_px.shape[:2])
    for axis in range(2):  # u is held by the edge that runs more along v, and the other way round
        along, across = np.abs(axes_px[:, 1 - axis]), np.abs(axes_px[:, axis])
        edge = np.argmin(across / np.maximum(along, 1e-9), axis=1)
        lean[:, axis] = ARMS * np.take_along_axis(across, edge[:, None], 1)[:, 0]
    return np.asarray(np.sinc(lean[:, :, None] * HARMONICS))


def lock_terms(
    pixel: NDArray[np.float64], fade: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pull of corners along u and v by a unit of every term of their own axis, and its derivative along that axis.

    Parameters
    ----------
    pixel : (N, 2) float64
        u, v.
    fade : (N, 2, M) float64
        From `fade_of`.

    Returns
    -------
    pull, slope : (N, 2, M, 2) float64
        Of sine and cosine, the last axis.
    """
    per_px = 2.0 * np.pi * np.array(HARMONICS)
    turn = pixel[:, :, None] * per_px
    sine, cosine = fade * np.sin(turn), fade * np.cos(turn)
    return np.stack((sine, cosine), axis=-1), np.stack((per_px * cosine, -per_px * sine), axis=-1)


@dataclass(frozen=True)
class PixelLock:
    """Part of the lock of a frame with N corners that stays constant while the scene is fitted.

    Parameters
    ----------
    fade : (N, 2, M) float64
        How much of it is left where edges lean.
    behind : (N,) bool
        Corners seen through glass.
    sizes_px : (2 TERMS,) float64
        What is believed of every term.
    """

    fade: NDArray[np.float64]
    behind: NDArray[np.bool_]
    sizes_px: NDArray[np.float64]

    @classmethod
    def of(cls, frame: MeasuredFrame) -> "PixelLock":
        """Return that of a frame."""
        return cls(fade_of(frame.axes_px), frame.behind, lock_prior_px(frame))


def with_lock(unknowns: Unknowns) -> Unknowns:
    """Return the same unknowns with the terms of the lock behind them, in units of what is believed of each."""
    still = np.zeros((len(unknowns.start), len(NAMES)))
    return replace(unknowns, names=(*unknowns.names, *NAMES), columns=np.column_stack((unknowns.columns, still)))


def remove_lock(
    locked: Unknowns, x: NDArray[np.float64], corners: Corners, lock: PixelLock, part: Residuals
) -> Residuals:
    """Return residuals with the lock taken off, and with the derivatives by its terms.

    Parameters
    ----------
    locked : Unknowns
        What is free, the lock among it (`with_lock`), P numbers.
    x : (P,) float64
        Free vector.
    corners : Corners
        N of them, with their weights.
    lock : PixelLock
        Of the frame that shows them.
    part : Residuals
        Theirs, as if there was no lock.
    """
    first = locked.names.index(NAMES[0])
    here = slice(first, first + len(NAMES))
    per_sigma = np.diagonal(np.asarray(corners.whiten), axis1=1, axis2=2)  # u and v are weighed apart
    shown = corners.pixel - np.nan_to_num(part.value / per_sigma)
    pull, slope = lock_terms(shown, lock.fade)
    by_region = (2, *pull.shape[1:])  # beside and behind glass, as NAMES has them
    region = lock.behind.astype(np.intp)
    found = (lock.sizes_px * x[here]).reshape(by_region)[region]
    rate = part.rate * (1.0 + np.sum(slope * found, axis=(2, 3)))[:, :, None]
    of_terms = np.zeros((len(region), 2, *by_region))
    own = -per_sigma[:, :, None, None] * pull * lock.sizes_px.reshape(by_region)[region]
    for axis in range(2):
        of_terms[np.arange(len(region)), axis, region, axis] = own[:, axis]
    rate[:, :, here] = of_terms.reshape(len(region), 2, len(NAMES))
    return Residuals(part.value - per_sigma * np.sum(pull * found, axis=(2, 3)), rate)


def without_lock(locked: Unknowns, normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Information (P, P) on what is free beside the lock: what is left when its terms are not known (Schur)."""
    lock = np.isin(locked.names, NAMES)
    across = normal[np.ix_(~lock, lock)]
    own = normal[np.ix_(lock, lock)] + np.eye(len(NAMES))
    return np.asarray(normal[np.ix_(~lock, ~lock)] - across @ np.linalg.solve(own, across.T))
