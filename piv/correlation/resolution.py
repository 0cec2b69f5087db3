"""Uncertainty of a vector by the size of its window, beside noise: a model from the vectors themselves.

Four things, the first three as root sum of squares. Windows that were halved (`piv.correlation.halving`) have a
second estimate of 2. and 3.: the square is the mean of both, as the larger of two is too large by chance.

1. **Taken off.** Detail that is no stronger than its noise goes with the noise (`piv.correlation.denoise`, which
   knows what it takes).
2. **Not seen.** Of a wave of two windows the passes show the share g (`piv.correlation.response`); second
   differences over half a window are twice its height, so (1 - g)/2 of them is missing.
3. **Seen in the wrong place.** A window weighs particles, not places. In a field of second derivative c its N
   independent pieces lie elsewhere than its weights, so what it sees of a curved field is off by about
   s^2 c/sqrt(N), s^2 the variance of its weights. The passes bend the predictor to the field, but by what windows
   saw, and see the rest in the same wrong places: what stays in the end is s^2 c/N times a number (`UNEVEN`,
   measured in waves of 48 to 256 px and turbulence at N = 3 to 19, windows of 16 and 32 px: 1.4 to 2.4).
   Where a place lies in a gap between particles, its window sees the field beside it: in thin seeding what stays
   is s^2 c times the same number, whatever N, if there is no light in the middle, and as much less as there is
   light (`unevenness`; measured with 0.0025 to 0.006 particles per px: 2.1, 1.8, 1.4, 1.0 s^2 c where windows of
   half the side hold 0.1, 0.4, 0.65, 1 of their share).
   Smaller windows go on from what windows of twice the size have bent, and what stays is second order: the same,
   times itself over `TWICE_PX` as long as it is less (turbulence down to 30 and 16 px seen by windows of 16 px at
   N = 3.7 and 5.6: 0.03, 0.08 to 0.13 and 0.22 to 0.25 px where the first order says 0.07, 0.14 and 0.21).
4. **Moves otherwise.** Across a shear layer or a core narrower than a window, part of the light does not match at
   the displacement that was found. With the correlation C, and C_0 where all matches, that share is 1 - C/C_0, of
   which `LOST_SHARE` may be chance. How else it may move, the surroundings say: D is the range of the vectors in
   3 x 3 windows, and of what windows showed that are not believed if they are several and move the same way: such
   a gap is a core that was not followed, a single one is an outlier, and peaks of noise stand anywhere. The error
   is the share times D and a number (`OTHERWISE`, measured at steps, in jets whose core of 15 to 62 px moves 6 to
   12 px, and in turbulence: 0.3 to 0.6). It is another view of what 2. and 3. see, so the larger counts.

The first two and the last are the same in every pair of a steady flow; the third changes with the particles.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

UNEVEN = 1.9
TWICE_PX = 0.19
THIN = 4.0  # pieces of the usual window where what lies beside an empty middle stands for it
OTHERWISE = 0.47
LOST_SHARE = 0.1
NOISE_RANGE = 3.0  # range of nine normal deviates over their deviation
FEW = 16.0  # over N^2: added to 1 in the variance where N pieces know their own spread
ENOUGH_PIECES = 6.0  # pieces that do
# A core that was not followed: windows of 3 x 3, and mean resultant length of what they show beside the vectors
GAP = 3
SAME_WAY = 0.85
LARGEST_PX = 1e6  # more than any displacement
MATCHED = 0.75  # quantile
STEADY = 1.5  # windows: deviation of the weights by which seeding is taken off

Floats = NDArray[np.float64]


class Window(NamedTuple):
    """Windows of one size: side and spacing [px], weights (side,), share that is shown of a wave of two sides.

    `found` says that passes with larger ones have led to them, see 3. above.
    """

    side_px: int
    step_px: int
    weights: Floats
    shown: float
    found: bool = False


class Modelled(NamedTuple):
    """Standard deviation (ny, nx) of a component by what windows do not resolve.

    `total_px` is the whole, `seeding_px` the part by where particles lie, which is new in every pair, and
    `unseen_px` the one by short waves, which stays before the last filter.
    """

    total_px: Floats
    seeding_px: Floats
    unseen_px: Floats


def resolution_model_px(vectors: Floats, taken_px: Floats, uneven: Floats, window: Window) -> Modelled:
    """Standard deviation (ny, nx) of a component by what windows of one size do not resolve.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px], finite everywhere.
    taken_px : ndarray of float64, shape (ny, nx)
        Standard deviation of a component of the flow that the last filter took off.
    uneven : ndarray of float64, shape (ny, nx)
        How unevenly particles fill a window, see `unevenness`.
    window : Window
        How they were measured.
    """
    place = np.arange(window.side_px) - (window.side_px - 1) / 2
    spread_px2 = float((window.weights * place**2).sum() / window.weights.sum())
    apart = max(1, round(0.5 * window.side_px / window.step_px))
    bent_px = second_differences(vectors, apart)
    displaced = UNEVEN * spread_px2 / (apart * window.step_px) ** 2 * bent_px * uneven
    if window.found:
        displaced = displaced * np.minimum(displaced / TWICE_PX, 1.0)
    missing = 0.5 * (1.0 - window.shown) * bent_px
    return Modelled(np.sqrt(taken_px**2 + displaced**2 + missing**2), displaced, missing)


def with_halving(modelled: Modelled, taken_px: Floats, missed_px: Floats, is_halved: NDArray[np.bool_]) -> Floats:
    """Resolution error (ny, nx) by the model and by what halved windows miss, which see the same detail.

    Parameters
    ----------
    modelled : Modelled
        What the model says.
    taken_px : ndarray of float64, shape (ny, nx)
        The part of it that the last filter took, which halving comes before.
    missed_px : ndarray of float64, shape (ny, nx)
        What halving has shown that windows miss.
    is_halved : ndarray of bool, shape (ny, nx)
        Windows that were halved, and whose halves hold enough particles to say so.
    """
    squares = [np.square(part) for part in (modelled.total_px, taken_px, missed_px)]
    return np.where(is_halved, np.sqrt(0.5 * sum(squares)), np.maximum(modelled.total_px, missed_px))


def steady_px(
    modelled: Modelled, missed_px: Floats, is_usual: NDArray[np.bool_], window_steps: float
) -> tuple[Floats, Floats]:
    """Return the parts (ny, nx) of the resolution error that are the same in every pair of a steady flow.

    That of filtered vectors, and that of vectors before the last filter. Halving counts whole in them: pairs tell
    what it shows by chance from what they have in common (`piv.statistics.unresolved`).

    Parameters
    ----------
    modelled : Modelled
        What the model says.
    missed_px : ndarray of float64, shape (ny, nx)
        What halving has shown that windows miss: both parts, so that seeding is taken off it as far as smaller
        windows cure it, in the mean of the windows around, as both are known by chance only.
    is_usual : ndarray of bool, shape (ny, nx)
        Windows that were halved.
    window_steps : float
        Side of these windows [grid steps].
    """
    halved = modelled.seeding_px * np.minimum(modelled.seeding_px / TWICE_PX, 1.0)  # stays in smaller windows
    gained = np.square(modelled.seeding_px) - np.square(halved)
    squares = (np.where(is_usual, part, 0.0) for part in (np.square(missed_px), gained))
    missed, seeding = (scipy.ndimage.gaussian_filter(part, STEADY * window_steps) for part in squares)
    share = np.clip(1.0 - seeding / np.maximum(missed, 1e-30), 0.0, 1.0)
    filtered = np.maximum(np.square(modelled.total_px) - np.square(modelled.seeding_px), 0.0)
    halving = share * np.square(missed_px)
    return np.sqrt(np.maximum(filtered, halving)), np.sqrt(np.maximum(np.square(modelled.unseen_px), halving))


def unevenness(pieces: Floats, middle: Floats) -> Floats:
    """Return how unevenly particles fill windows: 1/N of N pieces, and up to 1 where the middle is empty.

    Parameters
    ----------
    pieces : ndarray of float64, shape (ny, nx)
        Independent pieces in a window.
    middle : ndarray of float64, shape (ny, nx)
        Light in the middle over that of the window, from 0 to 1.
    """
    thin = min((THIN / float(np.median(pieces))) ** 2, 1.0)
    return np.asarray(np.hypot(1.0 / pieces, thin * (1.0 - middle)))


def with_few_pieces(
    resolution_px: Floats, sigma_px: Floats, pieces: Floats, is_usual: NDArray[np.bool_]
) -> Floats:
    """Return the resolution error (ny, nx) that makes the total larger where N pieces are few.

    The variance grows by 1 + `FEW` (1/N^2 - 1/N_0^2), N_0 = `ENOUGH_PIECES`.

    A deviation that two or three particles tell is itself hardly known, as that of a t distribution of few degrees
    of freedom, whose standard deviation is larger (JCGM 101:2008, 6.4.9). Finer windows do not need it: they stand
    where light does not match for the flow's sake, which is in their noise (ADR 83).

    Parameters
    ----------
    resolution_px : ndarray of float64, shape (ny, nx)
        Of all causes.
    sigma_px : ndarray of float64, shape (ny, nx, 2)
        Random sigma, which stays as it is.
    pieces : ndarray of float64, shape (ny, nx)
        Independent pieces in a window.
    is_usual : ndarray of bool, shape (ny, nx)
        Windows of usual size.
    """
    few = np.where(is_usual, np.maximum(pieces**-2.0 - ENOUGH_PIECES**-2.0, 0.0), 0.0)
    random = np.square(sigma_px).mean(axis=-1)
    return np.asarray(np.sqrt((np.square(resolution_px) + random) * (1.0 + FEW * few) - random))


def second_differences(vectors: Floats, apart: int) -> Floats:
    """Root mean square (ny, nx) over 3 x 3 vectors of a component's second differences over `apart` nodes."""
    square = np.zeros(vectors.shape[:2])
    for axis in range(2):
        field = np.moveaxis(vectors, axis, 0)
        step = min(apart, len(field) - 1)
        if step < 1:
            continue
        ends = 2.0 * field[0] - field[step:0:-1], 2.0 * field[-1] - field[-2 : -step - 2 : -1]
        wide = np.concatenate([ends[0], field, ends[1]])
        second = wide[2 * step :] - 2.0 * field + wide[: -2 * step]
        square += 0.5 * np.square(np.moveaxis(second, 0, axis)).sum(axis=-1)
    around: Floats = scipy.ndimage.uniform_filter(square, 3, mode="nearest")
    return np.sqrt(np.maximum(around, 0.0))  # running sums may leave less than nothing


