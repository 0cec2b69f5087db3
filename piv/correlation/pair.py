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
sees it. A wall or a reflection that is far brighter than the flow is found (`piv.preprocessing.still_light`), in
the two frames or beforehand in a whole series, and belongs to no window; nor does an area without particles
(`piv.preprocessing.empty_areas`), unless vectors stand in it all the same. Of the rest, where particles have moved
by more than their own size, frames that show nothing else do not match at no displacement; what matches there all
the same, as a share of what the window holds, stands still.

**Uncertainty.** Each step of `_judge_vectors` needs those before it:

1. noise of one correlation (`uncertainty`), enlarged where particle images are inclined (`inclined_images`): it
   decides which vectors are measured at all;
2. noise of the result: passes and the last filter change it (`response`, `denoise`). The error by the subpixel
   position of particle images is added afterwards, since no filter removes it;
3. resolution, from the filtered vectors: the model (`resolution`) or what halved windows miss (`halving`), the
   larger, since they see the same detail; in windows too small for 4. also waves that none of them shows
   (`finer_waves`), which neither has seen;
4. resolution as it is measured (`agreement`): it replaces 3. as far as it is significant beside noise and chance;
5. light that moves otherwise (`resolution.mismatch_px`), the larger: 4. is blind beyond a pixel;
6. the cut of a mask (`cut_windows`), root sum square: none of 3. to 5. has seen it;
7. few particles (`resolution.with_few_pieces`): two or three know their own spread badly, so the total grows.

`sigma_u_px` and `sigma_v_px` are the result of 2., `resolution_px` that of 3. to 7.; both together are the total.
Of the resolution `steady_px` is the part that is the same in every pair of a steady flow.

Scarano, Meas. Sci. Technol. 13, R1 (2002); Astarita, Cardone, Exp. Fluids 38, 233 (2005).
Sign and axis conventions: see `piv.correlation.vector_field`.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.blas import one_blas_thread
from ground.memory import require_memory
from piv.correlation.agreement import LEAST_BLOCKS, least_resolution, measure_agreement, resolution_of
from piv.correlation.common_light import (
    LAGS,
    SUSPECT,
    CommonLight,
    Known,
    is_suspect,
    lag_of_coarse_light,
    match_with_itself,
    static_share,
    still_correlation,
    without_common_light,
)
from piv.correlation.correlate import peak_ratios
from piv.correlation.cut_windows import cut_px
from piv.correlation.deform import DeformedPair, Frames
from piv.correlation.denoise import Denoised, remove_noise
from piv.correlation.evidence import is_chance_match, is_low_confidence
from piv.correlation.finer_waves import Evaluated, finer_px
from piv.correlation.halving import find_sizes
from piv.correlation.inclined_images import inclination_of
from piv.correlation.passes import Measured, MultipassState, search
from piv.correlation.planes import fill_gaps
from piv.correlation.prepare import Pair, check_frames, prepare_pair
from piv.correlation.refine import window_weights
from piv.correlation.resolution import (
    Modelled,
    Window,
    match_share,
    mismatch_px,
    resolution_model_px,
    steady_px,
    unevenness,
    with_few_pieces,
)
from piv.correlation.response import gain, levels_of, noise_growth, parts_of, smoothings_of, total_response
from piv.correlation.settings import FOUND_WINDOWS, PivSettings
from piv.correlation.sizes import Sizes, asymmetry_of_sizes, match_around, sums_of_sizes, variance_px2
from piv.correlation.static_light import hidden_share, stretch_of, stretched, without_static_waves
from piv.correlation.taken_out import (
    is_measured,
    without_chance_vectors,
    without_masked,
    without_seams,
    without_still,
    without_vectors,
)
from piv.correlation.two_motions import share_at_rest
from piv.correlation.uncertainty import (
    LARGEST_PX,
    blocks_of,
    correlation_asymmetry,
    correlation_statistics,
    sampling_error_px,
)
from piv.correlation.vector_field import TRUSTED_SHARE, VectorField, VectorFlag
from piv.correlation.windows import window_grid
from piv.errors import PairError
from piv.preprocessing.empty_areas import empty_areas
from piv.preprocessing.still_light import light_beside, still_light, with_clean_rim

