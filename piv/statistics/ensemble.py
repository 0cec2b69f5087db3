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

Products are summed over cells (`piv.statistics.cells`) of frames that are deformed by what is known before
(`piv.statistics.sweep`). The state is L planes of a number a cell and three mean frames, for any number of pairs;
all sums of a sweep can be added, part by part.

**Fields of pairs.** In a turbulent flow h is wide and a window holds few samples of it: the error of the mean
is that of some particles. Frames may therefore be deformed by a field d of their own pair (`Sweep.of_pair`: its
vectors as far as they are flow and not noise). Then h is that of the rest r = u - d alone, and

    mean = <d> + <r>,      R_uu = var(d) + var(r) + 2 cov(d, r),

with cov(d, r) from sums of d times the planes of r. These are products of cells, not of windows: d bends within a
window, and what it takes there from r is not in its value at the middle (half of a wave of 40 px in d: stresses
0.4 of themselves too small in windows of 32 px).

**Noise that a field follows.** A pair's vector errs by e, towards the noise N of the correlation in which it was
looked for. d has a share of e, so the plane that it shifts has that noise near its middle, in every pair: the sum
gains <d_c dN/ds_c> and its peak is too narrow. With M_c the sum of d_c times the planes, this gain is the sum over
c of dM_c/ds_c. A rest r that d has a part of stands in M as well, and of it that derivative has the covariance

    2 cov(d, r) = -V[sum_c dM_c/ds_c],

V what the fit makes of a change of the plane. Taken so, the noise of both terms cancels to first order. V is a sum
over templates, so the derivative goes to them, and sums over their third moments are kept as well. By the first
moments of the planes cov(d, r) had all of the noise and var(r), seen under a Gaussian, not: 1.5 to 2 times sigma^2
of vectors stayed in normal stresses, 6 to 10 % of those over a wall that shines (ADR 17).

**Sigma.** How much Q, the sums of a pair's plane over seven templates (moments of a Gaussian), varies from pair
to pair is summed window by window as a covariance. A change dQ moves the fitted parameters p by (dQ/dp)^(-1)
dQ, hence cov(p) = (dQ/dp)^(-1) N cov(Q) (dQ/dp)^(-T), Q and dQ/dp those of all N pairs: noise, few particles,
and the flow as far as it is in h, are all in it. Pairs count as independent
(`piv.statistics.effective_samples` knows better). For stresses it is an upper limit: shapes of particles, that
C_AB and C_AA share, are counted though they drop out.

**Noise.** Sampling between pixels spreads the camera's noise to neighbours, where R_AA would count it as light.
Its shape K(s) is known: white noise of variance 1 that is sampled at a fraction f of a pixel through an
interpolation h_f correlates with itself over K(s) = sum_k h_f(k) h_f(k + s). Frames are sampled through c (1 -
m) + b m, the cardinal spline and the B-spline of degree 5 mixed by the size of the particle images
(`piv.correlation.prepare`), both products of a factor along u and one along v. Frame A is sampled at -d/2 and
frame B at d/2: K is the same for both. How much there is, n, does not follow from R_AA: where particle images
are small, K is as wide as their peak, and a fit of both at once took light for noise (particles of 2.4 px:
stresses 0.03 to 0.05 px^2 too small, of 1.6 px 0.3). It comes from the frames before they are deformed, where
noise stands at no displacement only: what their autocorrelation has there beyond the Gaussian through its next
displacements, averaged over `AROUND_PX`. What is left is 0.002 px^2 with particle images of 2 to 9 px, 0.007
where noise has 0.8 of the light's variance. Where frames are blurred before they are sampled, which images of
1.6 px or noise that hides their size lead to, stresses are too small by 0.03 to 0.4 px^2.

**Shape.** No peak is quite a Gaussian, and what a fit makes of it depends on where it looks. R_AA is fitted at
the displacements of R_AB, s and -s: at fewer of them, or at one half, stresses were off by 0.01 to 0.07 px^2
with particle images of 2.4 to 6 px.

