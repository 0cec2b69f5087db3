"""Particle image velocimetry of one pair: multi-pass correlation with symmetric window deformation.

Each pass deforms frame A by minus and frame B by plus half of what the passes before have found, correlates
windows of the deformed frames, and adds the displacement that is left:

    measured(x) = predictor(x) + peak of  sum_x' A(x' - d(x')/2) B(x' + d(x')/2 + s)  over s.

* The first pass searches whole windows by transform (`piv.correlation.correlate`). What it leaves is
  within a pixel nearly everywhere; the others look only there, with windows that weigh their middle most
  (`piv.correlation.refine`), and search where they find no peak.
* Frames are deformed with the float-exact quintic B-spline that also corrects them, made smoother for particle
  images of less than 3 px (`piv.correlation.prepare`).
* The predictor is smoothed between passes. Rejected vectors never reach it.
* Detail that is no stronger than noise is taken off the result (`piv.correlation.denoise`).

**What stands still** (background, reflections, dirt on the glass) draws every vector to zero, and no uncertainty
sees it. Where particles have moved by more than their own size, frames that show nothing else do not match at no
displacement; what matches there all the same, as a share of what the window holds, stands still.

Scarano, Meas. Sci. Technol. 13, R1 (2002); Astarita, Cardone, Exp. Fluids 38, 233 (2005).
Sign and axis conventions: see `piv.correlation.vector_field`.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.memory import require_memory
from piv.correlation.correlate import peak_ratios
from piv.correlation.deform import DeformedPair, deform_pair
from piv.correlation.denoise import kept_share, split
from piv.correlation.evidence import unproven
from piv.correlation.passes import Measured, moved, refine_pass, search
from piv.correlation.planes import filled, smoothed
from piv.correlation.prepare import Pair, prepared
from piv.correlation.refine import refine, window_weights
from piv.correlation.resolution import matched_share, unmatched_px, unresolved_px
from piv.correlation.response import COARSE, last_filter, noise_growth, smoothing_after, transfers_between
from piv.correlation.settings import PivSettings
from piv.correlation.uncertainty import LARGEST_PX, correlation_statistics, sampling_error_px
from piv.correlation.vector_field import VectorField, VectorFlag
from piv.correlation.windows import WindowGrid, window_grid
from piv.errors import PairError

FAR_MOVED = 4.0  # displacement over the deviation of a particle image: of the correlation 2 % are left
FEWEST_MOVED = 12  # windows, for a median
BYTES_PER_PX = 32  # that all passes hold at most; measured 30 at 2016 x 2016 and 4032 x 4032
DOUBTFUL_SHARE, GAIN = 0.6, 1.5  # with fewer vectors than this, larger first windows are tried: they may find more
LEAST_MATCHED, OTHERWISE_PX = 0.25, 0.25  # of a window's light; and what the rest may make of the vector
CHANGE_PX, CHANGED_SHARE = 0.25, 0.03  # more vectors than this share moved by more: another pass is worth its time
Floats = NDArray[np.float64]


def still_correlation(pair: DeformedPair, grid: WindowGrid, window_sigma: float, threads: int | None) -> Floats:
    """Correlation coefficient at no displacement, for every second window of each direction; `pair` undeformed."""
    every = slice(None, None, 2)
    coarse = WindowGrid(grid.row[every], grid.column[every], grid.size_px, 2 * grid.step_px)
    sums = refine(pair, coarse, window_sigma, threads).sums
    power = np.sqrt(sums[..., 8] * sums[..., 9])
    return np.where(power > 0.0, sums[..., 0] / np.where(power > 0.0, power, 1.0), np.nan)


def static_share(still: Floats, field: VectorField, spread_px2: float) -> float:
    """Share of the light that stands still, median over windows; NaN where all moves too little.

    Parameters
    ----------
    still : ndarray of float64
        From `still_correlation`, on the grid of `field`.
    field : VectorField
        How far it moves.
    spread_px2 : float
        Variance of a particle image.
    """
    far = np.hypot(field.u_px, field.v_px)[::2, ::2] > FAR_MOVED * np.sqrt(spread_px2)
    known = still[far & np.isfinite(still)]
    return float(np.median(known)) if len(known) >= FEWEST_MOVED else float("nan")


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
    MemoryShort
        The passes do not fit into memory.
    """
    settings = settings or PivSettings()
    size = np.shape(frame_a)
    require_memory(
        BYTES_PER_PX * float(np.prod(size)), f"evaluating a pair of {' x '.join(map(str, size[::-1]))} px"
    )
    sides = list(settings.windows_px)
    # Frames are prepared anew for each trial: nobody holds them while one goes on.
    field = _evaluated(prepared(frame_a, frame_b, valid, sides[-1]), sides, settings, threads)
    while _share(field) < DOUBTFUL_SHARE and 3 * sides[0] <= min(np.shape(frame_a)):
        sides = [2 * sides[0], *sides]
        try:
            again = _evaluated(prepared(frame_a, frame_b, valid, sides[-1]), sides, settings, threads)
        except PairError:
            break  # no more than there was
        if _share(again) < GAIN * _share(field):
            break  # it is not for want of size
        field = again
    return field


def _share(field: VectorField) -> float:
    """Share of the windows with something to see that have a vector."""
    counts = field.counts
    return counts["valid"] / max(field.flags.size - counts["masked"], 1)


