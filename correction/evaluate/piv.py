"""Particle image velocimetry of one pair: multi-pass correlation with symmetric window deformation.

Each pass deforms frame A by minus and frame B by plus half of what the passes before have found, correlates
windows of the deformed frames, and adds the displacement that is left:

    measured(x) = predictor(x) + peak of  sum_x' A(x' - d(x')/2) B(x' + d(x')/2 + s)  over s.

* The first two passes search whole windows by transform (`correction.evaluate.correlate`). What they leave is
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

SEARCHES = 2  # passes that look at whole windows
SMOOTH_SEARCH = 0.5  # of the window's side: standard deviation of the predictor's smoothing after a search
SMOOTH_REFINE = 0.25, 3  # the same after a refinement, and its order

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
    deformed = DeformedPair(pair.a, pair.b, pair.valid, pair.floor)
    predictor = np.zeros((*grids[0].shape, 2))
    searched: tuple[WindowGrid, Floats] | None = None
    for number, grid in enumerate(grids):
        if number == 0:
            found = _search(deformed, grid, predictor, settings, threads)
        else:
            if number == 1:
                coefficients = pair.coefficients(threads)
            deformed = deform_pair(coefficients, pair.valid, predictor, grids[number - 1], pair.floor, threads)
            predictor = _moved(predictor, grids[number - 1], grid)
            last = number == len(grids) - 1
            by = _search if number < SEARCHES and not last else _refine
            found = by(deformed, grid, predictor, settings, threads)
        if found.refined is None:
            searched = grid, found.peak_ratio
            predictor = smoothed(found.vectors_px, found.good, SMOOTH_SEARCH * grid.size_px / grid.step_px)
        elif number < len(grids) - 1:
            predictor = smoothed(found.vectors_px, found.good, _steps(settings, grid), SMOOTH_REFINE[1])
    if searched is not None:
        found = found._replace(peak_ratio=_nearest(*searched, grid))
    return _result(found, deformed, grids, pair, settings, threads)


def _steps(settings: PivSettings, grid: WindowGrid) -> float:
    """Smoothing of the predictor after a refinement, in grid steps."""
    asked = settings.smoothing_px
    return (SMOOTH_REFINE[0] * grid.size_px if asked is None else asked) / grid.step_px


def _search(
    pair: DeformedPair, grid: WindowGrid, predictor: Floats, settings: PivSettings, threads: int | None
) -> Measured:
    """Look at whole windows."""
    raw = correlate_windows(pair, grid, settings.min_valid, True, threads)
    vectors = predictor + raw.shift_px
    good = _accepted(vectors, raw.peak_ratio, pair, grid, settings, threads)
    fraction = raw.valid_fraction
    return Measured(vectors, raw.correlation, raw.peak_ratio, fraction, good, raw.shift_px, None)


def _refine(
    pair: DeformedPair, grid: WindowGrid, predictor: Floats, settings: PivSettings, threads: int | None
) -> Measured:
    """Look within a pixel, and at the whole of the windows that show no peak there."""
    raw = refine(pair, grid, settings.window_sigma, threads)
    shift, ratio = raw.shift_px.copy(), np.full(grid.shape, np.nan)
    shift[raw.valid_fraction < settings.min_valid] = np.nan
    lost = (raw.valid_fraction >= settings.min_valid) & np.isnan(shift).any(axis=-1)
    if lost.any():
        shift[lost], ratio[lost] = correlate_some(pair, grid, lost, settings.min_valid, threads)
        shift[lost & (ratio < WEAK)] = np.nan  # not where it was expected, and one of many
    vectors = predictor + shift
    good = _accepted(vectors, ratio, pair, grid, settings, threads)
    return Measured(vectors, raw.correlation, ratio, raw.valid_fraction, good, shift, raw)


def _accepted(
    vectors: Floats,
    ratio: Floats,
    pair: DeformedPair,
    grid: WindowGrid,
    settings: PivSettings,
    threads: int | None,
) -> NDArray[np.bool_]:
    """Vectors that were measured and fit their neighbours, or are proven by their own peak."""
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
    return good


def _moved(field: NDArray[np.float64], source: WindowGrid, target: WindowGrid) -> NDArray[np.float64]:
    """Field on the nodes of one grid, interpolated at the nodes of another."""
    if source is target or (np.array_equal(source.row, target.row) and source.size_px == target.size_px):
        return field
    along_u = interpolated(field, 1, source.x_px, target.x_px, source.step_px)
    return interpolated(along_u, 0, source.y_px, target.y_px, source.step_px)


def _nearest(grid: WindowGrid, values: Floats, other: WindowGrid) -> Floats:
    """Values of the windows of a grid (ny, nx) that lie nearest to those of another one."""
    rows, columns = (
        np.abs(there[:, None] - here[None]).argmin(axis=1)
        for here, there in ((grid.y_px, other.y_px), (grid.x_px, other.x_px))
    )
    return values[np.ix_(rows, columns)]


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
    searched = min(SEARCHES, len(grids) - 1) - 1
    transfers = []
    if grids[searched].size_px == grid.size_px:
        transfers.append(smoothing_transfer(SMOOTH_SEARCH * grid.size_px / grid.step_px, 1))
    repeats = sum(1 for earlier in grids[searched + 1 :] if earlier.size_px == grid.size_px)
    transfers += [smoothing_transfer(_steps(settings, grid), SMOOTH_REFINE[1])] * (repeats - 1)
    if not settings.denoise or min(grid.shape) < 2:
        return vectors, sigma * noise_growth(weights, grid.step_px, transfers)
    smooth = smoothing_transfer(SMOOTH * grid.size_px / grid.step_px, ORDER)
    parts = split(vectors, good, sigma, grid.size_px, grid.step_px)
    growth = noise_growth(weights, grid.step_px, transfers, smooth)
    growth_of_rest = noise_growth(weights, grid.step_px, transfers, lambda wave: 1.0 - smooth(wave))
    share = kept_share(parts.rest, good, growth_of_rest * sigma, settings.denoise)[..., None]
    variance = (growth * parts.smooth_sigma_px) ** 2 + (share * growth_of_rest * sigma) ** 2
    return parts.smooth + share * parts.rest, np.where(np.isfinite(sigma), np.sqrt(variance), np.nan)
