"""Light that both frames of a pair have in common, over a whole flow: dust, texture, hot pixels, fixed patterns.

It draws every vector to zero, and where it is as strong as the particles all of them stand there, surely. What
is common to a and b goes off both with the part that is darker,

    a - min(a, b) = max(a - b, 0),      b - min(a, b) = max(b - a, 0).

Particles that have moved by their own image stay whole, whatever lies behind them. Of those that have moved less,
both parts are pushed apart (`APART`), and at rest they seem to have moved by three deviations of their image.
So there is common light where, in most windows, what is left moves by more than that (`FAR` deviations) with a
clear peak, and the window as it is either shows no displacement, though no good match either, or more of it
moves than a slow flow leaves behind; or matches worse than what is left; or shows the same displacement and a
match at rest that slow places in it do not explain. Longer vectors then lose what their images were pushed
apart by; shorter ones mean nothing and are rejected.

The size of images is that of the pair, or of what is left where this is far smaller: behind a coarse texture. It
is smaller as well, the seams of images, where large ones hardly move; but then windows match as a whole at some
place that is not rest, and the less so the more particles are lost, which leave all of their image (`SEAMS`).
Light far brighter than the particles matches at rest but for noise. What nearly all windows agree on beyond
`BEYOND_SEAMS` deviations moves all the same.

A slow flow whose vectors are as long as they should be (`piv.correlation.static_light`) is asked nothing else.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.correlate import Searched, correlate_windows, peak_ratios
from piv.correlation.deform import DeformedPair
from piv.correlation.evidence import WEAK
from piv.correlation.prepare import Pair, prepare_pair, texture_of
from piv.correlation.refine import refine
from piv.correlation.windows import WindowGrid, window_grid
from piv.errors import PairError

Floats = NDArray[np.float64]
SUSPECT = 0.04  # median match of windows at no displacement; particles that have moved give 0.00 to 0.03
GOOD = 0.93  # median match at the vectors, noise aside, that leaves nothing to explain
POOR = 0.85  # match at rest, noise aside, that is not that of a fluid at rest
OVER, LEFT_OVER = 2.0, 0.02  # share of the light that moves, by that which slow vectors leave; and without any
BETTER = 0.05  # match of what is left over that of windows as they are
NEAR_PX = 1.5  # between what a window shows as it is and what is left of it
WINDOW_PX = 64  # side of the windows that are asked
NEAR_SHARE = 0.06  # of that side: clear displacements of neighbours differ by less
FAR = 3.75  # displacement in deviations of a particle image
BEYOND_SEAMS = 6.0  # the same, median of windows that agree: no seams explain it
SEAMS_APART = 3.0  # the same of images at rest, which is no such displacement unless they leave too much
SEAMS = 0.2  # variance of seams over that of images, more by what is lost
RESTS = 0.45  # displacement in deviations of an image, of windows at rest
SLOWEST_PX = 0.4  # median vector that tells whether light stands still
NEARLY_ALL = 0.9  # of the vectors
LEAST_LOST = 0.15  # with less, windows move as a whole
WIDER = 1.2  # variance of images over that of what is left of them behind a texture
APART = (  # length in deviations of an image, and how much of it comes of images that overlap (measured)
    (3.61, 4.05, 4.58, 5.18, 6.44, 10.0),
    (0.40, 0.20, 0.092, 0.05, 0.027, 0.0),
)
SHARE, FEWEST = 0.5, 4  # of the windows that must show a clear displacement
MOST_PX = 1024  # side of the part of a frame that is compared with itself
STILL_MIN_SHIFT = 4.0  # displacement over the deviation of a particle image: of the correlation 2 % are left
STILL_MIN_WINDOWS = 12  # for a median
LEAST_COMMON = 0.06  # share of the light, in three of four windows that move


class CommonLight(NamedTuple):
    """A pair without what both frames have in common, the share of light that was, and deviation of an image."""

    pair: Pair
    share: float
    image_px: float

    @property
    def least_px(self) -> float:
        """Length of the shortest vectors that mean something."""
        return FAR * self.image_px

    def lengthening_px(self, length_px: Floats) -> Floats:
        """Return the part of the length of vectors that comes of images that overlap."""
        return self.image_px * np.interp(length_px / self.image_px, *APART)


class Known(NamedTuple):
    """Vectors (ny, nx, 2) of a pair as it is at the nodes of a grid, and their correlation (ny, nx)."""

    grid: WindowGrid
    vectors_px: Floats
    correlation: Floats

    def means(self, windows: WindowGrid, values: Floats) -> Floats:
        """Means of values (ny, nx) over the nodes within `windows`; NaN where there is none."""
        row, column = (
            np.clip((place - first[0]) // windows.size_px, 0, len(first) - 1).astype(np.int64)
            for place, first in ((self.grid.y_px, windows.row), (self.grid.x_px, windows.column))
        )
        number = (row[:, None] * len(windows.column) + column).ravel()
        known = np.isfinite(values).ravel()
        count, total = (
            np.bincount(number[known], weights, windows.shape[0] * windows.shape[1])
            for weights in (None, values.ravel()[known])
        )
        means = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
        return np.asarray(means.reshape(windows.shape))


def is_suspect(still: Floats) -> bool:
    """Return whether the match of windows at no displacement asks for an explanation."""
    return bool(np.isfinite(still).any() and np.nanmedian(still) > SUSPECT)


def without_common_light(
    pair: Pair,
    known: Known,
    min_valid: float,
    threads: int | None,
    is_static: bool | None,
) -> CommonLight | None:
    """Take off what both frames have in common; None if that is nothing, or is not known.

    Parameters
    ----------
    pair : Pair
        Frames as they were levelled.
    known : Known
        What the pair shows as it is.
    min_valid : float
        Share of valid pixels that a window needs.
    threads : int, optional
        Threads to use.
    is_static : bool or None
        Whether light stands still before the flow (`piv.correlation.static_light`); None if not known.
    """
    shape = (pair.a.shape[0], pair.a.shape[1])
    seen = np.isfinite(known.correlation) & np.isfinite(known.vectors_px).all(axis=-1)
    if not seen.any() or min(shape) < 2 * WINDOW_PX:
        return None
    spread_px2 = image_spread_px2(pair)
    usual = float(np.median(known.correlation[seen]))
    usual_px = float(np.median(np.linalg.norm(known.vectors_px[seen], axis=-1)))
    is_slow = usual_px < FAR * np.sqrt(spread_px2)
    if usual > GOOD or (is_slow and usual_px > SLOWEST_PX and is_static is False):
        return None
    try:
        rest = prepare_pair(
            np.maximum(pair.a - pair.b, 0.0), np.maximum(pair.b - pair.a, 0.0), pair.valid > 0.0, WINDOW_PX // 2
        )
    except PairError:
        return None  # the same picture twice
    # Single bright pixels are noise of the pair, and common to both frames.
    without_noise = 1.0 + min(pair.noise, rest.noise)
    grid = window_grid(shape, WINDOW_PX, 0.0)
    frames, left = (DeformedPair(part.a, part.b, part.valid, part.floor) for part in (pair, rest))
    moved = correlate_windows(left, grid, min_valid, threads)
    found = moved.shift_px
    asked = np.asarray(np.isfinite(found).all(axis=-1))
    clear = asked & (peak_ratios(left, grid, asked, min_valid, threads) > WEAK)
    length_px = np.linalg.norm(found, axis=-1)
    if clear.any() and np.median(length_px[clear]) < FAR * np.sqrt(spread_px2):
        whole = correlate_windows(frames, grid, min_valid, threads)
        left_px2 = image_spread_px2(rest)
        if _is_behind_texture(whole, spread_px2, left_px2, without_noise):
            spread_px2 = WIDER * left_px2
    image_px = float(np.sqrt(spread_px2))
    at_rest = match_at_rest(frames, grid, 0.0, threads)
    agreed = _agree(found, clear) & (length_px > FAR * image_px)
    if agreed.sum() >= max(FEWEST, NEARLY_ALL * asked.sum()):
        share = float(np.nanmedian(at_rest[agreed]))
        # Nothing at rest leaves that, however well it matches.
        if np.median(length_px[agreed]) > BEYOND_SEAMS * image_px and share > LEAST_COMMON:
            return CommonLight(rest, share, image_px)
    if is_slow and usual * without_noise > GOOD:
        return None
    slowly = np.exp(-np.square(known.vectors_px).sum(axis=-1) / (4.0 * spread_px2))
    # Images that are long, or rings, match themselves farther away than Gaussian ones of their width.
    slowly = np.maximum(slowly, match_with_itself(pair.a, known.vectors_px))
    vectors = np.stack([known.means(grid, known.vectors_px[..., axis]) for axis in range(2)], axis=-1)
    match = known.means(grid, known.correlation)
    # What moves as one is more than such slow vectors leave behind, or matches better than they do.
    left_over = moved.correlation * (1.0 - at_rest) > OVER * (1.0 - known.means(grid, slowly)) + LEFT_OVER
    better = moved.correlation > match + BETTER
    is_at_rest = np.linalg.norm(vectors, axis=-1) < image_px
    far = clear & (length_px > np.where(is_at_rest & left_over, SEAMS_APART, FAR) * image_px)
    if far.sum() < max(FEWEST, SHARE * asked.sum()):
        return None
    stands = is_at_rest & (left_over | (match * without_noise < POOR))
    same = np.linalg.norm(vectors - found, axis=-1) < NEAR_PX
    common = np.where(stands | better, at_rest, np.where(same, at_rest - known.means(grid, slowly), 0.0))
    if not np.nanquantile(common[far], 0.25) > LEAST_COMMON:
        return None
    return CommonLight(rest, float(np.nanmedian(at_rest[far])), image_px)


def _agree(found_px: Floats, clear: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where clear displacements (ny, nx, 2) are nearly those around them (`NEAR_SHARE`)."""
    ny, nx = clear.shape
    padded = np.full((ny + 2, nx + 2, 2), np.nan)
    known = padded[1:-1, 1:-1]
    known[clear] = found_px[clear]
    near = np.zeros(clear.shape, bool)
    for row, column in zip(*np.nonzero(clear), strict=True):
        around = padded[row : row + 3, column : column + 3]
        middle = np.nanmedian(around, axis=(0, 1))
        off_px = np.linalg.norm(known[row, column] - middle)
        near[row, column] = off_px < NEAR_SHARE * WINDOW_PX
    return near


