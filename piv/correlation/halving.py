"""Each place finds its window: what halving it changes.

What a window of twice the size leaves out, or takes for real though it is noise, no statistic of that window says.
Halving it does. Passes with windows of the usual size are followed by two with the finest. Then the frames are
deformed by detail that only the finest have seen, and either match better or not: of what does not match,

    e = (C_after - C_before)/(1 - C_before),

C the correlation around a place, is what halving explains. Where detail was there, that is half and more
(turbulence, short waves); where vectors have only followed their noise it is a twentieth: two numbers fitted to
the five and more pieces of a window explain that much of anything. It matters little where between them the line
is drawn. So a place

* takes the finest windows where e exceeds a tenth to a fifth, whatever its noise is said to be: in an unresolved
  gradient that is mostly the flow itself;
* goes on from what the usual windows had found everywhere else, so that no noise of small windows gets into it,
  and takes larger ones where these hold too few pieces, or are noisier than `NOISY_PX`: poor light, thin seeding.

The last filter (`piv.correlation.denoise`) takes off what is still noise, in all of them. Lepski, Theory Probab.
Appl. 35, 454 (1991), on the principle: the largest window that smaller ones do not contradict.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.passes import Course, Measured, moved
from piv.correlation.planes import filled
from piv.correlation.refine import Refined
from piv.correlation.sizes import Sizes, leaning_of, widened, widened_sums
from piv.correlation.uncertainty import LARGEST_PX, blocks_of, correlation_statistics, leaning
from piv.correlation.windows import WindowGrid

TRIALS = 2  # passes with the finest windows
EXPLAINED = 0.1, 0.2  # of what does not match: from here on halving counts, and from here on alone
JUDGED = 3  # side of what is judged together, in finest windows
LARGER = 1.5, 2.0  # sides of windows for poor light, in usual ones
NOISY_PX, PIECES = 0.1, 6.0  # noise beyond which, and pieces below which, a window should be larger
LEFT_PX, LEFT_SHARE = 0.1, 0.03  # more fine vectors than this share moved by more: another pass

Floats = NDArray[np.float64]


def find_sizes(course: Course, grid: WindowGrid, spread_px2: float) -> int:
    """Go on from usual windows with those that each node of `grid` finds; returns the passes that were added.

    Parameters
    ----------
    course : Course
        Passes so far, with windows of usual size.
    grid : WindowGrid
        The finest windows.
    spread_px2 : float
        Variance of a particle image.
    """
    settings, usual, usual_px = course.settings, course.predictor(), course.grid.size_px
    usual = moved(usual, course.grid, grid)
    course.look(grid)
    seen = [course.found.refined]
    sides, which = _larger(course, spread_px2, usual_px)
    for _ in range(TRIALS - 1):
        course.look(grid)
        seen.append(course.found.refined)
    fine = explained_share(seen, grid, settings.window_sigma)
    halved = course.predictor()
    sizes = Sizes((grid.size_px, *sides), np.where(fine > 0.5, 0, which + 1))
    course.look(grid, fine[..., None] * halved + (1.0 - fine[..., None]) * usual, sizes)
    course.look(grid, None, sizes)
    added = 0
    while added < settings.extra_passes and _changes(course.found):
        course.look(grid, None, course.found.sizes)
        added += 1
    return added


def explained_share(seen: list[Refined | None], grid: WindowGrid, window_sigma: float) -> Floats:
    """How far (ny, nx), 0 to 1, the finest windows are to be believed, by what two passes with them explain."""
    match = []
    for raw in seen[:2]:
        if raw is None:
            return np.zeros(grid.shape)
        sums = widened_sums(raw.sums[..., [0, 8, 9]].copy(), grid, JUDGED * grid.size_px, window_sigma)
        power = np.sqrt(sums[..., 1] * sums[..., 2])
        match.append(np.divide(sums[..., 0], power, out=np.zeros_like(power), where=power > 0.0))
    before, after = match
    explained = (after - before) / np.maximum(1.0 - before, 1e-3)
    return np.clip((explained - EXPLAINED[0]) / (EXPLAINED[1] - EXPLAINED[0]), 0.0, 1.0)


def _larger(course: Course, spread_px2: float, usual_px: int) -> tuple[tuple[int, ...], NDArray[np.int64]]:
    """Sides from the usual one up and which one (ny, nx) a place needs, told where frames match by usual ones."""
    grid, settings, found, pair = course.grid, course.settings, course.found, course.deformed
    if found.refined is None:
        raise ValueError("sizes are found after passes that refine")
    usual = widened(found.refined, grid, usual_px, settings.window_sigma, pair.floor)
    left, _ = filled(usual.shift_px, found.good & np.isfinite(usual.shift_px).all(axis=-1))
    lean = leaning(blocks_of(pair, spread_px2, course.threads), grid, settings.window_sigma, left)
    which, sides = np.zeros(grid.shape, np.int64), [usual_px]
    for times in LARGER:
        sizes = Sizes((grid.size_px, sides[-1]), np.ones(grid.shape, np.int64))
        raw = widened(found.refined, grid, sides[-1], settings.window_sigma, pair.floor)
        stated = correlation_statistics(leaning_of(lean, grid, sizes, settings.window_sigma), raw)
        noise = np.square(np.nan_to_num(stated.sigma_px, nan=LARGEST_PX)).mean(axis=-1)
        poor = (scipy.ndimage.uniform_filter(noise, 3) > NOISY_PX**2) | (stated.pieces < PIECES)
        which[(which == len(sides) - 1) & poor] = len(sides)
        sides.append(round(times * usual_px / 2) * 2 + usual_px % 2)
    return tuple(sides), scipy.ndimage.median_filter(which, 3)


def _changes(found: Measured) -> bool:
    """Whether the last pass has still moved more than a few vectors of the finest windows."""
    if found.sizes is None:
        return False
    fine = (found.sizes.which == 0) & np.isfinite(found.left_px).all(axis=-1)
    moved_far = fine & (np.linalg.norm(found.left_px, axis=-1) > LEFT_PX)
    return bool(moved_far.sum() > LEFT_SHARE * found.good.sum())