**Walls that are not in a mask.** A bright wall stands still, and nothing is left across the frames of a pair when
that is taken off, while its grain, which flickers, is left in R_AA: windows that hold some of it had stresses
0.05 to 0.15 px^2 too small, and in the wall itself half of them a mean. So cells are solid in which a part of
the light stands still and what does not has no partner (`piv.statistics.ensemble_field`); they belong to no
window, and the next sweep masks them.

**Single dead pixels** stay as they were filled. A linear guess from the neighbours has their covariances, so that
the peak stays where it is and its foot keeps its width; only its tip is lower by what was not guessed, which with
20 % of all pixels dead makes stresses 0.05 px^2 too large. Drawing the frames of a pair to each other, as vectors
do (`piv.correlation.deform`), would be wrong here: they differ by the fluctuation, which would be halved, and the
mean would move to the sweep's field. Weights of 0 in the gaps leave 0.02 px^2, but a third more noise.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.deform import deform_pair
from piv.correlation.prepare import SHARPEST, SMOOTHEST, prepare_pair
from piv.errors import SeriesError
from piv.statistics.cells import CELL_PX, WINDOWS_PX, cells_of, lags_of, windows_of
from piv.statistics.kernels.cell_planes import CUBIC, TEMPLATES, cell_products, template_sums
from piv.statistics.sweep import LEAST_REACH_PX, MOST_REACH_PX, Sweep

SPLINE_DEGREE = 5
SHIFT_FRACTIONS = 33  # of a pixel that are tabulated
CARDINAL_PX = 20  # pixels to each side after which a cardinal spline is none any more


LEVEL_PX = 32  # side of the surroundings whose mean is taken off the frames
RAW_REACH_PX = 2  # of that of frames as they are, which tells noise
AROUND_PX = 40  # over which noise is averaged: it changes as slowly as the light
PAIRS_OF_TEMPLATES = np.triu_indices(TEMPLATES)
PARTS = {  # of what is summed for each window, see `EnsembleSums.windows`
    "products": len(PAIRS_OF_TEMPLATES[0]),
    "templates": TEMPLATES,
}
CELL_PARTS = {  # and for each cell, see `EnsembleSums.cells`
    "templates": TEMPLATES + CUBIC,
    "fields": 2,
    "field_products": 3,
    "mixed": 2 * (TEMPLATES + CUBIC),
}
PRODUCTS_OF_FIELDS = ((0, 0), (1, 1), (0, 1))
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def noise_correlation(field_px: Floats, lags: NDArray[np.int64], spread_px2: float) -> Floats:
    """K (L, ny, nx) at displacements (L, 2), v and u, for frames deformed by a field (ny, nx, 2)."""
    return _mix(_noise_parts(field_px, lags), spread_px2)


def _mix(parts: Floats, spread_px2: float) -> Floats:
    """K (L, ny, nx) from its parts, for frames whose particle images have a variance."""
    mix = float(np.clip((SMOOTHEST - spread_px2) / (SMOOTHEST - SHARPEST), 0.0, 1.0))
    return np.asarray(np.tensordot([(1 - mix) ** 2, mix * (1 - mix), mix**2], parts, axes=1))


