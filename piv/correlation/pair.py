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

Vectors of the last pass are judged by their own uncertainty (`piv.correlation.judge`).

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
from ground.rows import map_parts
from piv.correlation.common_light import (
    SUSPECT,
    CommonLight,
    Known,
    is_suspect,
    match_with_itself,
    static_share,
    still_correlation,
    without_common_light,
)
from piv.correlation.correlate import peak_ratios
from piv.correlation.deform import DeformedPair, Frames
from piv.correlation.halving import find_sizes
from piv.correlation.inclined_images import inclination_of
from piv.correlation.judge import judge_vectors
from piv.correlation.passes import MultipassState, search
from piv.correlation.planes import fill_gaps
from piv.correlation.prepare import Pair, check_frames, prepare_pair
from piv.correlation.settings import FOUND_WINDOWS, PivSettings
from piv.correlation.static_light import MOST_STRETCH, stretch_of, stretch_vectors, without_static_waves
from piv.correlation.taken_out import (
    is_measured,
    without_chance_vectors,
    without_masked,
    without_seams,
    without_still,
)
from piv.correlation.vector_field import TRUSTED_SHARE, VectorField
from piv.correlation.windows import window_grid
from piv.errors import PairError
from piv.preprocessing.empty_areas import empty_areas
from piv.preprocessing.hot_pixels import hot_pixels
from piv.preprocessing.still_light import light_beside, still_light, with_clean_rim

BYTES_PER_PX = 65  # of all passes at most, with two threads; 54 with one
# Larger first windows are tried if few places have a vector, and kept if they find more
MIN_VALID_SHARE = 0.8  # of the windows
# Share with a vector, and without, over that of the usual windows
RETRY_GAIN = 1.5
RETRY_LEFT = 0.6
# More vectors moved by more: another pass is worth its time
PASS_CHANGE_PX = 0.25
PASS_CHANGED_SHARE = 0.03
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
    both = frames[0], frames[1]
    searches = [partial(search, *both, seen) for search in (hot_pixels, empty_areas)]
    if still is None:
        searches.append(partial(still_light, [both], seen))
    hot, empty, *found = map_parts(lambda search: search(), searches, threads)
    still = found[0] if found else still
    given = None if valid is None or valid.all() else valid
    if given is not None:
        usable = check_frames(frame_a, frame_b, None)[2]
        valid = with_clean_rim((frames[0], frames[1]), given, usable)
        leaking = light_beside((frames[0], frames[1]), given, usable)
        still = leaking if still is None else still | leaking
    del frames, both, seen, searches, found
    if still is not None:
        valid = ~still if valid is None else valid & ~still
    sides = list(settings.windows_px)
    rim = given if given is not None and valid is not None and (valid & ~given).any() else None
    if hot is not None:
        valid = ~hot if valid is None else valid & ~hot

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
    # Behind still light larger windows show the same.
    is_few = field.valid_share < MIN_VALID_SHARE and field.stretch <= MOST_STRETCH
    for side in _larger(sides[0], min(shape)) if is_few else ():
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
    stretch = None
    if suspect is not None:
        vectors_px = course.found.vectors_px
        known = Known(course.grid, vectors_px, course.found.correlation)
        # Where vectors are long, they tell whether light stands still.
        if not still_share < SUSPECT:
            believed = np.where(course.found.good[..., None], vectors_px, np.nan)
            stretch = stretch_of(suspect, known._replace(vectors_px=believed))
        if not is_damped:
            is_static = None if stretch is None else stretch.is_static
            common = without_common_light(suspect, known, settings.min_valid, threads, is_static)
        if common is not None:
            field = _run_passes(replace(common.pair, given=suspect.given), sides, settings, threads, common)
            return replace(field, nan_pixels=nan_pixels)
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
    field = judge_vectors(course, spread_px2, added, missed_px)
    if common is not None:
        field = without_seams(field, common)
        still_share = common.share
    field = _decimate(replace(field, nan_pixels=nan_pixels, static_share=still_share), every)
    del course
    if is_damped:
        return replace(field, stretch=float("inf") if stretch is None else stretch.factor)
    if suspect is None or stretch is None or not stretch.is_static:
        return field
    share = float(np.nanmax((still_share, stretch.share, 1.0 - 1.0 / stretch.factor)))
    damped = without_static_waves(suspect, stretch)
    again = None if damped is None else _run_passes(damped, sides, settings, threads, is_damped=True)
    return stretch_vectors(replace(field, stretch=stretch.factor, static_share=share), again)


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
