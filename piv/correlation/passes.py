"""One pass: look at whole windows, or within a pixel of what is known, and say which vectors to believe."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piv.correlation.correlate import correlate_some, correlate_windows, peak_ratios
from piv.correlation.deform import DeformedPair, Frames, deform_pair
from piv.correlation.evidence import WEAK, is_supported_by_peak
from piv.correlation.outliers import outliers
from piv.correlation.planes import smooth_field
from piv.correlation.prepare import Pair
from piv.correlation.refine import Refined, refine
from piv.correlation.response import COARSE, smoothing_after
from piv.correlation.settings import PivSettings
from piv.correlation.sizes import Sizes, choose_sizes
from piv.correlation.windows import WindowGrid, interpolate
from piv.errors import PairError

HALVED_PX = 64  # first windows of this side are looked at in frames of half the resolution
LEAST_CORRELATION = (
    0.5  # with less, what lies in the middle may be there by chance; later passes: times the usual one
)

Floats = NDArray[np.float64]
NOTHING = np.empty((0, 0), np.float32)


class Measured(NamedTuple):
    """Result of a pass: vectors_px, seen_px, left_px (ny, nx, 2), the others (ny, nx).

    seen_px is what whole windows showed where they were asked, even if their peak was one of many, and elsewhere
    the vectors. `refined` is what windows of the nodes' sizes showed, `own` what those of the grid did; None of
    a pass that has searched. `sizes` is None where all windows are those of the grid.
    """

    vectors_px: Floats
    seen_px: Floats
    correlation: Floats
    peak_ratio: Floats
    valid_fraction: Floats
    good: NDArray[np.bool_]
    left_px: Floats
    refined: Refined | None
    own: Refined | None = None
    sizes: Sizes | None = None


@dataclass
class MultipassState:
    """Passes of one pair, one after another.

    Parameters
    ----------
    frames : Frames
        What is sampled.
    settings : PivSettings
        How.
    threads : int or None
        Threads to use.
    grid : WindowGrid
        Windows of the last pass.
    found : Measured
        What it has found.
    deformed : DeformedPair
        Frames that it looked at.
    number : int
        Passes so far that have refined.
    """

    frames: Frames
    settings: PivSettings
    threads: int | None
    grid: WindowGrid
    found: Measured
    deformed: DeformedPair
    number: int = 0

    def predictor(self, sizes: Sizes | None = None) -> Floats:
        """Return the vectors (ny, nx, 2) of the last pass, smoothed for its windows, or for `sizes`."""
        vectors, good, grid = self.found.vectors_px, self.found.good, self.grid

        def smoothing(side_px: int) -> tuple[float, int]:
            return smoothing_after(self.number, side_px, grid.step_px, self.settings)

        if sizes is not None:
            return sizes.smooth_field(vectors, good, smoothing)
        return smooth_field(vectors, good, *smoothing(grid.size_px))

    def run_pass(self, grid: WindowGrid, predictor: Floats | None = None, sizes: Sizes | None = None) -> None:
        """Make one more pass with the windows of `grid`, or with the sizes that its nodes have.

        `predictor` (ny, nx, 2) is on the last pass's grid; default what that one says.
        """
        predictor = self.predictor(sizes) if predictor is None else predictor
        before, self.number = self.grid, self.number + 1
        frames, settings = self.frames, self.settings
        self.deformed = self.deformed._replace(a=NOTHING, b=NOTHING, valid=NOTHING)  # 12 bytes a pixel, not 24
        filled = frames.filled if self.number >= COARSE else None  # frames complete each other where they match
        self.deformed = deform_pair(
            frames.coefficients, frames.valid, predictor, before, frames.floor, self.threads, filled
        )._replace(inclination=frames.inclination)
        predictor, self.grid = interpolate_nodes(predictor, before, grid), grid
        self.found = refine_pass(self.deformed, grid, predictor, self.number == 1, settings, self.threads, sizes)

    def read_sizes_again(self, predictor: Floats, sizes: Sizes) -> None:
        """Read the last pass with the sizes that its nodes have: of the frames that `predictor` has deformed."""
        found = self.found.own
        self.found = refine_pass(
            self.deformed, self.grid, predictor, self.number == 1, self.settings, self.threads, sizes, found
        )


def search(pair: Pair, grid: WindowGrid, settings: PivSettings, threads: int | None) -> Measured:
    """Look at whole windows; large ones at half the resolution, since only whole pixels count yet."""
    halves = grid.size_px >= HALVED_PX and len(settings.windows_px) > 1
    half = WindowGrid(grid.row // 2, grid.column // 2, grid.size_px // 2, grid.step_px // 2) if halves else grid
    seen = pair.half_resolution() if halves else pair
    frames = DeformedPair(seen.a, seen.b, seen.valid, seen.floor)
    raw = correlate_windows(frames, half, settings.support, threads)
    seen_px = np.where(_is_supported(raw.valid_fraction, settings)[..., None], raw.shift_px, np.nan)
    good, ratio = _accept_vectors(seen_px, np.full(grid.shape, np.nan), frames, half, settings, threads)
    shift = seen_px * (2.0 if halves else 1.0)
    return Measured(shift, shift, raw.correlation, ratio, raw.valid_fraction, good, shift, None)


def refine_pass(
    pair: DeformedPair,
    grid: WindowGrid,
    predictor: Floats,
    is_first: bool,
    settings: PivSettings,
    threads: int | None,
    sizes: Sizes | None = None,
    own: Refined | None = None,
) -> Measured:
    """Look within a pixel, and at whole windows where no peak is there or little correlates.

    `own` is what windows of the grid show, where that is known already.

    What is little depends on the frames, but in the first pass of this kind nothing is known of them: a predictor
    may be wrong everywhere.
    """
    own = refine(pair, grid, settings.window_sigma, threads) if own is None else own
    raw = own
    if sizes is not None:
        raw = choose_sizes(own, sizes, grid, settings.window_sigma, pair.floor)
    shift, ratio = raw.shift_px.copy(), np.full(grid.shape, np.nan)
    if pair.inclination is not None:
        shift = pair.inclination.solve(shift, grid)
    dense = _is_supported(raw.valid_fraction, settings)
    shift[~dense] = np.nan
    known = raw.correlation[dense & np.isfinite(raw.correlation)]  # constant windows have none
    least = LEAST_CORRELATION * (1.0 if is_first or not known.size else float(np.median(known)))
    lost = dense & (np.isnan(shift).any(axis=-1) | (raw.correlation < least))
    seen = predictor + shift
    if lost.any() and pair.worth is None:  # frames that complete each other match in the middle, always
        found, ratio[lost] = correlate_some(pair, grid, lost, settings.support, threads)
        seen[lost] = predictor[lost] + found
        # Not where it was expected, and one of many; what lies in the middle may be right in later passes.
        is_weak = ratio[lost] < WEAK
        found[is_weak] = np.nan if is_first else shift[lost][is_weak]
        shift[lost] = found
    if dense.any() and not np.isfinite(shift).any():
        raise PairError("no window shows a peak that stands out; check exposure, seeding and pairing")
    vectors = predictor + shift
    good, ratio = _accept_vectors(vectors, ratio, pair, grid, settings, threads, sizes)
    return Measured(vectors, seen, raw.correlation, ratio, raw.valid_fraction, good, shift, raw, own, sizes)


def _is_supported(valid_fraction: Floats, settings: PivSettings) -> NDArray[np.bool_]:
    """Windows (ny, nx) with enough light for the field; none where no window has enough for a vector."""
    enough = (valid_fraction >= settings.min_valid).any()
    return np.asarray((valid_fraction >= settings.support) & enough)


def _accept_vectors(
    vectors: Floats,
    ratio: Floats,
    pair: DeformedPair,
    grid: WindowGrid,
    settings: PivSettings,
    threads: int | None,
    sizes: Sizes | None = None,
) -> tuple[NDArray[np.bool_], Floats]:
    """Vectors that were measured and fit their neighbours, or are proven by their own peak; and peak ratios."""
    candidates: NDArray[np.bool_] = np.all(np.isfinite(vectors), axis=-1)
    suspects = _suspects(vectors, candidates, grid, settings, sizes, threads)
    good = candidates & ~suspects
    unknown = suspects & np.isnan(ratio)
    if unknown.any():
        ratio = np.where(unknown, peak_ratios(pair, grid, unknown, settings.support, threads), ratio)
    if suspects.any():
        good |= is_supported_by_peak(vectors, candidates, suspects, ratio, grid.size_px)
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


def _suspects(
    vectors: Floats,
    candidates: NDArray[np.bool_],
    grid: WindowGrid,
    settings: PivSettings,
    sizes: Sizes | None,
    threads: int | None,
) -> NDArray[np.bool_]:
    """Vectors (ny, nx) that their neighbours contradict: those half a window away, as nearer ones see the same."""
    apart = [1] if sizes is None else [max(1, round(0.5 * side / grid.step_px)) for side in sizes.sides_px]
    found = np.zeros(grid.shape, bool)
    for steps in sorted(set(apart)):
        here = np.array(apart)[sizes.which] == steps if sizes is not None else candidates
        if not here.any():
            continue
        for part in np.ndindex(steps, steps):
            every = tuple(slice(first, None, steps) for first in part)
            if here[every].any():
                limits = settings.outlier_threshold, settings.outlier_epsilon_px
                found[every] |= here[every] & outliers(vectors[every], candidates[every], *limits, threads)
    return found


def interpolate_nodes(field: NDArray[np.float64], source: WindowGrid, target: WindowGrid) -> NDArray[np.float64]:
    """Field on the nodes of one grid, interpolated at the nodes of another."""
    if source is target or (np.array_equal(source.row, target.row) and source.size_px == target.size_px):
        return field
    along_u = interpolate(field, 1, source.x_px, target.x_px, source.step_px)
    return interpolate(along_u, 0, source.y_px, target.y_px, source.step_px)
