"""Uncertainty of the vectors of a last pass, which of them are measured, and what of them is noise.

Each step of `judge_vectors` needs those before it:

1. noise of one correlation (`uncertainty`), enlarged where particle images are inclined (`inclined_images`): it
   decides which vectors are measured at all;
2. noise of the result: passes and the last filter change it (`response`, `denoise`). The error by the subpixel
   position of particle images is added afterwards, since no filter removes it;
3. resolution, from the filtered vectors: the model (`resolution`), and what halved windows miss (`halving`), the
   mean of both squares, since they see the same detail; in windows too small for 4. also waves that none of them
   shows (`finer_waves`), which neither has seen;
4. resolution as it is measured (`agreement`): it replaces the model as far as it is significant, and adds to what
   halving has shown, which knows nothing of noise that vectors follow;
5. light that moves otherwise (`resolution.mismatch_px`), the larger: 4. is blind beyond a pixel. What is uncertain
   by then as a search of whole pixels is, and that the sooner the more of its neighbours were rejected, is no
   measurement of a single pair (`_is_uncertain`);
6. the cut of a mask (`cut_windows`), root sum square: none of 3. to 5. has seen it;
7. few particles (`resolution.with_few_pieces`): two or three know their own spread badly, so the total grows.

`sigma_u_px` and `sigma_v_px` are the result of 2., `resolution_px` that of 3. to 7.; both together are the total.
Of the resolution `steady_px` is the part that is the same in every pair of a steady flow.
"""

from functools import partial

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.agreement import LEAST_BLOCKS, measure_agreement, resolution_of
from piv.correlation.correlate import peak_ratios
from piv.correlation.cut_windows import cut_px
from piv.correlation.denoise import Denoised, remove_noise
from piv.correlation.evidence import is_chance_match, is_low_confidence
from piv.correlation.finer_waves import Evaluated, finer_px
from piv.correlation.halving import PIECES
from piv.correlation.passes import Measured, MultipassState
from piv.correlation.planes import fill_gaps
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
    with_halving,
)
from piv.correlation.response import gain, levels_of, noise_growth, parts_of, smoothings_of, total_response
from piv.correlation.sizes import Sizes, asymmetry_of_sizes, match_around, sums_of_sizes, variance_px2
from piv.correlation.uncertainty import (
    LARGEST_PX,
    blocks_of,
    correlation_asymmetry,
    correlation_statistics,
    sampling_error_px,
)
from piv.correlation.vector_field import VectorField, VectorFlag
from piv.errors import PairError

MIN_MATCH_SHARE = 0.25  # of a window's light
MAX_MISMATCH_PX = 0.25  # and the error that the rest may cause
MAX_NOISE_PX = 0.5  # of one correlation: with more, a peak at a whole pixel (0.58 px) is no worse
# Uncertainty of a vector; with more, a whole pixel (0.58 px) says as much, and as a share of its length
MAX_TOTAL_PX = 0.6
MAX_TOTAL_SHARE = 0.2
REJECTED_NEAR, NEIGHBOURS = 3.0, 5  # growth of it by the share of rejected vectors among 5 x 5
MATCH_SIDE = 1.5  # in last windows: side of the area around an uncertain vector that must match
BEYOND_CUT = 0.5, 0.3, 0.3  # share of the cut where the flow goes on behind a mask: of a pair, of what pairs share
# Share of the cut that counts where a rim is clean: errors near walls are then 0.8 to 1.2 sigma
RIM_CUT = 0.35
Floats = NDArray[np.float64]


def judge_vectors(course: MultipassState, spread_px2: float, added: int, missed_px: Floats) -> VectorField:
    """Judge the vectors of the last pass by their own uncertainty, and take noise off them (steps: see the top).

    `missed_px` (ny, nx): error of larger windows as smaller ones showed it; `spread_px2`: variance of an image.
    """
    found, grid, settings = course.found, course.grid, course.settings
    vectors, good = found.vectors_px, found.good
    sizes = found.sizes or Sizes((grid.size_px,), np.zeros(grid.shape, np.int64))
    sigma, before = np.full(vectors.shape, np.nan), np.full(grid.shape, np.nan)
    parts = np.full((3, *grid.shape), np.nan)
    unsure = np.zeros(grid.shape, bool)
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
        # 3. Resolution by the model, and by what halving showed: the same detail, so the mean of both counts.
        final = fill_gaps(vectors, good)[0]
        uneven = unevenness(particles, np.clip(central / np.maximum(asymmetry.light, 1e-30), 0.0, 1.0).mean(-1))
        modelled = _resolution_of_sizes(course, sizes, final, removed, uneven)
        is_usual = sizes.side_px == settings.windows_px[-1]
        steady = steady_px(modelled, missed_px, is_usual, settings.windows_px[-1] / grid.step_px)
        is_halved = is_usual & settings.finds_windows
        resolved = with_halving(modelled, removed, missed_px, is_halved & (particles >= 4.0 * PIECES))
        parts = np.stack((resolved, *steady))
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
        parts[0] = resolution_of(measured, parts[0], is_halved, sigma, noise, spread_px2)
        # 5. Light that moves otherwise by a pixel and more, of which blocks show nothing.
        parts = np.maximum(parts, mismatch_px(vectors, found.seen_px, found.correlation, good, sigma))
        if settings.drop_uncertain:
            dense = found.valid_fraction >= settings.min_valid
            unsure = good & _is_uncertain(vectors, np.hypot(parts[0], _rms(sigma)), good, dense)
            good = good & ~unsure
        # 6. Windows that a mask cuts. A clean rim shows that particles end there, and its windows hold some of
        # them: part of the cut counts.
        seen, given = course.frames.valid, course.frames.given
        around = seen if given is None else seen + np.float32(RIM_CUT) * (given - seen)
        is_rough = settings.denoise == 0.0  # noise is still in the vectors
        rough = np.nan_to_num(_rms(sigma)) if is_rough else None
        cuts = (cut_px(final, around, grid, side, settings.window_sigma, rough) for side in sizes.sides_px)
        cut = np.broadcast_to(sizes.pick(list(cuts)), parts.shape)
        if settings.flow_beyond_mask:
            cut = cut * np.array(BEYOND_CUT)[:, None, None]
        parts = np.hypot(parts, cut)
        # 7. All of these were estimated from the same few particles.
        parts[0] = with_few_pieces(parts[0], sigma, particles, is_usual)
    fill, near = fill_gaps(vectors, good)
    # A vector that is hardly known still is nearer to the flow than what is interpolated across its place.
    fill = np.where((unsure & near)[..., None], vectors, fill)
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


def _is_uncertain(
    vectors: Floats, total_px: Floats, good: NDArray[np.bool_], asked: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Windows (ny, nx) whose vector is hardly known by its uncertainty, beside rejected ones the sooner."""
    around = (NEIGHBOURS, NEIGHBOURS)
    rejected, all_near = (
        scipy.ndimage.uniform_filter(np.asarray(part, np.float64), around, mode="nearest")
        for part in (asked & ~good, asked)
    )
    most_px = np.maximum(MAX_TOTAL_PX, MAX_TOTAL_SHARE * np.linalg.norm(vectors, axis=-1))
    return np.asarray(total_px * (1.0 + REJECTED_NEAR * rejected / np.maximum(all_near, 1e-9)) > most_px)


def _rms(components: Floats) -> Floats:
    """Root mean square (ny, nx) of both components."""
    return np.asarray(np.sqrt(np.square(components).mean(axis=-1)))


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
    before = _rms(sigma) * growths[0]
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
