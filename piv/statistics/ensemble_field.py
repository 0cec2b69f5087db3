"""Mean displacement and Reynolds stresses from the sums of an ensemble correlation; theory: see `ensemble`.

**Cells that show something solid**, which shines, and no flow (`solid_cells`). Together three things tell a bright
wall from a flow: dust on the glass stands still, with particles moving behind it; where particles leave the sheet
they have no partner; what is dark shows neither.

* A share of the light's squares stands still in all pairs, taken off frames as they are: in a wall 0.97, and 0.6
  when the sliding minimum of its frames is off and only the flicker of the laser is left of it.
* Of what does not stand still little has a partner in the other frame: the sum of R_AB over that of R_AA, about no
  displacement, is a small part of what is usual in the frame: 0.07 to 0.17 of it in walls, 0.66 in the first 8 px
  beside one that glares, 0.2 where four of five particles leave the sheet.
* A wall is large: cells count that make up squares of 2 x 2. A grain of dust is in one.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.cut_windows import cut_px
from piv.correlation.outliers import outliers
from piv.correlation.planes import fill_gaps
from piv.correlation.resolution import second_differences
from piv.correlation.windows import WindowGrid
from piv.errors import SeriesError
from piv.statistics.cells import CELL_PX, WINDOWS_PX, middles_of, window_cells, windows_of
from piv.statistics.ensemble import AROUND_PX, PAIRS_OF_TEMPLATES, PRODUCTS_OF_FIELDS, EnsembleSums, Planes
from piv.statistics.kernels.cell_planes import TEMPLATES
from piv.statistics.kernels.peak_fit import PARAMETERS, fit_row
from piv.statistics.sweep import Sweep, sweep_with

LEAST_VALID = 0.3  # share of a window's pixels
LEAST_ALIKE = 0.1  # of the usual share of particles that stay: less is noise of something that shines
LARGEST_SIGMA_PX = 0.5  # of a mean that is worth being called one
FEWEST_PAIRS = 8  # of solid cells: fewer stand still by chance
LEAST_STILL, MOST_ALIKE = 0.25, 0.25  # of the light's squares; of the usual share with a partner
NEAR_PX, USUAL = 2, 75.0  # displacements that are summed; percentile over the cells
# Times what a window averages out: second differences lack it, too (layers and waves of 40 to 80 px)
MISSED = 1.3
THRESHOLD, EPSILON_PX = 3.0, 0.1  # of the universal outlier detection, as for single pairs

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class EnsembleField:
    """Mean field of an ensemble correlation; all arrays (ny, nx) or (ny, nx, k), NaN where not `valid`.

    Parameters
    ----------
    grid : WindowGrid
        Its windows.
    mean_px : ndarray of float64, shape (ny, nx, 2)
        Mean displacement, u right and v down.
    stress_px2 : ndarray of float64, shape (ny, nx, 3)
        Reynolds stresses R_uu, R_vv, R_uv; free of the noise of correlation.
    sigma_px, stress_sigma_px2 : ndarray of float64, shapes (ny, nx, 2), (ny, nx, 3)
        Random standard uncertainties of both, for independent pairs; of stresses with what windows average out of
        the mean.
    resolution_px : ndarray of float64, shape (ny, nx)
        Standard uncertainty of a component of the mean by what windows do not resolve; no number of pairs makes it
        less.
    correlation : ndarray of float64, shape (ny, nx)
        Volume of the peak over that of the autocorrelation: the share of particles that stay.
    valid : ndarray of bool, shape (ny, nx)
        Windows with a clear peak that fits its neighbours.
    pairs : int
        Pairs in the sums.
    solid : ndarray of bool
        Cells of the sweep that are solid (`solid_cells`), with those that were known before.
    """

    grid: WindowGrid
    mean_px: Floats
    stress_px2: Floats
    sigma_px: Floats
    stress_sigma_px2: Floats
    resolution_px: Floats
    correlation: Floats
    valid: NDArray[np.bool_]
    pairs: int
    solid: NDArray[np.bool_]


def ensemble_field(sums: EnsembleSums, window_px: int, threads: int | None = None) -> EnsembleField:
    """Read the sums with windows of a side, 50 % overlapping (those of one cell: side by side).

    Raises
    ------
    SeriesError
        Fewer than two pairs, a side that was not kept, or frames smaller than a window.
    """
    if window_px not in WINDOWS_PX:
        raise SeriesError(f"windows of {window_px} px were not kept; choose one of {WINDOWS_PX}")
    cells, (many, step) = sums.sweep.cells, window_cells(window_px)
    if min(cells.shape) < many:
        raise SeriesError(f"a window of {window_px} px does not fit frames of {sums.sweep.shape} px")
    row, column = (places[: len(places) - many + 1 : step] for places in (cells.row, cells.column))
    grid = WindowGrid(row, column, window_px, step * CELL_PX)
    planes = sums.planes(threads)
    fluid = ~solid_cells(sums, planes)
    # Cells become windows; solid ones belong to none.
    across, own, raw, seen = (
        windows_of(np.moveaxis(part * fluid[:, None], 1, 0), window_px) for part in planes[:4]
    )
    middle = len(sums.lags) // 2
    seen_there = seen[middle].astype(np.float64)
    variance = windows_of(sums.sweep.variance_px2, window_px).astype(np.float64) / many**2
    # What sampled noise adds to the frames with themselves: its shape K times its variance n.
    noise = windows_of(np.moveaxis(sums.noise * fluid[:, None], 1, 0), window_px)
    noise = np.asarray(noise / (sums.pairs * np.maximum(windows_of(fluid.astype(np.float32), window_px), 1.0)))
    noise *= _noise_of(raw, seen[_places(sums.raw_lags, sums.sweep.reach_px)], sums, grid, variance, threads)
    # Sums become means of products: windows at masks and edges hold fewer pixels.
    across /= np.maximum(seen, np.float32(1.0))
    own /= np.maximum(seen[_places(sums.own_lags, sums.sweep.reach_px)], np.float32(1.0))
    del seen
    # The peak across the frames is the distribution of displacements, widened by a particle image: that of
    # frames with themselves, which is taken off below.
    peak, slopes = _fits(across, sums.lags, variance, threads)
    itself = _own_peak(own - noise, sums, variance, threads)
    covariance, own_covariance = _covariance(peak), _covariance(itself)
    # How the fit answers to each product tells its random error, from what single pairs scattered.
    back = _by_templates(slopes, sums.pairs * seen_there)
    spread = _parameter_covariance(sums, window_px, back)
    # What is fitted is left over from the field that has deformed the frames.
    fields = middles_of(np.moveaxis(sums.sweep.field_px, -1, 0) + sums.cells["fields"] / sums.pairs, window_px)
    mean = np.moveaxis(fields, 0, -1) + peak[..., 1:3]
    sigma = np.sqrt(np.stack((spread[..., 1, 1], spread[..., 2, 2]), axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        volume = peak[..., 0] * _area(covariance) / (itself[..., 0] * _area(own_covariance))
    # A peak counts that lies within reach, holds enough particles that stay, and fits its neighbours.
    near = 0.8 * sums.sweep.reach_px
    inside = (np.abs(peak[..., 1:3]) < near).all(axis=-1) & (covariance[..., :2] < near**2).all(axis=-1)
    stays = volume >= LEAST_ALIKE * np.nanmedian(volume[inside]) if inside.any() else inside
    valid = (
        inside
        & stays
        & (seen_there >= LEAST_VALID * window_px**2)
        & (sigma < LARGEST_SIGMA_PX).all(axis=-1)
        & np.isfinite(volume)
    )
    valid &= ~outliers(np.where(valid[..., None], mean, 0.0), valid, THRESHOLD, EPSILON_PX)

    averaged, cut = _resolution(mean, valid, grid, _visible(sums, fluid))
    # What a window averages out of the mean is the scatter of its particles about that.
    stress_sigma = np.hypot(_stress_sigma(covariance, spread[..., 3:6, 3:6]), np.square(averaged)[..., None])

    def where_valid(values: Floats) -> Floats:
        return np.where(valid.reshape(valid.shape + (1,) * (values.ndim - 2)), values, np.nan)

    return EnsembleField(
        grid,
        where_valid(mean),
        where_valid(covariance - own_covariance + _of_fields(sums, window_px, back, covariance, fluid)),
        where_valid(sigma),
        where_valid(stress_sigma),
        where_valid(np.hypot(averaged, cut)),
        where_valid(volume),
        valid,
        sums.pairs,
        sums.sweep.solid | ~fluid,
    )


def _visible(sums: EnsembleSums, fluid: NDArray[np.bool_]) -> Singles:
    """Return the share (H, W) of all pairs in which a pixel is seen, outside solid cells."""
    seen = np.minimum(sums.frames[4] / np.float32(sums.pairs), np.float32(1.0))
    fluid_px = replace(sums.sweep, solid=sums.sweep.solid | ~fluid).fluid_px
    return seen if fluid_px is None else np.where(fluid_px, seen, np.float32(0.0))


def _resolution(mean: Floats, valid: NDArray[np.bool_], grid: WindowGrid, seen: Singles) -> tuple[Floats, Floats]:
    """Standard deviations (ny, nx) of a component of the mean by what windows average out, and by a mask.

    A window of side w without weights shows the mean field less w^2/24 of its second derivative along each axis;
    beside a wall its light lies beside its middle (`piv.correlation.cut_windows`).
    """
    if not valid.any():
        return np.zeros(grid.shape), np.zeros(grid.shape)
    apart = max(1, round(0.5 * grid.size_px / grid.step_px))
    whole = fill_gaps(np.where(valid[..., None], mean, 0.0), valid)[0]
    bent = second_differences(whole, apart)
    share = MISSED * grid.size_px**2 / (24.0 * (apart * grid.step_px) ** 2)
    return share * scipy.ndimage.maximum_filter(bent, 3), cut_px(whole, seen, grid, grid.size_px, 0.0)


def next_sweep(field: EnsembleField, sweep: Sweep) -> Sweep:
    """Get ready for a sweep that begins with what another has found."""
    known = field.mean_px, field.stress_px2, field.grid
    return sweep_with(sweep.shape, *known, sweep.spread_px2, field.solid)


def _places(lags: NDArray[np.int64], reach_px: int) -> NDArray[np.int64]:
    """Indices of displacements in `lags_of(reach_px)`."""
    places: NDArray[np.int64] = (lags[:, 0] + reach_px) * (2 * reach_px + 1) + lags[:, 1] + reach_px
    return places


def _noise_of(
    raw: Singles, seen: Singles, sums: EnsembleSums, grid: WindowGrid, variance: Floats, threads: int | None
) -> Singles:
    """Variance (ny, nx) of the camera's noise, see "Noise" in `ensemble`; 0 where no peak tells it from light.

    `raw` and `seen` (L, ny, nx) are sums over windows of frames as they are, and of their pixels.
    """
    wide = max(round(AROUND_PX / grid.step_px) - grid.size_px // grid.step_px, 0) + 1
    around = [scipy.ndimage.uniform_filter(part, (1, wide, wide), mode="constant") for part in (raw, seen)]
    planes = around[0] / np.maximum(around[1], np.float32(1.0))
    away = np.any(sums.raw_lags != 0, axis=-1)
    light, _ = _fits(planes[away], sums.raw_lags[away], variance, threads, is_own=True)
    beyond = planes[~away][0] - (light[..., 0] + light[..., 6])
    return np.asarray(np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0), np.float32)


def _own_peak(own: Singles, sums: EnsembleSums, variance: Floats, threads: int | None) -> Floats:
    """Parameters (ny, nx, 7) of the peaks of frames with themselves, from planes (L', ny, nx) without noise.

    They are looked at where those of both frames are, see "Shape" in `ensemble`; beyond what is kept of them a
    first fit continues them.
    """
    reach, kept = sums.sweep.reach_px, np.abs(sums.own_lags).max(axis=-1)
    whole = np.empty((len(sums.lags), *own.shape[1:]), np.float32)
    if reach > kept.max():
        first, _ = _fits(own, sums.own_lags, variance, threads, is_own=True)
        whole = _gaussians(first, sums.lags)
    for way in (1, -1):
        whole[_places(way * sums.own_lags[kept <= reach], reach)] = own[kept <= reach]
    return _fits(whole, sums.lags, variance, threads, is_own=True)[0]


def _gaussians(fits: Floats, lags: NDArray[np.int64]) -> Singles:
    """Values (L, ny, nx) of fitted peaks at displacements (L, 2)."""
    amplitude, _, _, along, down, tilt, foot = np.moveaxis(fits, -1, 0)
    values = np.empty((len(lags), *fits.shape[:2]), np.float32)
    for place, (v, u) in enumerate(lags):
        values[place] = amplitude * np.exp(-0.5 * (along * u * u + down * v * v) - tilt * u * v) + foot
    return values


def _fits(
    planes: Singles, lags: NDArray[np.int64], variance: Floats, threads: int | None, is_own: bool = False
) -> tuple[Floats, Floats]:
    """Parameters (ny, nx, 7) of `peak_fit` and slopes (ny, nx, 7, 7) of the templates, from planes (L, ny, nx).

    Peaks of a frame with itself (`is_own`) stand at no displacement.
    """
    _, ny, nx = planes.shape
    fits, slopes = np.empty((ny, nx, PARAMETERS)), np.empty((ny, nx, TEMPLATES, PARAMETERS))
    at = lags.astype(np.float64)
    free = np.ones(PARAMETERS, np.bool_)
    free[1:3] = not is_own

    def rows(first: int, last: int) -> None:
        work, line = np.empty((20, PARAMETERS)), np.empty(len(lags))
        for j in range(first, last):
            here = np.ascontiguousarray(planes[:, j], np.float64)
            fit_row(here, at, free, variance[j], work, line, fits[j], slopes[j])

    run_rows(rows, ny, block=1, threads=threads)
    return fits, slopes


def _covariance(fits: Floats) -> Floats:
    """Variances along u, v and covariance (ny, nx, 3) of fitted peaks."""
    uu, vv, uv = fits[..., 3], fits[..., 4], fits[..., 5]
    return np.stack((vv, uu, -uv), axis=-1) / (uu * vv - uv**2)[..., None]


def _area(covariance: Floats) -> Floats:
    area: Floats = np.sqrt(covariance[..., 0] * covariance[..., 1] - covariance[..., 2] ** 2)
    return area


def _by_templates(slopes: Floats, pixels: Floats) -> Floats:
    """Derivatives of fitted parameters by the templates' sums over all pairs (ny, nx, 7, 7); NaN without a peak.

    The fit was to a plane of one pair and one pixel, the sums are over `pixels` (ny, nx) of all pairs.
    """
    slopes = slopes * pixels[..., None, None]
    good = np.isfinite(slopes).all(axis=(-1, -2)) & (pixels > 0.0)
    good[good] = np.linalg.cond(slopes[good]) < 1.0 / np.finfo(float).eps
    back = np.full(slopes.shape, np.nan)
    back[good] = np.linalg.inv(slopes[good])
    return back


def _parameter_covariance(sums: EnsembleSums, window_px: int, back: Floats) -> Floats:
    """Covariance (ny, nx, 7, 7) of the fitted parameters, see "Sigma" in `ensemble`."""
    total, n = sums.windows[window_px], sums.pairs
    q, spread = total["templates"], np.empty((*back.shape[:2], TEMPLATES, TEMPLATES))
    for number, (k, m) in enumerate(zip(*PAIRS_OF_TEMPLATES, strict=True)):
        spread[..., k, m] = spread[..., m, k] = (total["products"][number] - q[k] * q[m] / n) * (n / (n - 1))
    result: Floats = back @ spread @ np.swapaxes(back, -1, -2)
    return result


def _of_fields(
    sums: EnsembleSums, window_px: int, back: Floats, covariance: Floats, fluid: NDArray[np.bool_]
) -> Floats:
    """Stresses (ny, nx, 3) of the fields that have deformed the frames, and of them with what was left."""
    total, n = sums.cells, sums.pairs
    d, q = total["fields"], total["templates"]
    mixed = total["mixed"].reshape(2, len(q), *d.shape[1:]) - d[:, None] * q[None] / n
    turned = windows_of(_derivatives(mixed, sums.sweep.variance_px2) * fluid, window_px)
    change = np.einsum("...km,m...->...k", back[..., 3:6, :], turned)  # of the peak's P = C^-1
    left = -n / (n - 1) * np.einsum("...km,...m->...k", _turn(covariance), change)
    cells = np.maximum(windows_of(fluid.astype(np.float64), window_px), 1.0)
    stresses = []
    for number, (a, b) in enumerate(PRODUCTS_OF_FIELDS):  # field a with what is left of b
        own = (total["field_products"][number] - d[a] * d[b] / n) / (n - 1)
        stresses.append(windows_of(own * fluid, window_px) / cells)
    return np.asarray(np.stack(stresses, axis=-1) + left)


def _derivatives(mixed: Floats, variance: Singles) -> Floats:
    """Sums (TEMPLATES, ny, nx) of M_u and M_v times the derivatives of templates by u and by v, added.

    `mixed` (2, TEMPLATES + CUBIC, ny, nx) are those times the templates, whose Gaussians have a variance (ny, nx).
    """
    (u, v), per = mixed, 1.0 / variance.astype(np.float64)
    by_u = (-u[1] * per, u[0] - u[3] * per, -u[5] * per, 2.0 * u[1] - u[7] * per, -u[9] * per, u[2] - u[8] * per)
    by_v = (-v[2] * per, -v[5] * per, v[0] - v[4] * per, -v[8] * per, 2.0 * v[2] - v[10] * per, v[1] - v[9] * per)
    return np.stack([*(one + other for one, other in zip(by_u, by_v, strict=True)), 0.0 * u[0]])


def _stress_sigma(covariance: Floats, inverse_spread: Floats) -> Floats:
    """Sigma (ny, nx, 3) of a covariance C from that of P = C^-1 (ny, nx, 3, 3)."""
    turn = _turn(covariance)
    variance = np.einsum("...kl,...lm,...km->...k", turn, inverse_spread, turn)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(variance), np.float64)


def _turn(covariance: Floats) -> Floats:
    """Matrices (ny, nx, 3, 3) by which -dP becomes dC: dC = -C dP C, of uu, vv and uv."""
    uu, vv, uv = covariance[..., 0], covariance[..., 1], covariance[..., 2]
    rows = [[uu**2, uv**2, 2 * uu * uv], [uv**2, vv**2, 2 * vv * uv], [uu * uv, vv * uv, uu * vv + uv**2]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def solid_cells(sums: EnsembleSums, planes: Planes) -> NDArray[np.bool_]:
    """Cells (ny, nx) that are solid; none where pairs are too few to tell."""
    if sums.pairs < FEWEST_PAIRS:
        return np.zeros(planes.still.shape, bool)
    near, own_near = (np.abs(lags).max(axis=-1) <= NEAR_PX for lags in (sums.lags, sums.own_lags))
    both_ways = np.where((sums.own_lags[own_near] == 0).all(axis=-1), 1.0, 2.0)  # half of them are kept
    across = planes.across[:, near].sum(axis=1, dtype=np.float64)
    itself = np.einsum("jki,k->ji", planes.own[:, own_near].astype(np.float64), both_ways)
    there = itself > 0.0
    if not there.any():
        return np.zeros(planes.still.shape, bool)
    alike = np.where(there, across / np.where(there, itself, 1.0), np.inf)
    usual = float(np.percentile(alike[there], USUAL))
    found = there & (planes.still > LEAST_STILL) & (alike < MOST_ALIKE * usual)
    return np.asarray(scipy.ndimage.binary_opening(found, np.ones((2, 2), bool)))