BYTES_PER_PX = 40  # that all passes hold at most: 30, and 8 of a pair that may have light in common
# Larger first windows are tried if few places have a vector, and kept if they find more
MIN_VALID_SHARE = 0.8  # of the windows
RETRY_GAIN, RETRY_LEFT = 1.5, 0.6  # share with a vector, and without, over that of the usual windows
HIDDEN_SHARE = 0.3  # of blocks whose vector is far too short: still light hides the flow
MUCH_AT_REST = 0.3  # of the light: vectors that are stretched are not trusted where damping leaves two motions
MOVING_SHARE = 0.5  # of the windows, where what stands still was drawing vectors to zero
PASS_CHANGE_PX, PASS_CHANGED_SHARE = 0.25, 0.03  # more vectors moved by more: another pass is worth its time
# Single vectors
MIN_MATCH_SHARE, MAX_MISMATCH_PX = 0.25, 0.25  # of a window's light; and the error that the rest may cause
MAX_NOISE_PX = 0.5  # of one correlation: with more, a peak at a whole pixel (0.58 px) is no worse
MATCH_SIDE = 1.5  # in last windows: side of the area around an uncertain vector that must match
BEYOND_CUT = 0.5, 0.3, 0.3  # share of the cut where the flow goes on behind a mask: of a pair, of what pairs share
RIM_CUT = 0.35  # share of the cut that counts where a rim is clean: errors near walls are then 0.8 to 1.2 sigma
Floats = NDArray[np.float64]


@one_blas_thread()
def evaluate_pair(
    frame_a: NDArray[Any],
    frame_b: NDArray[Any],
    valid: NDArray[np.bool_] | None = None,
    settings: PivSettings | None = None,
    threads: int | None = None,
    still: NDArray[np.bool_] | None = None,
) -> VectorField:
    """Measure the displacement from frame A to frame B.

    Parameters
    ----------
    frame_a, frame_b : ndarray, shape (H, W)
        Intensities: integers or floats of any size. NaN, infinite and masked pixels (`numpy.ma`) do not count.
    valid : ndarray of bool, shape (H, W), optional
        True where the frames show the flow; default everywhere.
    settings : PivSettings, optional
        How to evaluate; default as the command does: each place finds its window, 32 or 16 px.
    threads : int, optional
        Threads to use; default all cores of the process.
    still : ndarray of bool, shape (H, W), optional
        True where light stands still, as others have found it; default what these two frames show of that.

    Returns
    -------
    VectorField
        Displacements on a regular grid, each with the side of its window.

    Raises
    ------
    PairError
        Different sizes, a mask of another size or kind, nothing valid, or a frame without texture.
    FrameError
        A frame that is none.
    MemoryShort
        The passes do not fit into memory.
    """
    settings = settings or FOUND_WINDOWS
    size = np.shape(frame_a)
    require_memory(
        BYTES_PER_PX * float(np.prod(size)), f"evaluating a pair of {' x '.join(map(str, size[::-1]))} px"
    )
    frames, _, seen = check_frames(frame_a, frame_b, valid)
    if still is None:
        still = still_light([(frames[0], frames[1])], seen)
    empty = empty_areas(frames[0], frames[1], seen)
    given = None if valid is None or valid.all() else valid
    if given is not None:
        usable = check_frames(frame_a, frame_b, None)[2]
        valid = with_clean_rim((frames[0], frames[1]), given, usable)
        leaking = light_beside((frames[0], frames[1]), given, usable)
        still = leaking if still is None else still | leaking
    del frames, seen
    if still is not None:
        valid = ~still if valid is None else valid & ~still
    sides = list(settings.windows_px)
    rim = given if given is not None and valid is not None and (valid & ~given).any() else None

    hidden: list[NDArray[np.bool_]] = []

    # Frames are prepared again for each trial, so that only one prepared pair is in memory.
    def prepare_again() -> Pair:
        pair = prepare_pair(frame_a, frame_b, valid, sides[-1])
        hidden[:] = [] if pair.hidden is None else [pair.hidden]
        return pair if rim is None else replace(pair, given=rim.astype(np.float32))

    field = _run_trials(prepare_again, sides, settings, threads)
    if empty is not None and not is_measured(field, empty):
        valid = ~empty if valid is None else valid & ~empty
        still = empty if still is None else still | empty
        with suppress(PairError):  # nothing is left
            field = _run_trials(prepare_again, sides, settings, threads)
    field = without_chance_vectors(field)
    for area in hidden:
        still = area if still is None else still | area
    if given is not None:
        field = without_masked(field, given)
    if still is not None and still.any():
        field = without_still(field, given, still, settings.min_valid)
    same = np.array_equal(np.ma.getdata(frame_a), np.ma.getdata(frame_b), equal_nan=True)
    return replace(field, is_one_picture=same)