def _is_behind_texture(whole: Searched, spread_px2: float, left_px2: float, without_noise: float) -> bool:
    """Return whether the rest of images is so small because a coarse texture is off, not as they hardly move."""
    # Correlation is read at whole pixels, beside the peak.
    beside_px2 = np.square(whole.shift_px - np.rint(whole.shift_px)).sum(axis=-1)
    match = float(np.nanmedian(whole.correlation * np.exp(beside_px2 / (4.0 * spread_px2))))
    lost = max(1.0 - match * without_noise, 0.0)
    slowest_px = float(np.nanquantile(np.linalg.norm(whole.shift_px, axis=-1), 0.25))
    rests = slowest_px < RESTS * np.sqrt(spread_px2)
    return bool(rests and lost > LEAST_LOST and left_px2 < (SEAMS + lost) * spread_px2)


def image_spread_px2(pair: Pair) -> float:
    """Variance of a particle image of a pair, by the direction in which it is smaller: patterns may have one."""
    return _spreads_px2(pair)[0]


def _spreads_px2(pair: Pair) -> list[float]:
    """Variances of a particle image along columns and rows, the smaller first."""
    frame, weight = (np.ascontiguousarray(part.T) for part in (pair.a, pair.valid))
    return sorted((pair.spread_px2, texture_of(frame, weight, bool(pair.valid.all())).spread_px2))


