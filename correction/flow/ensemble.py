"""Ensemble correlation: one correlation plane of all pairs, where a single pair has too few particles.

At a rim, near a wall or with thin seeding a window of one pair shows two particles and many wrong peaks. The
sum of its planes over all pairs has one peak. With frames A, B deformed by a displacement (half each),

    R_AB(s) = < sum_x A(x - s/2) B(x + s/2) > - sum_x <A>(x - s/2) <B>(x + s/2),

where what stands still in all frames, <A> and <B>, is taken off. Let f be the mean image of a particle and h
the density of the displacements that are left, then (Scharnowski, Hain, Kaehler, Exp. Fluids 52, 985 (2012))

    R_AB = (f * f) h,  convolved;     R_AA = R_BB = f * f + n K, n noise of the camera.

With Gaussian peaks places and widths add: the mean displacement is the place of R_AB's peak, and the Reynolds
stresses are what its covariance has more than that of R_AA: R_uu, R_vv, R_uv = C_AB - C_AA. Noise of vectors is
not in them, as there are none. A skewed h moves the fitted peak by about a quarter of skewness times deviation.

**Cells.** Products are summed over cells of 8 px; a window of 8, 16 or 32 px is a sum of cells made at the end,
so one sweep serves all. The state is L planes of a number a cell and three mean frames, for any number of
pairs.

**Sweeps.** What deforms the frames must be known before the first pair: the mean of vectors (`sweep_with`),
then what a sweep has found (`next_sweep`). All sums of a sweep can be added, part by part.

**Fields of pairs.** In a turbulent flow h is wide and a window holds few samples of it: the error of the mean
is that of some particles. Frames may therefore be deformed by a field d of their own pair (`Sweep.of_pair`: its
vectors as far as they are flow and not noise). Then h is that of the rest r = u - d alone, and

    mean = <d> + <r>,      R_uu = var(d) + var(r) + 2 cov(d, r),

with cov(d, r) from the sums of d times the templates below, which are linear in r.

**Sigma.** How much Q, the sums of a pair's plane over seven templates (moments of a Gaussian), varies from pair
to pair is summed window by window as a covariance. A change dQ moves the fitted parameters p by (dQ/dp)^(-1)
dQ, hence cov(p) = (dQ/dp)^(-1) N cov(Q) (dQ/dp)^(-T), Q and dQ/dp those of all N pairs: noise, few particles,
and the flow as far as it is in h, are all in it. Pairs count as independent
(`correction.flow.effective_samples` knows better). For stresses it is an upper limit: shapes of particles, that
C_AB and C_AA share, are counted though they drop out.

**Noise.** Sampling between pixels spreads the camera's noise to neighbours, where R_AA would count it as light.
Its shape K(s) is known (`correction.flow.sampled_noise`), how much of it there is comes out of the fit of R_AA.
What is left of it is below 0.02 px^2 with 16 and 32 px; windows of 8 px with a dozen particles in all come out
up to 0.07 px^2 too small.

**Single dead pixels** stay as they were filled. A linear guess from the neighbours has their covariances, so that
the peak stays where it is and its foot keeps its width; only its tip is lower by what was not guessed, which with
20 % of all pixels dead makes stresses 0.05 px^2 too large. Drawing the frames of a pair to each other, as vectors
do (`correction.piv.deform`), would be wrong here: they differ by the fluctuation, which would be halved, and the
mean would move to the sweep's field. Weights of 0 in the gaps leave 0.02 px^2, but a third more noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from correction.errors import SeriesError
from correction.flow.kernels.cell_planes import TEMPLATES, cell_products, template_sums
from correction.flow.sampled_noise import noise_correlation
from correction.piv.deform import deform_pair
from correction.piv.outliers import filled, smoothed
from correction.piv.passes import moved
from correction.piv.prepare import prepared
from correction.piv.windows import WindowGrid
from ground.rows import run_rows

CELL_PX = 8
WINDOWS_PX = (8, 16, 32)  # whose sigma is kept; each a multiple of the cell
LEVEL_PX = 32  # side of the surroundings whose mean is taken off the frames
OWN_REACH_PX = 4  # of the autocorrelation: particle images are small
LEAST_REACH_PX, MOST_REACH_PX = 5, 15
SMOOTH_PX = 6.0  # standard deviation of what smooths a field before it deforms frames
LIKELY, OWN_NOISE_PX = 3.0, 0.05  # standard deviations that a pair may be off the mean; least noise of its vectors
GAP_STEPS, LEAST_AROUND = 1.5, 0.1  # how a pair's own field is continued: standard deviation, and share of vectors
PAIRS_OF_TEMPLATES = np.triu_indices(TEMPLATES)
PARTS = {  # of what is summed for each window, see `EnsembleSums.windows`
    "products": len(PAIRS_OF_TEMPLATES[0]),
    "templates": TEMPLATES,
    "fields": 2,
    "field_products": 3,
    "mixed": 2 * TEMPLATES,
}

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def cells_of(shape: tuple[int, int]) -> WindowGrid:
    """Cells of a frame (H, W), centred in it."""
    row, column = (np.arange(side % CELL_PX // 2, side - CELL_PX + 1, CELL_PX) for side in shape)
    return WindowGrid(row, column, CELL_PX, CELL_PX)


def lags_of(reach_px: int, half: bool = False) -> NDArray[np.int64]:
    """Displacements (L, 2), v and u, up to `reach_px` along each axis; `half`: one of s and -s."""
    side = np.arange(-reach_px, reach_px + 1)
    lags = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    chosen = (lags[:, 0] > 0) | ((lags[:, 0] == 0) & (lags[:, 1] >= 0))
    return np.ascontiguousarray(lags[chosen] if half else lags)


@dataclass(frozen=True)
class Sweep:
    """What must be known before the first pair of a sweep, and be the same for all its parts.

    Parameters
    ----------
    shape : (int, int)
        Of the frames [px].
    field_px : ndarray of float64, shape (ny, nx, 2)
        Displacement u, v at the cells' centres that deforms the frames of a pair without a field, finite.
    energy_px2 : ndarray of float64, shape (ny, nx)
        Mean of R_uu and R_vv as far as they are known, not negative.
    spread_px2 : float
        Variance of a particle image (`correction.piv.prepare`).
    reach_px : int
        Largest displacement left to look at, along each axis.
    """

    shape: tuple[int, int]
    field_px: Floats
    energy_px2: Floats
    spread_px2: float
    reach_px: int

    @property
    def variance_px2(self) -> Singles:
        """Expected variance (ny, nx) of the peak along an axis: that of the templates."""
        return (2.0 * self.spread_px2 + self.energy_px2).astype(np.float32)

    @property
    def cells(self) -> WindowGrid:
        """Where the cells lie."""
        return cells_of(self.shape)

    def of_pair(self, vectors_px: Floats, sigma_px: Floats, good: NDArray[np.bool_], grid: WindowGrid) -> Floats:
        """Field (ny, nx, 2) at the cells that is most likely that of one pair, given its vectors on a grid.

        Each vector's difference from the field of the sweep is taken in the ratio R/(R + sigma^2) in which it is
        flow and not noise; not at all where it is larger than both allow. Where there is none around, the field is
        that of the sweep: a single pair continued over a rim goes astray.

        Parameters
        ----------
        vectors_px, sigma_px : ndarray of float64, shape (ny, nx, 2)
            Displacements and their standard uncertainty.
        good : ndarray of bool, shape (ny, nx)
            Vectors that were measured.
        grid : WindowGrid
            Where they belong.
        """
        energy = np.clip(moved(self.energy_px2[..., None], self.cells, grid)[..., 0], 0.0, None)
        noise = 0.5 * np.square(sigma_px).sum(axis=-1)
        off = vectors_px - moved(self.field_px, self.cells, grid)
        with np.errstate(invalid="ignore"):
            good = good & (np.square(off).sum(axis=-1) < LIKELY**2 * 2.0 * (energy + noise + OWN_NOISE_PX**2))
            flow = energy / (energy + noise + OWN_NOISE_PX**2)
        off = np.where(good[..., None], off * flow[..., None], 0.0)
        around = _blurred(off, GAP_STEPS) / (
            _blurred(good[..., None].astype(np.float64), GAP_STEPS) + LEAST_AROUND
        )
        off = _blurred(np.where(good[..., None], off, around), SMOOTH_PX / grid.step_px)
        return self.field_px + moved(off, grid, self.cells)

    def same(self, other: "Sweep") -> bool:
        """Whether parts of both may be added."""
        arrays = ((self.field_px, other.field_px), (self.energy_px2, other.energy_px2))
        numbers = (self.reach_px, self.spread_px2) == (other.reach_px, other.spread_px2)
        return numbers and all(np.array_equal(one, two) for one, two in arrays)


def sweep_with(
    shape: tuple[int, int], mean_px: Floats, stress_px2: Floats, grid: WindowGrid, spread_px2: float
) -> Sweep:
    """Get ready for a sweep.

    Parameters
    ----------
    shape : (int, int)
        Of the frames [px].
    mean_px : ndarray of float64, shape (ny, nx, 2)
        Mean displacement u, v as far as it is known, on `grid`; NaN elsewhere.
    stress_px2 : ndarray of float64, shape (ny, nx, 3)
        Reynolds stresses as far as they are known.
    grid : WindowGrid
        Where they belong.
    spread_px2 : float
        Variance of a particle image (`correction.piv.prepare`).

    Raises
    ------
    SeriesError
        Not a single mean displacement is known.
    """
    known: NDArray[np.bool_] = np.asarray(np.isfinite(mean_px).all(axis=-1))
    if not known.any():
        raise SeriesError("ensemble correlation begins with the mean of vectors, and there is none; see the pairs")
    cells = cells_of(shape)
    energy = np.clip(0.5 * (stress_px2[..., 0] + stress_px2[..., 1]), 0.0, None)
    told = np.isfinite(energy) & known
    energy = np.where(told, energy, float(np.median(energy[told])) if told.any() else 0.25)
    spread = filled(np.repeat(energy[..., None], 2, axis=-1), np.ones_like(known))[0]
    energy = np.clip(moved(spread, grid, cells)[..., 0], 0.0, None)
    largest = 2.0 * spread_px2 + float(np.percentile(energy, 98))
    reach = int(np.clip(np.ceil(3.0 * np.sqrt(largest)), LEAST_REACH_PX, MOST_REACH_PX))
    smooth = smoothed(np.where(known[..., None], mean_px, 0.0), known, SMOOTH_PX / grid.step_px)
    return Sweep(shape, moved(smooth, grid, cells), energy, spread_px2, reach)


class EnsembleSums:
    """Sums of a sweep over some pairs: a state that grows with no pair and can be stored.

    Parameters
    ----------
    sweep : Sweep
        What all pairs share.
    """

    def __init__(self, sweep: Sweep) -> None:
        self.sweep = sweep
        self.pairs = 0
        ny, nx = sweep.cells.shape
        self.lags, self.own_lags = lags_of(sweep.reach_px), lags_of(OWN_REACH_PX, half=True)
        self.across = np.zeros((ny, len(self.lags), nx), np.float32)
        self.own = np.zeros((ny, len(self.own_lags), nx), np.float32)
        self.noise = np.zeros((ny, len(self.own_lags), nx), np.float32)
        self._usual_noise: Singles | None = None
        self.frames = np.zeros((3, *sweep.shape), np.float32)  # A, B, valid
        self.windows = {
            side: {
                name: np.zeros((size, *windows_of(sweep.field_px[..., 0], side).shape))
                for name, size in PARTS.items()
            }
            for side in WINDOWS_PX
        }

    def add(
        self,
        frame_a: NDArray[Any],
        frame_b: NDArray[Any],
        valid: NDArray[np.bool_] | None = None,
        field_px: Floats | None = None,
        threads: int | None = None,
    ) -> None:
        """Take one pair more.

        Parameters
        ----------
        frame_a, frame_b, valid, threads
            As `correction.piv.pair.evaluate_pair`.
        field_px : ndarray of float64, shape (ny, nx, 2), optional
            Displacement of this very pair, from its vectors by `Sweep.of_pair`; default the sweep's field.

        Raises
        ------
        SeriesError
            Frames of another size than those of the sweep.
        PairError, FrameError
            Two frames that are no pair; the sums are as before.
        """
        if np.shape(frame_a) != self.sweep.shape:
            raise SeriesError(f"a frame of {np.shape(frame_a)} in a series of {self.sweep.shape} (rows, columns)")
        pair = prepared(frame_a, frame_b, valid, LEVEL_PX)
        cells = self.sweep.cells
        field = self.sweep.field_px if field_px is None else field_px
        deformed = deform_pair(pair.coefficients(threads), pair.valid, field, cells, pair.floor, threads)
        ny, nx = cells.shape
        told = np.empty((TEMPLATES, ny, nx), np.float32)
        frames = deformed.a, deformed.b

        def rows(first: int, last: int) -> None:
            line = np.empty(self.sweep.shape[1], np.float32)
            plane, own = np.empty((len(self.lags), nx), np.float32), np.empty((len(self.own_lags), nx), np.float32)
            weight = np.empty((self.sweep.reach_px + 1, nx), np.float32)
            sums = np.empty((TEMPLATES, nx), np.float32)
            for j in range(first, last):
                at = cells.row[j], cells.column[0], CELL_PX
                cell_products(*frames, self.lags, *at, line, plane)
                self.across[j] += plane
                template_sums(plane, self.lags, self.sweep.variance_px2[j], weight, sums)
                told[:, j] = sums
                for frame in frames:
                    cell_products(frame, frame, self.own_lags, *at, line, own)
                    self.own[j] += own

        run_rows(rows, ny, block=2, threads=threads)
        for total, frame in zip(self.frames, (*frames, deformed.valid), strict=True):
            total += frame
        self.noise += self._noise(field_px)
        self._count(told, np.moveaxis(field - self.sweep.field_px, -1, 0))
        self.pairs += 1

    def _noise(self, field_px: Floats | None) -> Singles:
        """What noise correlates with itself (ny, L', nx) in frames deformed by a field, by default the sweep's."""
        if field_px is None and self._usual_noise is not None:
            return self._usual_noise
        field = self.sweep.field_px if field_px is None else field_px
        shape = noise_correlation(field, self.own_lags, self.sweep.spread_px2)
        noise = np.ascontiguousarray(np.moveaxis(shape, 0, 1), np.float32)
        if field_px is None:
            self._usual_noise = noise
        return noise

    def _count(self, told: Singles, off: Floats) -> None:
        """Add up for windows of each side what one pair has to say.

        Parameters
        ----------
        told : ndarray of float32, shape (TEMPLATES, ny, nx)
            Its planes' sums over the templates.
        off : ndarray of float64, shape (2, ny, nx)
            Field that has deformed its frames, less that of the sweep.
        """
        for side, total in self.windows.items():
            q, d = windows_of(told, side).astype(np.float64), middles_of(off, side)
            total["templates"] += q
            total["fields"] += d
            for n, (k, m) in enumerate(zip(*PAIRS_OF_TEMPLATES, strict=True)):
                total["products"][n] += q[k] * q[m]
            for n, (i, j) in enumerate(((0, 0), (1, 1), (0, 1))):
                total["field_products"][n] += d[i] * d[j]
            for i in range(2):
                total["mixed"][i * TEMPLATES : (i + 1) * TEMPLATES] += d[i] * q

    def merged(self, other: "EnsembleSums") -> "EnsembleSums":
        """Sums of both.

        Raises
        ------
        SeriesError
            They belong to different sweeps.
        """
        if not self.sweep.same(other.sweep):
            raise SeriesError("sums of different sweeps of the ensemble correlation cannot be added; begin again")
        both = EnsembleSums.__new__(EnsembleSums)
        both.sweep, both.lags, both.own_lags = self.sweep, self.lags, self.own_lags
        both.pairs = self.pairs + other.pairs
        both.across, both.own = self.across + other.across, self.own + other.own
        both.frames, both.noise = self.frames + other.frames, self.noise + other.noise
        both._usual_noise = self._usual_noise
        both.windows = {
            side: {name: values + other.windows[side][name] for name, values in total.items()}
            for side, total in self.windows.items()
        }
        return both

    def planes(self, threads: int | None = None) -> tuple[Singles, Singles, Singles]:
        """Sums over cells without what stands still: across (ny, L, nx), own (ny, L', nx), pixels (ny, L, nx).

        Raises
        ------
        SeriesError
            Fewer than two pairs.
        """
        if self.pairs < 2:
            raise SeriesError("ensemble correlation needs at least two pairs")
        cells, n = self.sweep.cells, self.pairs
        a, b, valid = self.frames / np.float32(n)
        across, seen, own = np.empty_like(self.across), np.empty_like(self.across), np.empty_like(self.own)
        share, many = (
            np.float32(1.0 / (n - 1)),
            np.float32(n),
        )  # a mean frame holds 1/n of each pair's own products

        def rows(first: int, last: int) -> None:
            line = np.empty(self.sweep.shape[1], np.float32)
            still, one, two = np.empty_like(across[0]), np.empty_like(own[0]), np.empty_like(own[0])
            for j in range(first, last):
                at = cells.row[j], cells.column[0], CELL_PX
                cell_products(a, b, self.lags, *at, line, still)
                cell_products(a, a, self.own_lags, *at, line, one)
                cell_products(b, b, self.own_lags, *at, line, two)
                cell_products(valid, valid, self.lags, *at, line, seen[j])
                across[j] = share * (self.across[j] - many * still)
                own[j] = np.float32(0.5) * share * (self.own[j] - many * (one + two))

        run_rows(rows, cells.shape[0], block=2, threads=threads)
        return across, own, seen

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays by name, for a file; the sweep's among them."""
        arrays: dict[str, NDArray[Any]] = {
            "pairs": np.array(self.pairs),
            "reach_px": np.array(self.sweep.reach_px),
            "field_px": self.sweep.field_px,
            "energy_px2": self.sweep.energy_px2,
            "spread_px2": np.array(self.sweep.spread_px2),
            "across": self.across,
            "own": self.own,
            "noise": self.noise,
            "frames": self.frames,
        }
        return arrays | self._named_windows()

    def _named_windows(self) -> dict[str, Floats]:
        return {f"{name}_{side}": x for side, total in self.windows.items() for name, x in total.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "EnsembleSums":
        """Sums from `to_arrays`, bit for bit.

        Raises
        ------
        SeriesError
            An array is missing, has another shape or kind, or is not finite.
        """
        damaged = SeriesError("sums of an ensemble correlation are damaged or from another version; begin again")
        try:
            reach, pairs, spread = int(arrays["reach_px"]), int(arrays["pairs"]), float(arrays["spread_px2"])
            shape = (int(arrays["frames"].shape[1]), int(arrays["frames"].shape[2]))
            field, energy = (np.asarray(arrays[name], np.float64) for name in ("field_px", "energy_px2"))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise damaged from error
        if pairs < 0 or not 1 <= reach <= MOST_REACH_PX or min(shape) < CELL_PX or max(shape) > 1 << 16:
            raise damaged
        if energy.shape != cells_of(shape).shape or field.shape != (*energy.shape, 2):
            raise damaged
        if not (np.isfinite(field).all() and (energy >= 0.0).all() and np.isfinite(energy).all() and spread > 0.0):
            raise damaged
        sums = cls(Sweep(shape, field, energy, spread, reach))
        sums.pairs = pairs
        targets: dict[str, NDArray[Any]] = {
            "across": sums.across,
            "own": sums.own,
            "noise": sums.noise,
            "frames": sums.frames,
        }
        targets |= sums._named_windows()
        for name, target in targets.items():
            given = np.asarray(arrays.get(name, ()))
            if given.shape != target.shape or given.dtype != target.dtype or not np.isfinite(given).all():
                raise damaged
            target[:] = given
        return sums


def window_cells(side_px: int) -> tuple[int, int]:
    """Cells along a window, and from one to the next: half of it, at least one."""
    many = side_px // CELL_PX
    return many, max(many // 2, 1)


def _blurred(values: Floats, sigma_steps: float) -> Floats:
    blurred: Floats = ndimage.gaussian_filter(values, (sigma_steps, sigma_steps, 0.0), mode="nearest")
    return blurred


def middles_of(cells: NDArray[Any], side_px: int) -> NDArray[Any]:
    """Values (..., ny, nx) at the cells' centres, at the middles of windows: of one cell, or between four."""
    many, step = window_cells(side_px)
    before = (many - 1) // 2
    for axis in (-2, -1):
        first = np.arange(0, max(cells.shape[axis] - many + 1, 0), step) + before
        here = np.take(cells, first, axis=axis)
        cells = here if many % 2 else 0.5 * (here + np.take(cells, first + 1, axis=axis))
    return cells


def windows_of(cells: NDArray[Any], side_px: int) -> NDArray[Any]:
    """Sums over windows of what was summed over cells (..., ny, nx)."""
    many, step = window_cells(side_px)
    for axis in (-2, -1):
        first = np.arange(0, max(cells.shape[axis] - many + 1, 0), step)
        parts = [np.take(cells, first + k, axis=axis) for k in range(many)]
        cells = sum(parts[1:], start=parts[0])
    return cells
