"""Particle image velocimetry of one pair: multi-pass correlation with symmetric window deformation.

Each pass deforms frame A by minus and frame B by plus half of what the passes before have found, correlates
windows of the deformed frames, and adds the displacement that is left:

    measured(x) = predictor(x) + peak of  sum_x' A(x' - d(x')/2) B(x' + d(x')/2 + s)  over s.

* The first pass searches whole windows by transform (`correction.evaluate.correlate`). What it leaves is
  within a pixel nearly everywhere; the others look only there, with windows that weigh their middle most
  (`correction.evaluate.refine`), and search where they find no peak.
* Frames are deformed with the float-exact quintic B-spline that also corrects them, made smoother for particle
  images of less than 3 px (`correction.evaluate.prepare`).
* The predictor is smoothed between passes. Rejected vectors never reach it.
* Detail that is no stronger than noise is taken off the result (`correction.evaluate.denoise`).

Scarano, Meas. Sci. Technol. 13, R1 (2002); Astarita, Cardone, Exp. Fluids 38, 233 (2005).
Sign and axis conventions: see `correction.evaluate.vector_field`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.errors import PairError
from correction.evaluate.correlate import correlate_some, correlate_windows, peak_ratios
from correction.evaluate.deform import DeformedPair, deform_pair
from correction.evaluate.denoise import ORDER, SMOOTH, kept_share, split
from correction.evaluate.evidence import WEAK, proven, unproven
from correction.evaluate.outliers import filled, outliers, smoothed
from correction.evaluate.prepare import Pair, prepared
from correction.evaluate.refine import Refined, refine, window_weights
from correction.evaluate.response import noise_growth, smoothing_transfer
from correction.evaluate.settings import PivSettings
from correction.evaluate.uncertainty import correlation_statistics, sampling_error_px
from correction.evaluate.vector_field import VectorField, VectorFlag
from correction.evaluate.windows import WindowGrid, interpolated, window_grid

HALVED_PX = 64  # first windows of this side are looked at in frames of half the resolution
LEAST_CORRELATION = 0.5  # of the second pass: with less, what lies in the middle may be there by chance
CHANGE_PX, CHANGED_SHARE = 0.25, 0.03  # more vectors than this share moved by more: another pass is worth its time
COARSE = 2  # passes after which the predictor is smoothed more
SMOOTH_COARSE, SMOOTH_FINE = 0.35, 0.25  # of the window's side: standard deviation of that smoothing

Floats = NDArray[np.float64]


class Measured(NamedTuple):
    """What a pass has found: vectors_px (ny, nx, 2), the others (ny, nx); `refined` unless it has searched."""

    vectors_px: Floats
    correlation: Floats
    peak_ratio: Floats
    valid_fraction: Floats
    good: NDArray[np.bool_]
    left_px: Floats
    refined: Refined | None


def evaluate_pair(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    valid: NDArray[np.bool_] | None = None,
    settings: PivSettings | None = None,
    threads: int | None = None,
) -> VectorField:
    """Measure the displacement from frame A to frame B.

    Parameters
    ----------
    frame_a, frame_b : ndarray, shape (H, W)
        Intensities: integers or floats of any size. NaN, infinite and masked pixels (`numpy.ma`) do not count.
    valid : ndarray of bool, shape (H, W), optional
        True where the frames show the flow; default everywhere.
    settings : PivSettings, optional
        How to evaluate.
    threads : int, optional
        Threads to use; default all cores of the process.

    Returns
    -------
    VectorField
        Displacements on the grid of the last pass.

    Raises
    ------
    PairError
        Different sizes, a mask of another size or kind, nothing valid, or a frame without texture.
    FrameError
        A frame that is none.
    """
    settings = settings or PivSettings()
    pair = prepared(frame_a, frame_b, valid, settings.windows_px[-1])
    shape = (pair.a.shape[0], pair.a.shape[1])
    grids = [window_grid(shape, size, settings.overlap) for size in settings.windows_px]
    found = _search(pair, grids[0], settings, threads)
    deformed = _undeformed(pair)
    coefficients = pair.coefficients(threads) if len(grids) > 1 else None
    number = 0
    while number + 1 < len(grids):
        before, grid = grids[number : number + 2]
        number += 1
        assert coefficients is not None
        predictor = smoothed(found.vectors_px, found.good, *_smoothing(number - 1, before, settings))
        deformed = deform_pair(coefficients, pair.valid, predictor, before, pair.floor, threads)
        predictor = _moved(predictor, before, grid)
        least = LEAST_CORRELATION if number == 1 else 0.0
        found = _refine(deformed, grid, predictor, least, settings, threads)
        is_last = number + 1 == len(grids)
        if is_last and len(grids) < len(settings.windows_px) + settings.extra_passes and _changes(found, settings):
            grids.append(grid)
    if settings.peak_ratios:
        everywhere = found.valid_fraction >= settings.min_valid
        ratio = peak_ratios(deformed, grids[-1], everywhere, settings.min_valid, threads)
        found = found._replace(peak_ratio=ratio)
    return _result(found, deformed, grids, pair, settings, threads)


def _changes(found: Measured, settings: PivSettings) -> bool:
    """Whether a pass has still moved more than a few vectors."""
    dense = found.valid_fraction >= settings.min_valid
    moved = ~(np.linalg.norm(found.left_px, axis=-1) < CHANGE_PX)
    return bool((moved & dense).sum() > CHANGED_SHARE * dense.sum())


def _undeformed(pair: Pair) -> DeformedPair:
    return DeformedPair(pair.a, pair.b, pair.valid, pair.floor)


def _smoothing(number: int, grid: WindowGrid, settings: PivSettings) -> tuple[float, int]:
    """Smoothing of the predictor after a pass: standard deviation in grid steps, and order."""
    if number < COARSE:
        return SMOOTH_COARSE * grid.size_px / grid.step_px, 1
    asked = settings.smoothing_px
    return (SMOOTH_FINE * grid.size_px if asked is None else asked) / grid.step_px, ORDER


def _search(pair: Pair, grid: WindowGrid, settings: PivSettings, threads: int | None) -> Measured:
    """Look at whole windows; large ones at half the resolution, since only whole pixels count yet."""
    halves = grid.size_px >= HALVED_PX and len(settings.windows_px) > 1
    half = WindowGrid(grid.row // 2, grid.column // 2, grid.size_px // 2, grid.step_px // 2) if halves else grid
    frames = _undeformed(pair.halved() if halves else pair)
    raw = correlate_windows(frames, half, settings.min_valid, False, threads)
    good, ratio = _accepted(raw.shift_px, np.full(grid.shape, np.nan), frames, half, settings, threads)
    shift = raw.shift_px * (2.0 if halves else 1.0)
    return Measured(shift, raw.correlation, ratio, raw.valid_fraction, good, shift, None)


def _refine(
    pair: DeformedPair,
    grid: WindowGrid,
    predictor: Floats,
    least: float,
    settings: PivSettings,
    threads: int | None,
) -> Measured:
    """Look within a pixel, and at whole windows where no peak is there or less than `least` correlates."""
    raw = refine(pair, grid, settings.window_sigma, threads)
    shift, ratio = raw.shift_px.copy(), np.full(grid.shape, np.nan)
    dense = raw.valid_fraction >= settings.min_valid
    shift[~dense] = np.nan
    lost = dense & (np.isnan(shift).any(axis=-1) | (raw.correlation < least))
    if lost.any():
        found, ratio[lost] = correlate_some(pair, grid, lost, settings.min_valid, threads)
        found[ratio[lost] < WEAK] = np.nan  # not where it was expected, and one of many
        shift[lost] = found
    vectors = predictor + shift
    good, ratio = _accepted(vectors, ratio, pair, grid, settings, threads)
    return Measured(vectors, raw.correlation, ratio, raw.valid_fraction, good, shift, raw)


def _accepted(
    vectors: Floats,
    ratio: Floats,
    pair: DeformedPair,
    grid: WindowGrid,
    settings: PivSettings,
    threads: int | None,
) -> tuple[NDArray[np.bool_], Floats]:
    """Vectors that were measured and fit their neighbours, or are proven by their own peak; and peak ratios."""
    candidates: NDArray[np.bool_] = np.all(np.isfinite(vectors), axis=-1)
    suspects = outliers(vectors, candidates, settings.outlier_threshold, settings.outlier_epsilon_px)
    good = candidates & ~suspects
    unknown = suspects & np.isnan(ratio)
    if unknown.any():
        ratio = np.where(unknown, peak_ratios(pair, grid, unknown, settings.min_valid, threads), ratio)
    if suspects.any():
        good |= proven(vectors, candidates, suspects, ratio, grid.size_px)
    if not good.any():
        if candidates.any():
            raise PairError(
                "no window gave a vector that fits its neighbours; check exposure, seeding and pairing"
            )
        raise PairError(
            f"no window holds {settings.min_valid:.0%} valid pixels with particles; check the mask or use smaller "
            "windows"
        )
    return good, ratio


def _moved(field: NDArray[np.float64], source: WindowGrid, target: WindowGrid) -> NDArray[np.float64]:
    """Field on the nodes of one grid, interpolated at the nodes of another."""
    if source is target or (np.array_equal(source.row, target.row) and source.size_px == target.size_px):
        return field
    along_u = interpolated(field, 1, source.x_px, target.x_px, source.step_px)
    return interpolated(along_u, 0, source.y_px, target.y_px, source.step_px)


def _result(
    found: Measured,
    deformed: DeformedPair,
    grids: list[WindowGrid],
    pair: Pair,
    settings: PivSettings,
    threads: int | None,
) -> VectorField:
    """Judge the vectors of the last pass by their own uncertainty, and take noise off them."""
    grid, vectors, good = grids[-1], found.vectors_px, found.good
    sigma = np.full(vectors.shape, np.nan)
    if found.refined is not None:
        left, _ = filled(found.left_px, good)
        one = correlation_statistics(
            deformed, grid, settings.window_sigma, found.refined, left, pair.spread_px2, threads
        )
        good = good & ~_empty(found, one, deformed, grid, settings, threads)
        vectors, sigma = _denoised(vectors, good, one, grids, settings)
        sigma = np.hypot(sigma, sampling_error_px(pair.spread_px2))
    fill, near = filled(vectors, good)
    flags = np.full(grid.shape, VectorFlag.REJECTED, np.uint8)
    flags[near] = VectorFlag.REPLACED
    flags[good] = VectorFlag.VALID
    flags[found.valid_fraction < settings.min_valid] = VectorFlag.MASKED
    nothing = (flags == VectorFlag.MASKED) | (flags == VectorFlag.REJECTED)
    fill = np.where(nothing[..., None], np.nan, fill)
    told = (flags == VectorFlag.VALID) & settings.uncertainty
    sigma = np.where(told[..., None], sigma, np.nan)
    return VectorField(
        x_px=grid.x_px,
        y_px=grid.y_px,
        u_px=fill[..., 0],
        v_px=fill[..., 1],
        flags=flags,
        peak_ratio=found.peak_ratio,
        correlation=found.correlation,
        sigma_u_px=sigma[..., 0],
        sigma_v_px=sigma[..., 1],
        valid_fraction=found.valid_fraction,
        window_px=grid.size_px,
        step_px=grid.step_px,
        nan_pixels=pair.nan_pixels,
    )


def _empty(
    found: Measured,
    sigma: Floats,
    pair: DeformedPair,
    grid: WindowGrid,
    settings: PivSettings,
    threads: int | None,
) -> NDArray[np.bool_]:
    """Windows (ny, nx) in which nothing was measured: no uncertainty, and a weak peak."""
    doubtful = found.good & np.isnan(sigma).any(axis=-1)
    if not doubtful.any():
        return doubtful
    empty = unproven(peak_ratios(pair, grid, doubtful, settings.min_valid, threads), sigma)
    if not (found.good & ~empty).any():
        raise PairError("no window gave a vector that its own correlation supports; check exposure and pairing")
    return empty


def _denoised(
    vectors: Floats, good: NDArray[np.bool_], sigma: Floats, grids: list[WindowGrid], settings: PivSettings
) -> tuple[Floats, Floats]:
    """Vectors without the detail that is noise, and their uncertainty; `sigma` is that of one correlation."""
    grid = grids[-1]
    weights = window_weights(grid.size_px, settings.window_sigma)
    first = next(number for number, other in enumerate(grids) if number and other.size_px == grid.size_px)
    transfers = [
        smoothing_transfer(*_smoothing(number, other, settings))
        for number, other in enumerate(grids[:-1])
        if number >= first
    ]
    if not settings.denoise or min(grid.shape) < 2:
        return vectors, sigma * noise_growth(weights, grid.step_px, transfers)
    smooth = smoothing_transfer(SMOOTH * grid.size_px / grid.step_px, ORDER)
    parts = split(vectors, good, sigma, grid.size_px, grid.step_px)
    growth = noise_growth(weights, grid.step_px, transfers, smooth)
    growth_of_rest = noise_growth(weights, grid.step_px, transfers, lambda wave: 1.0 - smooth(wave))
    share = kept_share(parts.rest, good, growth_of_rest * sigma, settings.denoise)[..., None]
    variance = (growth * parts.smooth_sigma_px) ** 2 + (share * growth_of_rest * sigma) ** 2
    return parts.smooth + share * parts.rest, np.where(np.isfinite(sigma), np.sqrt(variance), np.nan)