def _run_trials(
    prepare_again: Callable[[], Pair], sides: list[int], settings: PivSettings, threads: int | None
) -> VectorField:
    """Make all passes, and again with larger first windows if few places have a vector."""
    pair = prepare_again()
    shape = pair.a.shape
    field = _run_passes(pair, sides, settings, threads)
    del pair
    for side in _larger(sides[0], min(shape)) if field.valid_share < MIN_VALID_SHARE else ():
        try:
            again = _run_passes(prepare_again(), [side, *sides], settings, threads)
        except PairError:
            continue  # no more than there was
        share, before = again.valid_share, field.valid_share
        if share < RETRY_GAIN * before and 1.0 - share > RETRY_LEFT * (1.0 - before):
            continue  # larger windows do not help
        field = again
        if field.valid_share > TRUSTED_SHARE:
            break
    return field


def _larger(side_px: int, frame_px: int) -> list[int]:
    """Sides of larger first windows that a frame of that side holds."""
    return [side for side in (3 * side_px // 2, 2 * side_px, 4 * side_px) if 3 * side <= 2 * frame_px]


def _run_passes(
    pair: Pair,
    sides: list[int],
    settings: PivSettings,
    threads: int | None,
    common: CommonLight | None = None,
    is_damped: bool = False,
) -> VectorField:
    """Make all passes: down to usual windows, then with those that places find, the last ones again if need be.

    `common` is what was taken off the pair; `is_damped` says whether waves that stand still were.
    """
    shape = (pair.a.shape[0], pair.a.shape[1])
    grids = [window_grid(shape, side, settings.overlap) for side in sides]
    deformed = DeformedPair(pair.a, pair.b, pair.valid, pair.floor)
    still = still_correlation(deformed, grids[-1], settings.window_sigma, threads)
    found = search(pair, grids[0], settings, threads)
    inclination = inclination_of(pair.a)
    frames = Frames(pair.coefficients(threads), pair.valid, pair.floor, pair.filled, pair.given, inclination)
    spread_px2, sampled_px2, nan_pixels = pair.spread_px2, pair.spread_as_sampled_px2, pair.nan_pixels
    suspect = pair if common is None and is_suspect(still) else None
    del pair  # 8 bytes a pixel that are not needed any more
    course = MultipassState(frames, settings, threads, grids[0], found, deformed)
    for grid in grids[1:]:
        course.run_pass(grid)
    vectors = fill_gaps(course.found.vectors_px, course.found.good)[0]
    if suspect is not None:  # large images are still at their own place when they have moved by their width
        still = still - np.maximum(match_with_itself(suspect.a, vectors[::2, ::2]), 0.0)
    still_share = static_share(still, vectors, spread_px2)
    known, lag, at_rest = None, float("nan"), 0.0
    if suspect is not None:
        known = Known(course.grid, course.found.vectors_px, course.found.correlation)
        believed = known._replace(vectors_px=np.where(course.found.good[..., None], known.vectors_px, np.nan))
        lag = lag_of_coarse_light(course.deformed, believed, spread_px2, threads)
        # Where vectors are long, they tell
        at_rest = 0.0 if still_share < SUSPECT else share_at_rest(course.deformed, believed, spread_px2)
        if not is_damped:
            common = without_common_light(suspect, known, settings.min_valid, threads, lag)
        if common is not None:
            field = _run_passes(replace(common.pair, given=suspect.given), sides, settings, threads, common)
            return replace(field, nan_pixels=nan_pixels)
        # -lag is part of the share that stands still, so a lower bound
        if lag < -LAGS:
            still_share = max(-lag, np.nan_to_num(still_share))
    every, added, missed_px = 1, 0, np.zeros(course.grid.shape)
    while course.found.refined is not None and added < settings.extra_passes and _needs_another_pass(course):
        course.run_pass(course.grid)
        added += 1
    if settings.finds_windows:
        own, every = settings.own_grid(shape)
        added, missed_px = find_sizes(course, own, spread_px2, sampled_px2)
    if settings.peak_ratios:
        dense = course.found.valid_fraction >= settings.min_valid
        ratio = peak_ratios(course.deformed, course.grid, dense, settings.min_valid, threads)
        course.found = course.found._replace(peak_ratio=ratio)
    field = _judge_vectors(course, spread_px2, added, missed_px)
    if common is not None:
        field = without_seams(field, common)
        still_share = common.share
    field = _decimate(replace(field, nan_pixels=nan_pixels, static_share=still_share), every)
    del course
    stretch = None if suspect is None else stretch_of(suspect, field)
    if is_damped:
        factor = 1.0 if stretch is None else stretch.factor
        return replace(field, stretch=float("inf") if at_rest else factor)
    is_static = stretch is not None and stretch.is_static
    if suspect is None or known is None or not (at_rest or is_static):
        return field
    if not is_static and hidden_share(suspect, field) < HIDDEN_SHARE:
        return field  # flows beside a fluid at rest show two motions as well
    if stretch is not None and is_static:
        share = float(np.fmax(still_share, 1.0 - 1.0 / stretch.factor))
        damped = without_static_waves(suspect, stretch)
        again = None if damped is None else _run_passes(damped, sides, settings, threads, is_damped=True)
        is_left = at_rest > MUCH_AT_REST and again is not None and np.isinf(again.stretch)
        field = stretched(replace(field, stretch=stretch.factor, static_share=share), again)
        if not at_rest or (field.valid.any() and not is_left):
            return field
    # Vectors that still light draws to zero, and nothing tells how far, mean nothing without it.
    common = without_common_light(suspect, known, settings.min_valid, threads, lag, at_rest)
    with suppress(PairError):  # nothing is left
        if common is not None:
            rest = replace(common.pair, given=suspect.given)
            field = replace(_run_passes(rest, sides, settings, threads, common), nan_pixels=nan_pixels)
    # A few vectors between places that mean nothing are there by chance.
    return field if field.valid_share > MOVING_SHARE else without_vectors(field, field.asked, VectorFlag.REJECTED)


def _decimate(field: VectorField, every: int) -> VectorField:
    """Every n-th vector along each axis, n = `every`."""
    if every == 1:
        return field
    places: dict[str, Any] = {
        name: value[(slice(None, None, every),) * value.ndim]
        for name, value in vars(field).items()
        if isinstance(value, np.ndarray)
    }
    return replace(field, **places, step_px=every * field.step_px)


def _needs_another_pass(course: MultipassState) -> bool:
    """Return whether a pass has still moved more than a few vectors."""
    dense = course.found.valid_fraction >= course.settings.min_valid
    far = ~(np.linalg.norm(course.found.left_px, axis=-1) < PASS_CHANGE_PX)
    return bool((far & dense).sum() > PASS_CHANGED_SHARE * dense.sum())


def _judge_vectors(course: MultipassState, spread_px2: float, added: int, missed_px: Floats) -> VectorField:
    """Judge the vectors of the last pass by their own uncertainty, and take noise off them (steps: see the top).

    `missed_px` (ny, nx): error of larger windows as smaller ones showed it; `spread_px2`: variance of an image.
    """
    found, grid, settings = course.found, course.grid, course.settings
    vectors, good = found.vectors_px, found.good
    sizes = found.sizes or Sizes((grid.size_px,), np.zeros(grid.shape, np.int64))
    sigma, before = np.full(vectors.shape, np.nan), np.full(grid.shape, np.nan)
    parts = np.full((3, *grid.shape), np.nan)
    if found.refined is not None:
        # 1. Noise of one correlation; it decides which vectors are measured.
        # What the last pass still found: the asymmetry that it causes is no noise.
        left, _ = fill_gaps(found.left_px, good)
        blocks = blocks_of(course.deformed, spread_px2, course.threads)
        asymmetry = correlation_asymmetry(
            blocks, grid, settings.window_sigma, left, partial(sums_of_sizes, grid, sizes, settings.window_sigma)
        )
        central = asymmetry.light  # in the smallest windows, the middle of larger ones
        asymmetry = asymmetry_of_sizes(asymmetry, grid, sizes, settings.window_sigma)
        noise, particles = correlation_statistics(asymmetry, found.refined)
        if course.frames.inclination is not None:
            noise = noise * course.frames.inclination.noise_growth(grid)[..., None]
        good = good & ~_is_unmeasured(course, noise, particles / np.square(sizes.side_px))
        good = good & ~_is_mostly_unmatched(found, good)
        # A clear peak of a whole window, but none where frames were deformed to: it is known to a pixel.
        noise = np.where(good[..., None] & np.isnan(noise), LARGEST_PX, noise)
        # 2. Noise of the result; no filter takes the sampling error off.
        before, (vectors, sigma, removed) = _remove_noise(course, sizes, good, noise, added)
        sigma, before = (np.hypot(part, sampling_error_px(spread_px2)) for part in (sigma, before))
        # 3. Resolution by the model, and by what halving showed: the same detail, so the larger counts.
        final = fill_gaps(vectors, good)[0]
        uneven = unevenness(particles, np.clip(central / np.maximum(asymmetry.light, 1e-30), 0.0, 1.0).mean(-1))
        modelled = _resolution_of_sizes(course, sizes, final, removed, uneven)
        steady = steady_px(
            modelled, missed_px, sizes.side_px == settings.windows_px[-1], settings.windows_px[-1] / grid.step_px
        )
        parts = np.stack((np.maximum(modelled.total_px, missed_px), *steady))
        large = sizes.side_px >= LEAST_BLOCKS * blocks.side_px
        if not large.all():  # nothing is measured there, see 4.
            finer = _short_wave_error(course, good, noise, added)
            parts = np.where(large, parts, np.hypot(parts, finer))
        # 4. Resolution as blocks of the frames show it.
        # Blocks measure what the frames show beyond the vectors; the frames are deformed by the predictor (vectors
        # less what the pass found), so final - predictor is subtracted.  Clipped: the asymmetry of a block is
        # proportional to the displacement within a pixel only, and shows nothing of longer ones.
        beyond = np.clip(final - fill_gaps(found.vectors_px - found.left_px, good)[0], -1.0, 1.0)
        weight = good * large * found.refined.gain
        measured = measure_agreement(blocks, grid, beyond, weight, settings.windows_px[-1])
        parts = parts * resolution_of(measured, parts[0], sigma, noise) / np.maximum(parts[0], 1e-30)
        parts[0] = np.maximum(parts[0], least_resolution(measured, sigma, noise, spread_px2))
        # 5. Light that moves otherwise by a pixel and more, of which blocks show nothing.
        parts = np.maximum(parts, mismatch_px(vectors, found.seen_px, found.correlation, good, sigma))
        # 6. Windows that a mask cuts. A clean rim shows that particles end there, and its windows hold some of
        # them: part of the cut counts.
        seen, given = course.frames.valid, course.frames.given
        around = seen if given is None else seen + np.float32(RIM_CUT) * (given - seen)
        is_rough = settings.denoise == 0.0  # noise is still in the vectors
        rough = np.nan_to_num(np.sqrt(np.square(sigma).mean(axis=-1))) if is_rough else None
        cuts = (cut_px(final, around, grid, side, settings.window_sigma, rough) for side in sizes.sides_px)
        cut = np.broadcast_to(sizes.pick(list(cuts)), parts.shape)
        if settings.flow_beyond_mask:
            cut = cut * np.array(BEYOND_CUT)[:, None, None]
        parts = np.hypot(parts, cut)
        # 7. All of these were estimated from the same few particles.
        parts[0] = with_few_pieces(parts[0], sigma, particles)
    fill, near = fill_gaps(vectors, good)
    flags = np.full(grid.shape, VectorFlag.REJECTED, np.uint8)
    flags[near] = VectorFlag.REPLACED
    flags[good] = VectorFlag.VALID
    share = found.valid_fraction
    if (given := course.frames.given) is not None:
        share = np.minimum(
            share, sizes.pick([_share_of_given_mask(course, given, side) for side in sizes.sides_px])
        )
    flags[share < settings.min_valid] = VectorFlag.MASKED
    nothing = (flags == VectorFlag.MASKED) | (flags == VectorFlag.REJECTED)
    fill = np.where(nothing[..., None], np.nan, fill)
    known = (flags == VectorFlag.VALID) & settings.uncertainty
    sigma = np.where(known[..., None], sigma, np.nan)
    is_filtered = settings.uncertainty and settings.denoise > 0.0  # and the noise of a mean is known
    resolution, steady, unfiltered_steady = np.where(known & np.isfinite(sigma).all(axis=-1), parts, np.nan)
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
        valid_fraction=share,
        window_px=settings.windows_px[-1],
        step_px=grid.step_px,
        nan_pixels=0,
        resolution_px=resolution,
        steady_px=steady,
        added_passes=added,
        side_px=None if found.sizes is None else found.sizes.side_px,
        unfiltered_px=np.where(known[..., None], found.vectors_px, np.nan) if is_filtered else None,
        unfiltered_sigma_px=np.where(known, before, np.nan) if is_filtered else None,
        unfiltered_steady_px=unfiltered_steady if is_filtered else None,
    )


def _share_of_given_mask(course: MultipassState, given: NDArray[np.float32], side_px: int) -> Floats:
    """Share (ny, nx) of windows that the mask which was given leaves, by their weights."""
    import cv2

    spread_px = float(np.sqrt(variance_px2(side_px, course.settings.window_sigma)))
    share = np.asarray(cv2.GaussianBlur(given, (0, 0), spread_px))
    nodes = (np.rint(place).astype(np.int64) for place in (course.grid.y_px, course.grid.x_px))
    rows, columns = (np.clip(at, 0, side - 1) for at, side in zip(nodes, share.shape, strict=True))
    return np.asarray(share[np.ix_(rows, columns)], np.float64)


def _is_unmeasured(course: MultipassState, sigma: Floats, particles_per_px2: Floats) -> NDArray[np.bool_]:
    """Windows (ny, nx) where nothing was measured: sigma too large, and a weak peak or a chance match."""
    found, settings = course.found, course.settings
    # Windows larger than their spacing share light, so neighbours agree even where there are no particles.
    largest_px = np.inf if found.sizes is None else MAX_NOISE_PX
    sigma = np.where(sigma < largest_px, sigma, np.nan)
    uncertain = found.good & np.isnan(sigma).any(axis=-1)
    if not uncertain.any():
        return uncertain
    ratio = peak_ratios(course.deformed, course.grid, uncertain, settings.support, course.threads)
    empty = is_low_confidence(ratio, sigma)
    if found.sizes is not None:
        around_px = MATCH_SIDE * settings.windows_px[-1]
        match = match_around(found.own, course.grid, round(around_px), settings.window_sigma)
        empty |= uncertain & is_chance_match(match, particles_per_px2 * around_px**2)
    if not (found.good & ~empty).any():
        raise PairError("no window gave a vector that its own correlation supports; check exposure and pairing")
    return empty


def _is_mostly_unmatched(found: Measured, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Windows (ny, nx) most of whose light moves by another displacement, far from that of the vector."""
    little = match_share(found.correlation, good) < MIN_MATCH_SHARE
    apart_px = mismatch_px(found.vectors_px, found.seen_px, found.correlation, good)
    return np.asarray(little & (apart_px > MAX_MISMATCH_PX))


def _remove_noise(
    course: MultipassState, sizes: Sizes, good: NDArray[np.bool_], sigma: Floats, added: int
) -> tuple[Floats, Denoised]:
    """Return sigma of a component before the last filter, and its result; `sigma` is that of one correlation."""
    settings, step, vectors = course.settings, course.grid.step_px, course.found.vectors_px
    levels = levels_of(settings, step) if settings.denoise > 0.0 and min(course.grid.shape) >= 2 else []
    passes = [(side, smoothings_of(settings, side, step, added)) for side in sizes.sides_px]
    growths = []
    for part in (total_response, *(parts_of(levels) if levels else ())):
        of_side = [
            noise_growth(window_weights(side, settings.window_sigma), step, between, part)
            for side, between in passes
        ]
        growths.append(np.array(of_side)[sizes.which])
    before = np.sqrt(np.square(sigma).mean(axis=-1)) * growths[0]
    if not levels:
        return before, Denoised(vectors, sigma * growths[0][..., None], np.zeros(good.shape))
    return before, remove_noise(vectors, good, sigma, growths[1:], levels, settings.denoise)


def _short_wave_error(course: MultipassState, good: NDArray[np.bool_], sigma: Floats, added: int) -> Floats:
    """Uncertainty (ny, nx) by waves that not even the smallest windows show."""
    settings, grid = course.settings, course.grid
    vectors, noise = (fill_gaps(part, good)[0] for part in (course.found.vectors_px, sigma))
    between = smoothings_of(settings, grid.size_px, grid.step_px, added)
    return finer_px(vectors, noise, Evaluated(grid.size_px, grid.step_px, settings.window_sigma, between))


def _resolution_of_sizes(
    course: MultipassState, sizes: Sizes, vectors: Floats, removed: Floats, uneven: Floats
) -> Modelled:
    """Modelled resolution error (ny, nx) [px], every node by the size of its own window."""
    settings, step = course.settings, course.grid.step_px
    parts = []
    for side in sizes.sides_px:
        weights = window_weights(side, settings.window_sigma)
        shown = gain(weights, step, smoothings_of(settings, side, step), np.array([np.pi / side, 0.0]))
        parts.append(
            resolution_model_px(
                vectors, removed, uneven, Window(side, step, weights, float(shown), side < settings.windows_px[-1])
            )
        )
    return Modelled(*(sizes.pick(list(part)) for part in zip(*parts, strict=True)))