def match_with_itself(frame: NDArray[np.float32], shift_px: Floats) -> Floats:
    """Correlation coefficient (...) of a frame (H, W) with itself at displacements (..., 2) of some pixels."""
    middle = tuple(
        slice(max(side - MOST_PX, 0) // 2, max(side - MOST_PX, 0) // 2 + MOST_PX) for side in frame.shape
    )
    spectrum = scipy.fft.rfft2(frame[middle])
    square = np.square(spectrum.real) + np.square(spectrum.imag)
    products = scipy.fft.irfft2(square, frame[middle].shape)
    at = np.moveaxis(np.nan_to_num(shift_px[..., ::-1]), -1, 0)
    found = scipy.ndimage.map_coordinates(products, at, order=1, mode="grid-wrap") / products[0, 0]
    return np.asarray(found, np.float64)


def match_at_rest(pair: DeformedPair, grid: WindowGrid, window_sigma: float, threads: int | None) -> Floats:
    """Correlation coefficient (ny, nx) of windows at no displacement; `pair` undeformed."""
    sums = refine(pair, grid, window_sigma, threads).sums
    power = np.sqrt(sums[..., 8] * sums[..., 9])
    return np.where(power > 0.0, sums[..., 0] / np.where(power > 0.0, power, 1.0), np.nan)


def still_correlation(pair: DeformedPair, grid: WindowGrid, window_sigma: float, threads: int | None) -> Floats:
    """Correlation coefficient at no displacement, for every second window of each direction; `pair` undeformed."""
    every = slice(None, None, 2)
    coarse = WindowGrid(grid.row[every], grid.column[every], grid.size_px, 2 * grid.step_px)
    return match_at_rest(pair, coarse, window_sigma, threads)


def static_share(still: Floats, vectors: Floats, spread_px2: float) -> float:
    """Share of the light that stands still, median over windows; NaN where all moves too little.

    Parameters
    ----------
    still : ndarray of float64
        From `still_correlation`, on the grid of `vectors`.
    vectors : ndarray of float64, shape (ny, nx, 2)
        How far it moves.
    spread_px2 : float
        Variance of a particle image.
    """
    far = np.linalg.norm(vectors, axis=-1)[::2, ::2] > STILL_MIN_SHIFT * np.sqrt(spread_px2)
    known = still[far & np.isfinite(still)]
    return float(np.median(known)) if len(known) >= STILL_MIN_WINDOWS else float("nan")