def _noise_parts(field_px: Floats, lags: NDArray[np.int64]) -> Floats:
    """Parts (3, L, ny, nx) of K: of the cardinal spline, of both splines (twice), of the B-spline."""
    place = (0.5 * field_px) % 1.0 * (SHIFT_FRACTIONS - 1)
    first = np.minimum(place.astype(np.int64), SHIFT_FRACTIONS - 2)
    rest = place - first
    own, across, smooth = _spline_tables(int(np.abs(lags).max()))
    result = np.zeros((3, len(lags), *field_px.shape[:2]))
    for n, (v, u) in enumerate(lags):
        for part, table, way in ((0, own, 1), (1, across, 1), (1, across, -1), (2, smooth, 1)):
            along, down = (
                table[first[..., axis], middle] * (1.0 - rest[..., axis])
                + table[first[..., axis] + 1, middle] * rest[..., axis]
                for axis, middle in ((0, way * u + table.shape[1] // 2), (1, way * v + table.shape[1] // 2))
            )
            result[part, n] += along * down
    return result


@cache
def _spline_tables(reach: int) -> tuple[Floats, Floats, Floats]:
    """Correlations (FRACTIONS, 2 reach + 1) of c with c, c with b and b with b, along one axis."""
    impulse = np.zeros(2 * CARDINAL_PX + 1)
    impulse[CARDINAL_PX] = 1.0
    cardinal = scipy.ndimage.spline_filter1d(impulse, SPLINE_DEGREE, mode="mirror")
    basis = scipy.interpolate.BSpline.basis_element(
        np.arange(SPLINE_DEGREE + 2.0) - 0.5 * (SPLINE_DEGREE + 1), extrapolate=False
    )
    at = np.arange(-CARDINAL_PX, CARDINAL_PX + 1.0)
    tables = np.empty((3, SHIFT_FRACTIONS, 2 * reach + 1))
    for n, fraction in enumerate(np.linspace(0.0, 1.0, SHIFT_FRACTIONS)):
        b = np.nan_to_num(basis(at + fraction))
        c = np.convolve(cardinal, b, mode="same")
        for table, (one, two) in zip(tables, ((c, c), (c, b), (b, b)), strict=True):
            middle = len(at) - 1
            table[n] = np.correlate(two, one, mode="full")[middle - reach : middle + reach + 1]
    return tables[0], tables[1], tables[2]


class Planes(NamedTuple):
    """Sums over cells (ny, number of displacements, nx) of a pair, without what stands still in all.

    across, own, raw: products across both frames, of each deformed frame with itself, of each as it is; seen:
    pixels for the first. still (ny, nx) is the share of the squares of frames as they are that stands still.
    """

    across: Singles
    own: Singles
    raw: Singles
    seen: Singles
    still: Singles


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
        self.lags, self.own_lags = lags_of(sweep.reach_px), lags_of(sweep.own_reach_px, half=True)
        self.raw_lags = lags_of(RAW_REACH_PX, half=True)
        self.across = np.zeros((ny, len(self.lags), nx), np.float32)
        self.own = np.zeros((ny, len(self.own_lags), nx), np.float32)
        self.raw = np.zeros((ny, len(self.raw_lags), nx), np.float32)
        self.noise = np.zeros((ny, len(self.own_lags), nx), np.float32)
        self._usual_noise: Floats | None = None
        self._fluid_px = sweep.fluid_px
        self.frames = np.zeros((5, *sweep.shape), np.float32)  # A, B, as they are A, B, valid
        self.cells = {name: np.zeros((size, ny, nx)) for name, size in CELL_PARTS.items()}
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
            As `piv.correlation.pair.evaluate_pair`.
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
        fluid = self._fluid_px
        if fluid is not None:
            valid = fluid if valid is None else valid & fluid
        pair = prepare_pair(frame_a, frame_b, valid, LEVEL_PX)
        cells = self.sweep.cells
        field = self.sweep.field_px if field_px is None else field_px
        # What is left of the displacement is small, so products are needed up to a few pixels only.
        deformed = deform_pair(pair.coefficients(threads), pair.valid, field, cells, pair.floor, threads)
        ny, nx = cells.shape
        by_template = np.empty((TEMPLATES + CUBIC, ny, nx), np.float32)
        frames = deformed.a, deformed.b
        as_they_are = pair.a * deformed.valid, pair.b * deformed.valid

        def rows(first: int, last: int) -> None:
            line = np.empty(self.sweep.shape[1], np.float32)
            plane, own, raw = (
                np.empty((len(lags), nx), np.float32) for lags in (self.lags, self.own_lags, self.raw_lags)
            )
            weight = np.empty((self.sweep.reach_px + 1, nx), np.float32)
            sums = np.empty((TEMPLATES + CUBIC, nx), np.float32)
            for j in range(first, last):
                at = cells.row[j], cells.column[0], CELL_PX
                cell_products(*frames, self.lags, *at, line, plane)
                self.across[j] += plane
                # A few numbers a pair tell the scatter of what is fitted; no plane has to be kept.
                template_sums(plane, self.lags, self.sweep.variance_px2[j], weight, sums)
                by_template[:, j] = sums
                for frame in frames:
                    cell_products(frame, frame, self.own_lags, *at, line, own)
                    self.own[j] += own
                for frame in as_they_are:
                    cell_products(frame, frame, self.raw_lags, *at, line, raw)
                    self.raw[j] += raw

        run_rows(rows, ny, block=2, threads=threads)
        for total, frame in zip(self.frames, (*frames, *as_they_are, deformed.valid), strict=True):
            total += frame
        self.noise += self._noise(field_px, pair.spread_px2)
        self._count(by_template, np.moveaxis(field - self.sweep.field_px, -1, 0))
        self.pairs += 1

    def _noise(self, field_px: Floats | None, spread_px2: float) -> Singles:
        """Correlation (ny, L', nx) of noise with itself in frames deformed by a field, by default the sweep's."""
        if field_px is None:
            if self._usual_noise is None:
                self._usual_noise = _noise_parts(self.sweep.field_px, self.own_lags)
            parts = self._usual_noise
        else:
            parts = _noise_parts(field_px, self.own_lags)
        return np.ascontiguousarray(np.moveaxis(_mix(parts, spread_px2), 0, 1), np.float32)

    def _count(self, by_template: Singles, off: Floats) -> None:
        """Add up for cells, and for windows of each side, what one pair has to say.

        Parameters
        ----------
        by_template : ndarray of float32, shape (TEMPLATES + CUBIC, ny, nx)
            Its planes' sums over the templates.
        off : ndarray of float64, shape (2, ny, nx)
            Field that has deformed its frames, less that of the sweep.
        """
        for side, total in self.windows.items():
            q = windows_of(by_template[:TEMPLATES], side).astype(np.float64)
            total["templates"] += q
            for n, (k, m) in enumerate(zip(*PAIRS_OF_TEMPLATES, strict=True)):
                total["products"][n] += q[k] * q[m]
        self.cells["templates"] += by_template
        self.cells["fields"] += off
        for n, (i, j) in enumerate(PRODUCTS_OF_FIELDS):
            self.cells["field_products"][n] += off[i] * off[j]
        for i in range(2):
            self.cells["mixed"][i * len(by_template) : (i + 1) * len(by_template)] += off[i] * by_template

    def merge_with(self, other: "EnsembleSums") -> "EnsembleSums":
        """Sums of both.

        Raises
        ------
        SeriesError
            They belong to different sweeps.
        """
        if not self.sweep.same(other.sweep):
            raise SeriesError("sums of different sweeps of the ensemble correlation cannot be added; begin again")
        both = EnsembleSums.__new__(EnsembleSums)
        both.sweep, both.lags, both.own_lags, both.raw_lags = self.sweep, self.lags, self.own_lags, self.raw_lags
        both.pairs = self.pairs + other.pairs
        both.across, both.own, both.raw = self.across + other.across, self.own + other.own, self.raw + other.raw
        both.frames, both.noise = self.frames + other.frames, self.noise + other.noise
        both._usual_noise, both._fluid_px = self._usual_noise, self._fluid_px
        both.cells = {name: values + other.cells[name] for name, values in self.cells.items()}
        both.windows = {
            side: {name: values + other.windows[side][name] for name, values in total.items()}
            for side, total in self.windows.items()
        }
        return both

    def planes(self, threads: int | None = None) -> Planes:
        """Sums over cells without what stands still.

        Raises
        ------
        SeriesError
            Fewer than two pairs.
        """
        if self.pairs < 2:
            raise SeriesError("ensemble correlation needs at least two pairs")
        cells, n = self.sweep.cells, self.pairs
        a, b, raw_a, raw_b, valid = self.frames / np.float32(n)
        across, seen = np.empty_like(self.across), np.empty_like(self.across)
        own, raw = np.empty_like(self.own), np.empty_like(self.raw)
        # A mean frame holds 1/n of each pair's own products.
        share, many = np.float32(1.0 / (n - 1)), np.float32(n)

        def rows(first: int, last: int) -> None:
            line = np.empty(self.sweep.shape[1], np.float32)
            still = np.empty_like(across[0])
            for j in range(first, last):
                at = cells.row[j], cells.column[0], CELL_PX
                cell_products(a, b, self.lags, *at, line, still)
                across[j] = share * (self.across[j] - many * still)
                for sums, lags, frames, out in (
                    (self.own, self.own_lags, (a, b), own),
                    (self.raw, self.raw_lags, (raw_a, raw_b), raw),
                ):
                    one, two = np.empty_like(out[0]), np.empty_like(out[0])
                    cell_products(frames[0], frames[0], lags, *at, line, one)
                    cell_products(frames[1], frames[1], lags, *at, line, two)
                    out[j] = np.float32(0.5) * share * (sums[j] - many * (one + two))
                cell_products(valid, valid, self.lags, *at, line, seen[j])

        run_rows(rows, cells.shape[0], block=2, threads=threads)
        middle = int(np.flatnonzero((self.raw_lags == 0).all(axis=-1))[0])
        whole = self.raw[:, middle] * np.float32(0.5 / n)
        still = np.where(whole > 0.0, 1.0 - raw[:, middle] / np.where(whole > 0.0, whole, 1.0), 0.0)
        return Planes(across, own, raw, seen, still.astype(np.float32))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays by name, for a file; the sweep's among them."""
        arrays: dict[str, NDArray[Any]] = {
            "pairs": np.array(self.pairs),
            "reach_px": np.array(self.sweep.reach_px),
            "field_px": self.sweep.field_px,
            "energy_px2": self.sweep.energy_px2,
            "spread_px2": np.array(self.sweep.spread_px2),
            "solid": self.sweep.solid,
            "across": self.across,
            "own": self.own,
            "raw": self.raw,
            "noise": self.noise,
            "frames": self.frames,
        }
        return arrays | self._sums_by_name()

    def _sums_by_name(self) -> dict[str, Floats]:
        of_windows = {f"{name}_{side}": x for side, total in self.windows.items() for name, x in total.items()}
        return of_windows | {f"{name}_of_cells": values for name, values in self.cells.items()}

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
            solid = np.asarray(arrays["solid"])
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise damaged from error
        if (
            pairs < 0
            or not LEAST_REACH_PX <= reach <= MOST_REACH_PX
            or min(shape) < CELL_PX
            or max(shape) > 1 << 16
        ):
            raise damaged
        if energy.shape != cells_of(shape).shape or field.shape != (*energy.shape, 2):
            raise damaged
        if solid.shape != energy.shape or solid.dtype != np.bool_:
            raise damaged
        if not (np.isfinite(field).all() and (energy >= 0.0).all() and np.isfinite(energy).all() and spread > 0.0):
            raise damaged
        sums = cls(Sweep(shape, field, energy, spread, reach, solid))
        sums.pairs = pairs
        targets: dict[str, NDArray[Any]] = {
            "across": sums.across,
            "own": sums.own,
            "raw": sums.raw,
            "noise": sums.noise,
            "frames": sums.frames,
        }
        targets |= sums._sums_by_name()
        for name, target in targets.items():
            given = np.asarray(arrays.get(name, ()))
            if given.shape != target.shape or given.dtype != target.dtype or not np.isfinite(given).all():
                raise damaged
            target[:] = given
        return sums
