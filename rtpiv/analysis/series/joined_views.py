"""Several views of one flow become one field: the union of what they see, and the velocity through the sheet.

Each view is a series on one grid: a camera, or one camera that was moved between runs.  Their vectors are combined
place by place (`piv.statistics.three_components`); where they see a place with slopes that differ enough, w comes
out, elsewhere a vector keeps its perspective error.

    runs that followed each other     their means are combined; the flow must have been the same
    cameras at the same time          vectors are combined pair by pair (``chunks/00000.nc`` ...), and averaged

Errors of correlation and of the fitted maps count as independent between views.  Those of resolution are common in
part: in w they count as independent, in u and v as common, which is the larger of both.  Errors of a fit that
cameras share (`rtpiv calibrate --join`) count as common, draw by draw.

mean.nc, where rows begin at the lowest y:

    u, v, w                       mean velocity; w towards the camera, only where it is determined
    sigma_u, sigma_v, sigma_w     random standard uncertainty
    total_sigma_u, _v, _w         with resolution, fitted maps and, where w is not determined, the flow through the
                                  sheet that is assumed (`out_of_plane`), at least as large as where it is measured
    views, seen_by                number of views of a place; and which: 1 the first, 2 the second, 4 the third ...
    chi                           residual of the views about u, v, w, in sigmas
    status_1, status_2 ...        why a camera does not see the place (`status_meanings`)
    R_uu, R_vv, R_ww, R_uv, R_uw, R_vw; sigma_R_uu ...
                                  Reynolds stresses without noise, of cameras at the same time
    n                             pairs behind the mean, of cameras at the same time

Files of chunks hold u, v, w, sigma_u ... total_sigma_w, views and chi of each pair.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.node_status import NodeStatus
from ground.short_repr import short_repr
from piv.correlation.settings import PivSettings
from piv.errors import SeriesError
from piv.files.vector_file import LENGTH, SPEED, Vectors
from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.out_of_plane import SlantedField
from piv.statistics.six_stresses import COMPONENTS, StressSums
from piv.statistics.three_components import ThreeComponents, combine_views
from rtpiv.analysis.pairs.pair_vectors import SeriesField
from rtpiv.analysis.series.mean_flow import MeanFlow
from rtpiv.analysis.series.series_folder import MEAN, Chunks
from rtpiv.analysis.series.series_mean import STRESS, mean_of_series, without_time, write_statistics
from rtpiv.analysis.series.series_plan import MAX_CHUNK_PAIRS, chunk_path
from rtpiv.analysis.series.series_view import SeriesView
from rtpiv.analysis.through_glass import percent, through_glass

MOST_OFTEN = 0.5  # of the pairs of a place that must have w, for its mean to have one
MIN_W_PLACES = 30  # with w that tell its size where it is not determined
NEVER = 1e-100  # standard uncertainty that no w has
SAMPLING_PX = 0.0024  # error by pixels of a particle of 2.4 px, which no filter takes off (`sampling_error_px`)
UNLIKE_SIGMA = 2.0  # residual of views that do not show one flow, or not where they are calibrated
DENOISE = PivSettings.denoise
UVW = ("u", "v", "w")
Floats = NDArray[np.float64]
Filtered = tuple[Floats, Floats, Floats]  # u, v, w, covariance of their noise, variance of the flow taken off


@short_repr
@dataclass(frozen=True, eq=False)
class JoinedViews:
    """One field of several views, rows from the lowest y up.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) float64
        Places.
    uvw_m_s, sigma_m_s, total_sigma_m_s : (ny, nx, 3) float64
        Mean velocity, its random and its whole standard uncertainty; NaN where there is none.
    views, seen_by : (ny, nx) uint8, int32
        Number of views of a place; and which, 1, 2, 4 ... added.
    chi : (ny, nx) float64
        Residual of the views of a place in sigmas; NaN where w is not determined.
    residuals : tuple of float
        Residual of all views in sigmas, then without each of them where there are three or more; NaN where no
        place tells.
    shares : tuple of float
        Share of what the glass hides from the first camera that each view recovers, then all together; empty
        without glass.
    stresses : StressSums, optional
        Of cameras at the same time.
    samples : (ny, nx) float64
        Independent pairs that a mean is worth.
    px_per_m_s : float
        Displacement [px] of 1 m/s.
    unit : str
        Of the mean.
    """

    x_mm: Floats
    y_mm: Floats
    uvw_m_s: Floats
    sigma_m_s: Floats
    total_sigma_m_s: Floats
    views: NDArray[np.uint8]
    seen_by: NDArray[np.int32]
    chi: Floats
    residuals: tuple[float, ...]
    shares: tuple[float, ...]
    stresses: StressSums | None
    samples: Floats
    px_per_m_s: float
    unit: str

    @property
    def sentences(self) -> list[str]:
        """Places with a mean and with w, shares of what the glass hides, and the residual, a line each."""
        seen, with_w = (int(np.isfinite(self.uvw_m_s[..., k]).sum()) for k in (0, 2))
        found = [f"{seen} of {self.uvw_m_s[..., 0].size} places have a mean, {with_w} of them w"]
        if self.shares:
            *each, whole = map(percent, self.shares)
            by = ", ".join(f"{share} by view {number}" for number, share in enumerate(each, start=1))
            found.append(f"of what the glass hides from the first view {whole} is recovered: {by}")
        if np.isfinite(self.residuals[0]):
            found.append(f"residual of the views where w is known: {self.residuals[0]:.2f} sigma (rms)")
        return found

    @property
    def warning(self) -> str:
        """Sentence about views that contradict each other; "" if they do not."""
        whole, *without = self.residuals
        if not whole > UNLIKE_SIGMA:
            return ""
        said = (
            f"the views differ by {whole:.1f} sigma (rms): one camera does not stand where it was calibrated, the"
        )
        said += " light sheet lies elsewhere, or they saw another flow"
        better = [number for number, left in enumerate(without, start=1) if left < UNLIKE_SIGMA]
        return f"{said}; without view {better[0]} they agree" if len(better) == 1 else said


@dataclass(frozen=True, eq=False)
class _View:
    """Mean of a view, and what does not differ between its pairs: slopes and variance of the map.

    `common` (ny, nx, 2, C) is the part of the map's error that views with the same key `joint` have in common.
    """

    folder: SeriesView
    mean: MeanFlow
    slope: Floats
    map_variance: Floats
    joint: str = ""
    common: Floats | None = None

    @classmethod
    def of(cls, folder: SeriesView) -> "_View":
        """The view of a series; SeriesError where only a scale is known of its camera."""
        mean = mean_of_series(folder)
        if mean.slope is None:
            raise SeriesError(f"{folder.folder}: only a scale is known of its camera; evaluate it with a scene")
        map_sigma = np.zeros_like(mean.mean_m_s) if mean.map_sigma_m_s is None else mean.map_sigma_m_s
        joint = "" if isinstance(folder.sigma, str) else folder.sigma.joint[0]
        variance = np.square(np.nan_to_num(map_sigma))
        return cls(folder, mean, mean.slope, variance, joint, mean.map_common_m_s)

    def field(self, uv: Floats, sigma: Floats) -> SlantedField:
        """Vectors (ny, nx, 2) of the view under its slopes."""
        return SlantedField(uv, sigma, self.slope, self.mean.window_px / self.mean.step_px)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Vectors of all views at one time, or their means, combined.

    `noise` (ny, nx, 3, 3) is the covariance of u, v, w by the noise of the views, `systematic` (ny, nx, 3) the
    variance by all else; `tests` holds (chi^2, degrees of freedom) of all views and without each.  `wide` is the
    same with w wherever a mean of many pairs or the noise filter may make it sure enough; `w` is its w after that
    filter, with the variance of its noise and of what was taken off.
    """

    found: ThreeComponents
    noise: Floats
    systematic: Floats
    tests: Floats
    wide: ThreeComponents
    wide_noise: Floats
    wide_systematic: Floats
    w: tuple[Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class _Limits:
    """Standard uncertainty of w up to which it is reported, after the noise filter; sampling error of vectors."""

    sigma_w: float
    filter: NoiseFilter
    sampling: float = 0.0


def _variance(covariance: Floats) -> Floats:
    return np.diagonal(covariance, axis1=-2, axis2=-1)


def _noise_of(found: ThreeComponents, noise: Floats) -> Floats:
    """Covariance (ny, nx, 3, 3) of u, v, w by the variances (n, ny, nx, 2) of the noise of views."""
    there = np.where(np.isfinite(noise) & (noise > 0.0), noise, 0.0)
    return np.asarray(np.einsum("nyxkc,nyxlc,nyxc->yxkl", found.gains, found.gains, there, optimize=True))


def _more_by_common(views: Sequence[_View], found: ThreeComponents) -> Floats:
    """Variance (ny, nx, 3) that the maps of a joint fit add, or take off, as their errors are not independent."""
    parts = [view.common for view in views if view.common is not None and view.joint]
    if len(parts) < len(views) or len({view.joint for view in views}) > 1:
        return np.zeros_like(found.uvw)
    common = np.nan_to_num(np.stack(parts))
    each = np.einsum("nyxkc,nyxcm->nyxkm", found.gains, common)
    return np.asarray(np.square(each.sum(axis=0)).sum(axis=-1) - np.square(each).sum(axis=(0, -1)))


def _systematic(views: Sequence[_View], found: ThreeComponents, noise: Floats, unresolved: Floats) -> Floats:
    """Variance (ny, nx, 3) by all but noise; `unresolved` (n, ny, nx, 1) is that of views by their resolution."""
    systematic = np.maximum(_variance(found.covariance - noise), 0.0)
    systematic = np.maximum(systematic + _more_by_common(views, found), 0.0)
    # Windows of all views miss the same detail, so that u and v of several views miss it as well.
    is_used = np.any(found.gains != 0.0, axis=(-2, -1))[..., None]
    common = np.nan_to_num(np.where(is_used, unresolved, np.inf).min(axis=0), posinf=0.0)
    shared = found.propagate(np.broadcast_to(unresolved, (*unresolved.shape[:-1], 2)))[..., :2]
    systematic[..., :2] += np.maximum(common - shared, 0.0)
    return systematic


def _combine(
    views: Sequence[_View], uv: Floats, noise: Floats, resolution: Floats, sigma_w: Sequence[Floats], how: _Limits
) -> _Fit:
    """Combine vectors (n, ny, nx, 2) with the variance of their noise; `resolution` (n, ny, nx) is a sigma."""
    slope = np.stack([view.slope for view in views])
    unresolved = (np.square(np.nan_to_num(resolution)) + how.sampling**2)[..., None]
    variance = noise + unresolved + np.stack([view.map_variance for view in views])
    known = np.isfinite(sigma_w)
    typical = np.sqrt(np.where(known, np.square(sigma_w), 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    # Everywhere where the filter may make w sure enough, then where it has done so.
    wide = combine_views(uv, variance, slope, typical, how.sigma_w / how.filter.least)
    wide_noise = _noise_of(wide, noise)
    w = how.filter.filter_w(wide.uvw[..., 2], wide_noise[..., 2, 2])
    known_w = wide.has_w & (wide.covariance[..., 2, 2] - wide_noise[..., 2, 2] + w[1] + w[2] <= how.sigma_w**2)
    if np.count_nonzero(known_w) >= MIN_W_PLACES:  # w is as large elsewhere as where it is measured
        size = np.mean(np.square(wide.uvw[known_w, 2]) - wide.covariance[known_w, 2, 2])
        typical = np.maximum(typical, np.sqrt(max(float(size), 0.0)))
    limit = np.where(known_w, np.inf, NEVER)
    found = combine_views(uv, variance, slope, typical, limit)
    own = _noise_of(found, noise)
    systematic, wide_systematic = (
        _systematic(views, *each, unresolved) for each in ((found, own), (wide, wide_noise))
    )
    count = len(views)
    kept = [list(range(count)), *([k for k in range(count) if k != out] for out in range(count) if count > 2)]
    parts = [combine_views(uv[k], variance[k], slope[k], typical, limit) for k in kept[1:]]
    tests = np.array([(np.nansum(part.chi2), part.freedom.sum()) for part in (found, *parts)], np.float64)
    return _Fit(found, own, systematic, tests, wide, wide_noise, wide_systematic, w)


def join_views(
    series: Sequence[SeriesView], out: Path, at_once: bool, limit_px: float, denoise: float = DENOISE
) -> JoinedViews:
    """Join series of several views and write mean.nc, and the vectors of pairs, into `out`.

    Parameters
    ----------
    series : sequence of SeriesView
        Series on one grid, two or more.
    out : Path
        Folder.
    at_once : bool
        Their pairs were recorded at the same time, in the same order.
    limit_px : float
        Standard uncertainty of w up to which it is reported [px of the corrected image].
    denoise : float
        How many times its noise detail of u, v and w must exceed; 0 keeps all.  Views that were evaluated with a
        noise filter get no other.

    Raises
    ------
    SeriesError
        They lie on different grids, have different numbers of pairs, or one has no scene or is damaged.
    RunUnsuitable, ConfigError, DiskError
        As `mean_of_series`.
    """
    if len({tuple(each.about["keys"]) for each in series}) < len(series):
        named = " and ".join(str(each.folder) for each in series)
        raise SeriesError(f"{named} are the same vectors; give different views")
    views = [_View.of(each) for each in series]
    means, first = [view.mean for view in views], views[0].mean
    for mean in means[1:]:
        _require_one_grid(first, mean)
    settings = [each.settings for each in series]
    beta = 0.0 if any(each.denoise for each in settings) else denoise
    per_px = 1.0 / first.px_per_m_s
    sampling = SAMPLING_PX * per_px if beta else 0.0
    limits = _Limits(limit_px * per_px, NoiseFilter.of(settings[0], first.step_px, beta), sampling)
    uv, sigma = np.stack([mean.mean_m_s for mean in means]), np.stack([mean.sigma_m_s for mean in means])
    # Cameras at the same time see the same fluctuations: between them the noise of vectors counts alone.
    noise = np.stack([mean.moments.noise for mean in means])
    beyond = np.zeros_like(noise)
    if not at_once:  # each view has its own fluctuations, of which no filter takes anything
        noise = np.minimum(noise / np.stack([mean.count for mean in means])[..., None], sigma**2)
        beyond = sigma**2 - noise
    sigma_w = [
        view.mean.out_of_plane.of_mean(view.field(*each)) for view, *each in zip(views, uv, sigma, strict=True)
    ]
    varied = [replace(view, map_variance=view.map_variance + own) for view, own in zip(views, beyond, strict=True)]
    fit = _combine(varied, uv, noise, np.stack([mean.resolution_m_s for mean in means]), sigma_w, limits)
    samples = np.min([np.nan_to_num(m.effective.samples, nan=np.inf).min(axis=-1) for m in means], axis=0)
    uvw, random, sums = fit.found.uvw, _variance(fit.noise), None
    varying = fit.found.propagate(beyond)
    kind, systematic, w = fit.found, fit.systematic - varying, fit.w
    tests, chi2, freedom = fit.tests, fit.found.chi2, fit.found.freedom
    if at_once:
        sums = PairSums(fit.found.uvw)
        for number, (pairs, fits) in enumerate(_fits_of_pairs(views, limits)):
            filtered = [
                limits.filter.apply(each.found, each.found.uvw, _variance(each.noise), each.w) for each in fits
            ]
            for each in zip(fits, filtered, strict=True):
                sums.add(*each)
            write_statistics(chunk_path(out, number), _pair_vectors(views, pairs, fits, filtered))
        tests, chi2, freedom = sums.tests, sums.chi2, sums.freedom
        uvw, random, varying = sums.mean(samples)
        w = limits.filter.filter_w(uvw[..., 2], random[..., 2])
        sure = w[1] + w[2] + varying[..., 2] + fit.wide_systematic[..., 2]
        is_sure = sure <= limits.sigma_w**2  # more often than in a pair
        kind, systematic = fit.wide, np.where(is_sure[..., None], fit.wide_systematic, fit.systematic)
        uvw, random, varying = sums.mean(samples, is_sure)
    uvw, noise, taken = limits.filter.apply(kind, uvw, random, w)
    random = _variance(noise) + varying
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals, chi = np.sqrt(tests[:, 0] / tests[:, 1]), np.sqrt(chi2 / freedom)
    is_used = np.any(fit.found.gains != 0.0, axis=(-2, -1))
    bits = (1 << np.arange(len(views)))[:, None, None]
    joined = JoinedViews(
        first.x_mm, first.y_mm, uvw, np.sqrt(np.where(np.isnan(uvw), np.nan, random)),
        np.sqrt(np.where(np.isnan(uvw), np.nan, random + systematic + taken)), fit.found.views,
        np.asarray((is_used * bits).sum(axis=0), np.int32), chi, tuple(residuals.tolist()), _shares(series),
        None if sums is None else sums.with_w, samples, first.px_per_m_s, first.unit,
    )  # fmt: skip
    write_statistics(out / MEAN, _mean_vectors(joined, views))
    return joined


def _require_one_grid(first: MeanFlow, other: MeanFlow) -> None:
    same = np.array_equal(first.x_mm, other.x_mm) and np.array_equal(first.y_mm, other.y_mm)
    if not same or first.window_px != other.window_px:
        raise SeriesError(
            "the views lie on different grids; give runs or frames in place of their series: they are evaluated on"
            " the grid of the first"
        )
    if first.is_timed != other.is_timed:
        raise SeriesError("the time between the frames is known of some of the views; evaluate all with --dt-us")


def _shares(series: Sequence[SeriesView]) -> tuple[float, ...]:
    """Share of what the glass hides from the first camera that each view recovers, then all of them."""
    scene, recovered = series[0].scene, [each.correction.corrector.recovered for each in series]
    found = [through_glass(scene, series[0].grid, part) for part in (*recovered, np.logical_or.reduce(recovered))]
    return tuple(each.share for each in found if each is not None)


class PairSums:
    """Sums over the pairs of cameras at the same time.

    Means are those of vectors before the noise filter, which takes the same detail off every pair; stresses are
    those of vectors after it, as the noise of a single vector of w exceeds the fluctuations.

    Parameters
    ----------
    reference : (ny, nx, 3) float64
        A velocity near the mean.
    """

    def __init__(self, reference: Floats) -> None:
        self.with_w, self._any, self._wide = (StressSums(reference) for _ in range(3))
        self.tests = np.zeros((1, 2))
        self.chi2, self.freedom = np.zeros(reference.shape[:2]), np.zeros(reference.shape[:2], np.int64)

    def add(self, fit: _Fit, filtered: Filtered) -> None:
        """Add the vectors of a pair."""
        found = fit.found
        self.with_w.add(filtered[0], filtered[1])
        self._wide.add(fit.wide.uvw, fit.wide_noise)
        self._any.add(np.where(np.arange(3) < 2, found.uvw, 0.0), fit.noise)
        self.tests = self.tests + fit.tests
        self.chi2 += np.nan_to_num(found.chi2)
        self.freedom += found.freedom

    def mean(self, samples: Floats, is_sure: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats, Floats]:
        """Mean (ny, nx, 3), its variance by noise and by fluctuations of the flow; w where it is sure.

        `samples` (ny, nx) is the number of independent pairs.  Noise alone is filtered: fluctuations have no more
        detail than the mean.  Pairs without w have u and v with a perspective error: they count only where most
        pairs have none.
        """
        often = self._wide.count >= np.maximum(MOST_OFTEN * self._any.count, 2)
        often &= True if is_sure is None else is_sure
        sums = (self._wide, self._any)
        uvw, noise, varying = (
            np.where(often[..., None], *(getattr(each, name) for each in sums))
            for name in ("mean", "noise", "fluctuation")
        )
        uvw[..., 2] = np.where(often, uvw[..., 2], np.nan)
        return uvw, noise / np.maximum(self._any.count, 1)[..., None], varying / samples[..., None]


def _fits_of_pairs(views: Sequence[_View], limits: _Limits) -> Iterator[tuple[list[SeriesField], list[_Fit]]]:
    """Fields of the first view and fits of the pairs, in chunks; SeriesError if the numbers of pairs differ."""
    counts = {view.folder.about["pairs"] for view in views}
    if len(counts) > 1:
        raise SeriesError(
            f"views at the same time have as many pairs, not {' and '.join(map(str, sorted(counts)))}; leave"
            " --simultaneous out to join their means"
        )
    each = [chain.from_iterable(chunk.fields for chunk in Chunks.of(view.folder.folder)) for view in views]
    pairs = zip(*each, strict=True)
    while chunk := list(islice(pairs, MAX_CHUNK_PAIRS)):
        fits = []
        for pair in chunk:
            uv = np.stack([np.where(one.valid[..., None], one.velocity_m_s, np.nan) for one in pair])
            sigma = np.stack([one.sigma_m_s for one in pair])
            sigma_w = [
                view.mean.out_of_plane.of_pair(view.field(*one), 1.0)
                for view, *one in zip(views, uv, sigma, strict=True)
            ]
            resolution = np.stack([one.resolution_m_s for one in pair])
            fits.append(_combine(views, uv, np.square(sigma), resolution, sigma_w, limits))
        yield [pair[0] for pair in chunk], fits


def _pair_vectors(
    views: Sequence[_View], pairs: Sequence[SeriesField], fits: Sequence[_Fit], filtered: Sequence[Filtered]
) -> Vectors:
    """Vectors of the pairs of a chunk, and the same after the noise filter."""
    mean, fields = views[0].mean, dict[str, NDArray[Any]]()
    uvw, covariance, taken = (np.stack(part) for part in zip(*filtered, strict=True))
    noise = _variance(covariance)
    whole = noise + taken + np.stack([fit.systematic for fit in fits])
    for before, values in (("", uvw), ("sigma_", np.sqrt(noise)), ("total_sigma_", np.sqrt(whole))):
        shown = np.where(np.isnan(uvw), np.nan, values)
        fields |= {f"{before}{name}": shown[..., k] for k, name in enumerate(UVW)}
    units = dict.fromkeys(fields, SPEED if mean.is_timed else LENGTH) | {"delta_t": "s"}
    fields["views"] = np.stack([fit.found.views for fit in fits]).astype(np.int8)
    fields["chi"] = np.sqrt([fit.found.chi2 / np.maximum(fit.found.freedom, 1) for fit in fits])
    about = {"pairs": json.dumps([one.tag for one in pairs])} | _about(views)
    times, dt_s = (np.array([getattr(one, name) for one in pairs]) for name in ("time_s", "dt_s"))
    return Vectors(mean.x_mm, mean.y_mm, times, fields, {"delta_t": dt_s}, units, about)


def _mean_vectors(joined: JoinedViews, views: Sequence[_View]) -> Vectors:
    """The mean as vectors of one time."""
    mean, named = views[0].mean, dict[str, tuple[NDArray[Any], str]]()
    parts = ("", joined.uvw_m_s), ("sigma_", joined.sigma_m_s), ("total_sigma_", joined.total_sigma_m_s)
    for before, values in parts:
        named |= {f"{before}{name}": (values[..., k], SPEED) for k, name in enumerate(UVW)}
    named |= {"views": (joined.views.astype(np.int8), "1"), "seen_by": (joined.seen_by, "1")}
    named |= {"chi": (joined.chi, "1"), "chc": (np.isfinite(joined.uvw_m_s[..., 0]).astype(np.int8), "1")}
    if joined.stresses is not None:
        stresses, sigma = joined.stresses.stresses, joined.stresses.stress_sigma(joined.samples)
        for k, (i, j) in enumerate(COMPONENTS):
            name = f"R_{UVW[i]}{UVW[j]}"
            named |= {name: (stresses[..., k], STRESS), f"sigma_{name}": (sigma[..., k], STRESS)}
        named["n"] = (joined.stresses.count, "1")
    for number, view in enumerate(views, start=1):
        windows, status = view.folder.windows, view.folder.correction.corrector.map.status
        nodes = np.ix_(*(np.rint(axis).astype(int) for axis in (windows.y_px, windows.x_px)))
        named[f"status_{number}"] = (status[nodes][::-1].astype(np.int8), "1")
    named = named if mean.is_timed else without_time(named, mean.length)
    about = _about(views) | {
        "delta_t": np.float64(mean.dt_s),
        "pairs_used": sum(view.mean.used for view in views),
        "residual_sigma": np.float64(joined.residuals[0]),
        "status_meanings": ", ".join(f"{status.value} {status.name.lower()}" for status in NodeStatus),
    }
    fields = {name: values[None] for name, (values, _) in named.items()}
    return Vectors(
        mean.x_mm, mean.y_mm, np.zeros(1), fields, {}, {n: unit for n, (_, unit) in named.items()}, about
    )


def _about(views: Sequence[_View]) -> dict[str, Any]:
    """Attributes of both kinds of files."""
    mean = views[0].mean
    return {
        "runs": json.dumps([view.folder.about["run"] for view in views]),
        "scene_hashes": json.dumps([view.folder.scene.content_hash() for view in views]),
        "rtpiv_version": version("rtpiv"),
        "px_per_mm": mean.px_per_mm,
        "window_px": mean.window_px,
        "step_px": mean.step_px,
        "out_of_plane": "; ".join(dict.fromkeys(view.mean.out_of_plane.sentence for view in views)),
    }