def match_share(correlation: Floats, good: NDArray[np.bool_]) -> Floats:
    """Share (ny, nx) of the light of windows that moves as their vector says; 1 where nothing is known.

    From their correlation (ny, nx), which is that of windows in which all matches for a quarter of the good ones.
    """
    known = correlation[good & np.isfinite(correlation)]
    usual = float(np.quantile(known, MATCHED)) if known.size else 0.0
    share: Floats = np.nan_to_num(correlation / usual, nan=1.0) if usual > 0.0 else np.ones(good.shape)
    return share


def mismatch_px(
    vectors: Floats,
    seen_px: Floats,
    correlation: Floats,
    good: NDArray[np.bool_],
    sigma_px: Floats | None = None,
) -> Floats:
    """Standard deviation (ny, nx) of a component by light that moves otherwise than the vector says, see 4. above.

    Parameters
    ----------
    vectors : ndarray of float64, shape (ny, nx, 2)
        Displacements [px].
    seen_px : ndarray of float64, shape (ny, nx, 2)
        What windows showed, also those that are not believed; NaN where that was nothing.
    correlation : ndarray of float64, shape (ny, nx)
        At the vectors.
    good : ndarray of bool, shape (ny, nx)
        Vectors that are believed.
    sigma_px : ndarray of float64, shape (ny, nx, 2), optional
        Random sigma of the vectors, whose noise has a range of its own; default none.
    """
    share = 1.0 - match_share(correlation, good)
    gap = ~good & np.isfinite(seen_px).all(axis=-1)
    gap &= scipy.ndimage.convolve(gap.astype(int), np.ones((3, 3), int), mode="constant") >= GAP
    if sigma_px is not None:  # peaks of noise are no other motion, though their vectors are not to be believed
        gap &= _concentration(seen_px - vectors, gap) > SAME_WAY
    known, values = (good | gap)[..., None], np.where(good[..., None], vectors, seen_px)
    high, low = (
        scipy.ndimage.maximum_filter(np.where(known, sign * values, -LARGEST_PX), (3, 3, 1))
        for sign in (1.0, -1.0)
    )
    squares = np.square(np.maximum(high + low, 0.0))
    if sigma_px is not None:
        squares = np.maximum(squares - np.square(NOISE_RANGE * np.nan_to_num(sigma_px)), 0.0)
    range_px = np.sqrt(squares.mean(axis=-1))
    unmatched: Floats = OTHERWISE * np.clip(share - LOST_SHARE, 0.0, 1.0) * range_px
    return unmatched


def _concentration(values: Floats, here: NDArray[np.bool_]) -> Floats:
    """Mean resultant length (ny, nx) of the directions of vectors (ny, nx, 2) in 3 x 3 nodes, of those `here`."""
    length = np.maximum(np.linalg.norm(values, axis=-1, keepdims=True), 1e-9)
    sums = scipy.ndimage.uniform_filter(
        np.where(here[..., None], values / length, 0.0), (3, 3, 0), mode="constant"
    )
    count = scipy.ndimage.uniform_filter(here.astype(float), 3, mode="constant")
    return np.asarray(np.linalg.norm(sums, axis=-1) / np.maximum(count, 0.1))