def _evaluated(pair: Pair, sides: list[int], settings: PivSettings, threads: int | None) -> VectorField:
    """Make all passes, the last one several times if vectors still move."""
    shape = (pair.a.shape[0], pair.a.shape[1])
    grids = [window_grid(shape, side, settings.overlap) for side in sides]
    found = search(pair, grids[0], settings, threads)
    deformed = DeformedPair(pair.a, pair.b, pair.valid, pair.floor)
    still = still_correlation(deformed, grids[-1], settings.window_sigma, threads)
    coefficients = pair.coefficients(threads)
    valid, floor, spread_px2, nan_pixels = pair.valid, pair.floor, pair.spread_px2, pair.nan_pixels
    doubt = pair.doubt
    del pair  # 8 bytes a pixel that nobody needs any more
    number = added = 0
    while number + 1 < len(grids):
        before, grid = grids[number : number + 2]
        steps, order = smoothing_after(number, before.size_px, before.step_px, settings)
        predictor = smoothed(found.vectors_px, found.good, steps, order)
        number += 1
        del deformed  # and 12 that the next ones need
        known = doubt if number >= COARSE else None  # frames complete each other where they are known to match
        deformed = deform_pair(coefficients, valid, predictor, before, floor, threads, known)
        predictor = moved(predictor, before, grid)
        found = refine_pass(deformed, grid, predictor, number == 1, settings, threads)
        if number + 1 == len(grids) and added < settings.extra_passes and _changes(found, settings):
            added += 1
            grids.append(grid)
    del coefficients
    if settings.peak_ratios:
        everywhere = found.valid_fraction >= settings.min_valid
        ratio = peak_ratios(deformed, grids[-1], everywhere, settings.min_valid, threads)
        found = found._replace(peak_ratio=ratio)
    field = _result(found, deformed, grids, spread_px2, settings, threads)
    still_share = static_share(still, field, spread_px2)
    return replace(field, nan_pixels=nan_pixels, static_share=still_share, added_passes=added)


def _changes(found: Measured, settings: PivSettings) -> bool:
    """Whether a pass has still moved more than a few vectors."""
    dense = found.valid_fraction >= settings.min_valid
    moved = ~(np.linalg.norm(found.left_px, axis=-1) < CHANGE_PX)
    return bool((moved & dense).sum() > CHANGED_SHARE * dense.sum())


def _result(
    found: Measured,
    deformed: DeformedPair,
    grids: list[WindowGrid],
    spread_px2: float,
    settings: PivSettings,
    threads: int | None,
) -> VectorField:
    """Judge the vectors of the last pass by their own uncertainty, and take noise off them."""
    grid, vectors, good = grids[-1], found.vectors_px, found.good
    sigma, resolution = np.full(vectors.shape, np.nan), np.full(grid.shape, np.nan)
    if found.refined is not None:
        left, _ = filled(found.left_px, good)
        one, pieces = correlation_statistics(
            deformed, grid, settings.window_sigma, found.refined, left, spread_px2, threads
        )
        good = good & ~_empty(found, one, deformed, grid, settings, threads)
        good = good & ~_beside_the_point(found, good)
        # A clear peak of a whole window, but none where frames were deformed to: it is known to a pixel.
        one = np.where(good[..., None] & np.isnan(one), LARGEST_PX, one)
        vectors, sigma, taken = _denoised(vectors, good, one, grids, settings)
        sigma = np.hypot(sigma, sampling_error_px(spread_px2))
        resolution = unresolved_px(filled(vectors, good)[0], taken, pieces, grid, settings)
        resolution = np.maximum(resolution, unmatched_px(vectors, found.seen_px, found.correlation, good))
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
        nan_pixels=0,
        resolution_px=np.where(told & np.isfinite(sigma).all(axis=-1), resolution, np.nan),
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


def _beside_the_point(found: Measured, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Windows (ny, nx) most of whose light moves otherwise than their vector says, and by much."""
    little = matched_share(found.correlation, good) < LEAST_MATCHED
    apart_px = unmatched_px(found.vectors_px, found.seen_px, found.correlation, good)
    return np.asarray(little & (apart_px > OTHERWISE_PX))


def _denoised(
    vectors: Floats, good: NDArray[np.bool_], sigma: Floats, grids: list[WindowGrid], settings: PivSettings
) -> tuple[Floats, Floats, Floats]:
    """Vectors without the detail that is noise, their sigma, and that of what went of the flow (ny, nx).

    `sigma` is that of one correlation.
    """
    grid = grids[-1]
    weights = window_weights(grid.size_px, settings.window_sigma)
    transfers = transfers_between([other.size_px for other in grids], grid.step_px, settings)
    if not settings.denoise or min(grid.shape) < 2:
        return vectors, sigma * noise_growth(weights, grid.step_px, transfers), np.zeros(grid.shape)
    smooth = last_filter(grid.size_px, grid.step_px)
    parts = split(vectors, good, sigma, grid.size_px, grid.step_px)
    growth = noise_growth(weights, grid.step_px, transfers, smooth)
    growth_of_rest = noise_growth(weights, grid.step_px, transfers, lambda wave: 1.0 - smooth(wave))
    share, loss = (
        part[..., None] for part in kept_share(parts.rest, good, growth_of_rest * sigma, settings.denoise)
    )
    random = np.hypot(growth * parts.smooth_sigma_px, share * growth_of_rest * sigma)
    return parts.smooth + share * parts.rest, np.where(np.isfinite(sigma), random, np.nan), loss[..., 0]
