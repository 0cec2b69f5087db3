"""Each place finds its window: what halving it changes.

What a window of twice the size leaves out, or takes for real though it is noise, no statistic of that window says.
Halving it does. Passes with windows of the usual size are followed by two with the finest. Then the frames are
deformed by detail that only the finest have seen, and either match better or not: of what does not match,

    e = (C_after - C_before)/(1 - C_before),

C the correlation around a place, is what halving explains. Where detail was there, that is a fifth to four fifths
(turbulence, short waves); where vectors have only followed their noise it is a twentieth at most. So a place

* takes the finest windows where e exceeds `EXPLAINED`, whatever its noise is said to be: in an unresolved gradient
  that is mostly the flow itself. They must hold `PIECES` particle images or more: with fewer the frames
  match better at the particles, and the vector stands elsewhere;
* goes on from what the usual windows had found everywhere else, so that no noise of small windows gets into it.

**Where nothing is promised.** The second trial can only gain from what the first has seen apart from the usual
vectors: particle images of variance s^2 that come nearer by d match better by d^2/(4 s^2) of themselves. Measured
gains are up to three times that, as fine vectors are smoothed too. So where nowhere in a frame, over one and a
half usual windows, it reaches `PROMISED` of what does not match (s as recorded, for it may be more), that trial
and the pass after it are left out: places keep their usual windows, read from the sums of the first trial, whose
frames usual vectors had deformed.

The last filter (`piv.correlation.denoise`) takes off what is still noise, in both. Windows larger than the usual
ones in poor light were tried: where the flow bends they are far worse, and where it does not that filter does as
well (ADR 39).

**What the usual windows miss.** Where they stay though halving explains something, that much at least is missing
in their vectors. Particle images of variance s^2, as frames are sampled, that are apart by d match to
exp(-d^2/(4 s^2)), so

    r^2 = 2 s^2 (e - e_0)(1 - C_before)/C_after

is the mean square of a component, e_0 what following noise explains. It is the least that `piv.correlation.judge`
says of their resolution: under noise nothing else shows it. By chance e differs from e_0 (`CHANCE` has both,
measured in uniform flows), and where a frame shows no flow half of those differences are positive. So the mean x
of e - e_0 over a usual window, without places that take the finest ones, counts by t^4/(1 + t^4). With x_0 the
chance deviation at one place and x_0/sqrt(2) that of the mean, t = x/(x_0 sqrt(ln N)), as the largest of N windows
of a frame is by chance; or, if that is more, the mean of the whole frame over x_0.

Lepski, Theory Probab. Appl. 35, 454 (1991), on the principle: the largest window that smaller ones do not
contradict.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.correlation.passes import Measured, MultipassState, interpolate_nodes
from piv.correlation.sizes import Sizes, blur_nodes, match_around, variance_px2
from piv.correlation.windows import WindowGrid

PROMISED = 0.05  # of what does not match
WEIGHTS_WIDE = 0.21  # deviation of a window's weights in sides
EXPLAINED = 0.15  # of what does not match: from here on halving counts
CHANCE = (  # variance of a particle image [px^2]; what vectors explain by following their noise, and its deviation
    (0.14, 0.22, 0.4, 1.0, 3.8, 7.9),
    (0.07, 0.045, 0.034, 0.038, 0.043, 0.055),
    (0.025, 0.018, 0.018, 0.025, 0.06, 0.075),
)
PIECES = 3.0  # particle images that the finest windows must hold
JUDGED = 3  # side of what is judged together, in finest windows
LIGHT_CELL_PX = 4  # light is added up over cells about as large as a particle image, at least
# More fine vectors than this share moved by more: another pass
LEFT_PX = 0.1
LEFT_SHARE = 0.03

Floats = NDArray[np.float64]


class Found(NamedTuple):
    """Passes that were added; and what windows of usual size miss as halving shows (ny, nx) [px], 0 of others."""

    added: int
    missed_px: Floats


def find_sizes(course: MultipassState, grid: WindowGrid, spread_px2: float, sampled_px2: float) -> Found:
    """Go on from usual windows with those that each node of `grid` finds.

    Parameters
    ----------
    course : Course
        Passes so far, with windows of usual size.
    grid : WindowGrid
        The finest windows.
    spread_px2, sampled_px2 : float
        Variance of a particle image, as it was recorded and as frames are sampled.
    """
    settings, usual_px = course.settings, course.grid.size_px
    usual = interpolate_nodes(course.predictor(), course.grid, grid)
    course.run_pass(grid)
    before = match_around(course.found.own, grid, JUDGED * grid.size_px, settings.window_sigma)
    if not _gain_to_expect(course.predictor() - usual, before, spread_px2, grid, usual_px):
        course.read_sizes_again(usual, Sizes((grid.size_px, usual_px), np.ones(grid.shape, np.int64)))
        return Found(0, np.zeros(grid.shape))
    course.run_pass(grid)
    after = match_around(course.found.own, grid, JUDGED * grid.size_px, settings.window_sigma)
    explained = (after - before) / np.maximum(1.0 - before, 1e-3)
    fine = (explained > EXPLAINED) & (
        effective_particles(course.deformed.a, grid, settings.window_sigma, spread_px2) >= PIECES
    )
    sizes = Sizes((grid.size_px, usual_px), np.where(fine, 0, 1))
    course.run_pass(grid, np.where(fine[..., None], course.predictor(), usual), sizes)
    added = 0
    while added < settings.extra_passes and _needs_another_pass(course.found):
        course.run_pass(grid, None, sizes)
        added += 1
    flow = clear_share_explained(explained, fine, spread_px2, usual_px / grid.step_px)
    gained = flow * (1.0 - before) / np.maximum(after, 1e-3)
    missed = np.sqrt(2.0 * sampled_px2 * np.clip(gained, 0.0, 1.0))
    return Found(added, np.where(sizes.which == 1, missed, 0.0))


def clear_share_explained(
    explained: Floats, fine: NDArray[np.bool_], spread_px2: float, window_steps: float
) -> Floats:
    """Return the share (ny, nx) that halving explains clearly beyond chance; not negative. See the top.

    Parameters
    ----------
    explained : ndarray of float64, shape (ny, nx)
        What halving explains of what does not match.
    fine : ndarray of bool, shape (ny, nx)
        Places that take the finest windows.
    spread_px2 : float
        Variance of a particle image.
    window_steps : float
        Side of a usual window [grid steps].
    """
    usual, chance = (float(np.interp(spread_px2, CHANCE[0], values)) for values in CHANCE[1:])
    beyond = explained - usual
    sums, weights = (
        scipy.ndimage.gaussian_filter(np.where(fine, 0.0, part), 0.5 * window_steps, mode="nearest")
        for part in (beyond, np.ones_like(beyond))
    )
    mean = np.where(fine, beyond, sums / np.maximum(weights, 1e-3))
    largest = np.sqrt(np.log(max(fine.size / window_steps**2, np.e)))
    field = max(float(beyond[~fine].mean()), 0.0) if not fine.all() else 0.0
    clear = np.square(np.square(np.maximum(np.maximum(mean, 0.0) / largest, field) / chance))
    return np.asarray(np.maximum(mean, 0.0) * clear / (1.0 + clear))


def _gain_to_expect(apart_px: Floats, match: Floats, spread_px2: float, grid: WindowGrid, usual_px: int) -> bool:
    """Return whether a second trial may gain enough, by the difference (ny, nx, 2) that the first found."""
    most = match * np.square(apart_px).sum(axis=-1) / (4.0 * spread_px2 * np.maximum(1.0 - match, 1e-3))
    around = blur_nodes(most, JUDGED * grid.size_px * WEIGHTS_WIDE / grid.step_px)
    side = round(1.5 * usual_px / grid.step_px)
    return bool(scipy.ndimage.binary_opening(around > PROMISED, np.ones((side, side), bool)).any())


def effective_particles(
    frame: NDArray[np.float32], grid: WindowGrid, window_sigma: float, spread_px2: float = 0.0
) -> Floats:
    """Return the number (ny, nx) of particle images of equal light that would make that of each window of `grid`.

    Of N equal ones the light W has a sum whose square is N times the sum of squares.
    """
    import cv2

    cell_px = max(LIGHT_CELL_PX, round(4.0 * float(np.sqrt(spread_px2))))
    height, width = (side // cell_px for side in frame.shape)
    whole = np.square(frame[: height * cell_px, : width * cell_px])
    light = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    reach = float(np.sqrt(variance_px2(grid.size_px, window_sigma))) / cell_px
    seen = np.square(cv2.GaussianBlur(light, (0, 0), reach))  # means under the weights, and under their squares
    squares = cv2.GaussianBlur(np.square(light), (0, 0), reach / np.sqrt(2.0))
    count = 4.0 * np.pi * reach**2 * seen / np.maximum(squares, np.float32(1e-30))
    at = (
        np.clip(((place + 0.5) / cell_px).astype(np.int64), 0, cells - 1)
        for place, cells in ((grid.y_px, height), (grid.x_px, width))
    )
    return np.asarray(count[np.ix_(*at)], np.float64)


def _needs_another_pass(found: Measured) -> bool:
    """Return whether the last pass has still moved more than a few vectors of the finest windows."""
    if found.sizes is None:
        return False
    fine = (found.sizes.which == 0) & np.isfinite(found.left_px).all(axis=-1)
    moved_far = fine & (np.linalg.norm(found.left_px, axis=-1) > LEFT_PX)
    return bool(moved_far.sum() > LEFT_SHARE * found.good.sum())
