"""Statistics of a series: mean velocity, Reynolds stresses, and their uncertainty.

Pairs are added one by one and merged by their numbers (`piv.statistics.merge_tree`), so neither workers nor the
length of chunks show in any bit.  Memory holds one chunk and some log2(N) sums.

A pair is left out, named and counted, if it has no vectors, or if fewer than half as many were measured in it as
is usual in its series: a failed flash or two strangers still give some vectors, and these are noise.

Effective samples come from the autocorrelation of each vector while the whole series fits into `KEPT_BYTES`, and
from blocking beyond that.

**Five errors, kept apart**, since only the first becomes smaller with more pairs: the random one; what windows do
not resolve of the mean (`piv.statistics.unresolved`), together with what dropped vectors take from it where some
pairs have none (`piv.statistics.unresolved`; where most have none there is no mean); the time between the
pulses, which is measured once for a run, so that its relative error is one factor for all vectors (and two for
stresses); the fitted map (`rtpiv.analysis.series.series_mean`); and the perspective error of
a steady out-of-plane velocity (`piv.statistics.out_of_plane`).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ground.short_repr import short_repr
from piv.correlation.finer_waves import Evaluated
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField, VectorFlag, could_be_measured
from piv.correlation.windows import WindowGrid
from piv.errors import SeriesError
from piv.files.vector_file import Vectors
from piv.statistics.denoised_components import NoiseFilter
from piv.statistics.denoised_mean import DenoisedMean
from piv.statistics.derived import PlaneField
from piv.statistics.effective_samples import Blocking, EffectiveSamples, from_series, mean_sigma, stress_sigma
from piv.statistics.merge_tree import MergeTree
from piv.statistics.moments import Moments
from piv.statistics.out_of_plane import NOTHING_TOLD, OutOfPlane, SlantedField, SlantedStresses
from piv.statistics.short_waves import ShortWaves
from piv.statistics.unresolved import Unresolved, is_measured_often, selection_sigma
from rtpiv.analysis.pairs.pair_vectors import ChunkContent, SeriesField

BELIEVED_SHARE = 0.5  # of the vectors of a usual pair; strangers have 0.3
LEAST_OF_USUAL = 0.5  # of the share of measured vectors
UNTIMED_DT_S = 1e-3  # by which a displacement in mm has the number of a velocity in m/s
KEPT_BYTES = 1 << 28  # 2100 pairs of 126 x 126 vectors in float32
ROWS = 8  # of the grid whose autocorrelation is taken at a time
Floats = NDArray[np.float64]


@short_repr
@dataclass(frozen=True, eq=False)
class MeanFlow:
    """Statistics of a flow on the plane; rows from the lowest y up, u to the right, v UP, in m/s.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) float64
        Places, both rising.
    px_per_mm : float
        Scale of the corrected image.
    window_px, step_px : int
        Side and spacing of the windows.
    dt_s : float
        Mean time between the frames of a pair.
    moments : Moments
        Of the vectors [m/s], as pairs show them.
    effective : EffectiveSamples
        Effective number of independent vectors.
    used : int
        Pairs in these statistics.
    usual_share : float
        Median over the pairs of the share of vectors that were measured, of those outside the mask.
    resolution_m_s : (ny, nx) float64
        Standard uncertainty of a component of the mean by what windows do not resolve, and by the vectors that
        were lost; NaN where not known.
    stress_resolution_m2_s2 : (ny, nx, 3) float64
        By how much stresses may be too small for the same reason: an upper limit.
    dt_sigma_share : float
        Standard uncertainty of dt over dt, the same for all pairs; NaN if it was not measured.
    left_out : tuple of (str, str)
        Pairs that are not, by tag, and why.
    map_sigma_m_s : (ny, nx, 2) float64 or None
        Standard uncertainty of the mean by the fitted map: the same in every pair, so no number of pairs makes it
        smaller.
    map_sigma_position_mm : (ny, nx, 2) float64 or None
        That of the places.
    map_common_m_s : (ny, nx, 2, C) float64 or None
        The part of `map_sigma_m_s` by errors that cameras of a joint fit have in common, draw by draw.
    no_map_sigma : str
        Why these three are None.
    denoised : DenoisedMean or None
        Mean of unfiltered vectors after the noise filter, which is the mean then; None where pairs were evaluated
        without that filter, or by a version that kept no unfiltered vectors: then it is that of `moments`.
    too_few : (ny, nx) bool or None
        Places without a mean: fewer than half of the pairs that looked there have a vector, or none is beside it.
    slope : (ny, nx, 2) float64 or None
        dX/dz, dY/dz of the rays that show the vectors, y up; None where they are not known.
    out_of_plane : OutOfPlane
        What is known of the velocity through the sheet.
    by_ensemble : Vectors, optional
        The same by ensemble correlation, if that was asked for.
    spheres : mapping of str to str
        `SelfCheck.attributes` of its run; None or empty where particles were not asked.
    is_timed : bool
        Whether the time between the frames is known; without it values in m/s are the displacement of
        a pair, in `length`, and `dt_s` makes the numbers those of mm.
    length : str
        Unit of lengths: "mm", or "px" where no scale is given.
    """

    x_mm: Floats
    y_mm: Floats
    px_per_mm: float
    window_px: int
    step_px: int
    dt_s: float
    moments: Moments
    effective: EffectiveSamples
    used: int
    usual_share: float
    resolution_m_s: Floats
    stress_resolution_m2_s2: Floats
    dt_sigma_share: float
    left_out: tuple[tuple[str, str], ...]
    map_sigma_m_s: Floats | None = None
    map_sigma_position_mm: Floats | None = None
    map_common_m_s: Floats | None = None
    no_map_sigma: str = ""
    denoised: DenoisedMean | None = None
    too_few: NDArray[np.bool_] | None = None
    slope: Floats | None = None
    out_of_plane: OutOfPlane = NOTHING_TOLD
    by_ensemble: Vectors | None = None
    spheres: Mapping[str, str] | None = None
    is_timed: bool = True
    length: str = "mm"

    def __str__(self) -> str:
        """Return the numbers of pairs and of places with a mean."""
        places = f"{int((self.count > 0).sum())} of {self.count.size} places"
        return f"mean of {self.used} pairs, {len(self.left_out)} left out: {places}"

    def _repr_html_(self) -> str:
        """Show a notebook the medians of the mean, of its uncertainty and of the stresses."""
        known = self.count > 0
        rows = [
            (name, *(f"{np.nanmedian(part[..., k][known]):.4g}" if known.any() else "-" for k in (0, 1)))
            for name, part in (
                (f"mean [{self.unit}]", self.mean_m_s),
                (f"its random sigma [{self.unit}]", self.sigma_m_s),
                (f"all that is known of its sigma [{self.unit}]", self.total_sigma_m_s),
                (f"fluctuation, without noise [{self.unit_squared}]", self.stresses_m2_s2),
            )
        ]
        cells = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
        return f"<p>{self}</p><table><tr><th>median</th><th>u</th><th>v</th></tr>{cells}</table>"

    @property
    def warnings(self) -> list[str]:
        """Warnings about the mean as a whole, a sentence each."""
        found = []
        if self.usual_share < BELIEVED_SHARE:
            found.append(
                f"only {100 * self.usual_share:.0f} % of the vectors of a usual pair were measured; check seeding,"
                " focus, background and dt before this mean is believed"
            )
        if self.spheres and "spheres_moved" in self.spheres:
            found.append(self.spheres["self_check"])
        return found

    @property
    def unit(self) -> str:
        """Unit of the mean: m/s, or a length where no time is known."""
        return "m/s" if self.is_timed else self.length

    @property
    def unit_squared(self) -> str:
        """Unit of the stresses."""
        return "m\u00b2/s\u00b2" if self.is_timed else f"{self.length}\u00b2"

    @property
    def rate_unit(self) -> str:
        """Unit of what `rate` returns."""
        return "1/s" if self.is_timed else "1"

    def rate(self, per_mm: Floats) -> Floats:
        """Return a derivative of the mean by a place in mm as a rate, or as it is where no time is known."""
        return (1e3 if self.is_timed else 1.0) * per_mm

    @property
    def gaps(self) -> str:
        """Sentence about places without a mean although they have vectors; empty if there are none."""
        places = 0 if self.too_few is None else int(np.count_nonzero(self.too_few))
        if not places:
            return ""
        return (
            f"no mean at {places} points (fewer than half of the pairs valid, and no representative sample);"
            " smaller windows or a shorter dt may resolve the flow there"
        )

    @property
    def count(self) -> NDArray[np.int64]:
        """Number of vectors n (ny, nx)."""
        return self.moments.count

    @property
    def mean_m_s(self) -> Floats:
        """Mean velocity (ny, nx, 2); NaN where there is none."""
        return self.moments.mean_uv if self.denoised is None else self.denoised.mean

    @property
    def mean_px(self) -> Floats:
        """Mean displacement (ny, nx, 2) [px of the corrected image], y up, of pairs `dt_s` apart."""
        return self.mean_m_s * self.px_per_m_s

    @property
    def px_per_m_s(self) -> float:
        """Displacement [px] of 1 m/s within `dt_s`."""
        return 1e3 * self.dt_s * self.px_per_mm

    @property
    def sigma_m_s(self) -> Floats:
        """Random standard uncertainty of the mean (ny, nx, 2)."""
        if self.denoised is not None:
            return self.denoised.sigma(self.moments, self.effective)
        return mean_sigma(self.moments, self.effective)

    @property
    def dt_sigma_m_s(self) -> Floats:
        """Standard uncertainty of the mean (ny, nx, 2) by that of dt, one factor for all; NaN if not known."""
        return np.abs(self.mean_m_s) * self.dt_sigma_share

    @property
    def local_sigma_m_s(self) -> Floats:
        """Sigma (ny, nx, 2) of what differs from place to place: random, and not resolved."""
        return np.hypot(self.sigma_m_s, np.nan_to_num(self.resolution_m_s)[..., None])

    @property
    def field(self) -> PlaneField:
        """The mean as a field whose derivatives can be taken: neighbouring windows see in part the same."""
        alike_mm = 0.5 * self.window_px / self.px_per_mm
        slanted = self._oblique_field
        through = None if slanted is None else slanted.through_sheet(self.out_of_plane.of_mean(slanted))
        return PlaneField(self.x_mm, self.y_mm, self.mean_m_s, self.local_sigma_m_s, alike_mm, through)

    @property
    def total_sigma_m_s(self) -> Floats:
        """All that is known of the uncertainty of the mean (ny, nx, 2), as root sum of squares."""
        parts = [self.local_sigma_m_s, np.nan_to_num(self.dt_sigma_m_s)]
        more = (self.map_sigma_m_s, self.slant_sigma_m_s)
        parts += [np.nan_to_num(part) for part in more if part is not None]
        total: Floats = np.sqrt(np.square(parts).sum(axis=0))
        return total

    @property
    def slant_sigma_m_s(self) -> Floats | None:
        """Sigma of the mean (ny, nx, 2) by a steady flow through the sheet; None where slopes are not known."""
        slanted = self._oblique_field
        return None if slanted is None else slanted.sigma(self.out_of_plane.of_mean(slanted))

    @property
    def _oblique_field(self) -> SlantedField | None:
        if self.slope is None:
            return None
        return SlantedField(self.mean_m_s, self.sigma_m_s, self.slope, self.window_px / self.step_px)

    @property
    def perspective_stresses(self) -> SlantedStresses | None:
        """Perspective error of out-of-plane fluctuations in the stresses; None where slopes are not known."""
        return None if self.slope is None else self.out_of_plane.of_stresses(self.stresses_m2_s2, self.slope)

    @property
    def stresses_m2_s2(self) -> Floats:
        """Reynolds stresses R_uu, R_vv, R_uv (ny, nx, 3) without the noise of correlation."""
        return self.moments.reynolds_stresses

    @property
    def noisy_stresses_m2_s2(self) -> Floats:
        """The same as measured, noise included."""
        return self.moments.covariance

    @property
    def stress_sigma_m2_s2(self) -> Floats:
        """Random standard uncertainty of the stresses (ny, nx, 3)."""
        return stress_sigma(self.moments, self.effective)


def mean_flow(chunks: Iterable[ChunkContent], settings: PivSettings | None = None) -> MeanFlow:
    """Statistics of a series from its chunks in order; they are gone through twice, so give a list or the like.

    `settings` are those of its pairs, whose noise filter is applied to the mean of their unfiltered vectors.
    Without them, or in chunks without such vectors, the mean is that of the vectors as pairs show them.

    Raises
    ------
    SeriesError
        No pair has vectors, or chunks lie on different grids.
    """
    usual, dt_s, dt_sigma_share, pairs = _usual(chunks)
    is_timed = not np.isnan(dt_s)
    dt_s = dt_s if is_timed else UNTIMED_DT_S
    moments, blocks, unresolved = MergeTree[Moments](), MergeTree[Blocking](), MergeTree[Unresolved]()
    # Of vectors before the noise filter:
    rough, rough_missing = MergeTree[Moments](), MergeTree[Unresolved]()
    short = MergeTree[ShortWaves]()
    has_rough = settings is not None and settings.denoise > 0.0
    kept: list[NDArray[np.float32]] = []
    left_out: list[tuple[str, str]] = []
    used = number = 0
    looked: NDArray[np.int64] | None = None
    first: ChunkContent | None = None
    for chunk in chunks:
        first = chunk if first is None else first
        if not (np.array_equal(chunk.x_mm, first.x_mm) and np.array_equal(chunk.y_mm, first.y_mm)):
            raise SeriesError("chunks of a series lie on different grids; evaluate the run again")
        apart = max(1, round(0.5 * chunk.window_px / chunk.step_px))
        how = Evaluated.usual(settings or PivSettings(), chunk.step_px)
        keeps = 8 * pairs * len(chunk.x_mm) * len(chunk.y_mm) <= KEPT_BYTES
        for field in chunk.fields:
            why = exclusion_reason(field, usual)
            if why:
                left_out.append((field.tag, why))
                moments.add(number, Moments.nothing(field.flags.shape))
                blocks.add(number, Blocking.nothing(field.flags.shape))
                unresolved.add(number, Unresolved.nothing(field.flags.shape, apart))
                rough.add(number, Moments.nothing(field.flags.shape))
                rough_missing.add(number, Unresolved.nothing(field.flags.shape, apart))
                short.add(number, ShortWaves.nothing(field.flags.shape, how))
            else:
                used += 1
                seen = could_be_measured(field.flags).astype(np.int64)
                looked = seen if looked is None else looked + seen
                moments.add(number, Moments.of(field.velocity_m_s, field.valid, field.sigma_m_s))
                blocks.add(number, Blocking.of(field.velocity_m_s, field.valid))
                part = Unresolved.of(field.velocity_m_s, field.valid, field.steady_m_s, apart)
                unresolved.add(number, part)
                has_rough = has_rough and field.unfiltered_m_s is not None
                if has_rough and field.unfiltered_m_s is not None and field.is_usual is not None:
                    uv, sigma, steady = np.split(field.unfiltered_m_s, (2, 3), axis=-1)
                    rough.add(number, Moments.of(uv, field.valid, np.repeat(sigma, 2, axis=-1)))
                    rough_missing.add(number, part.with_resolution(steady[..., 0]))
                    waves = ShortWaves.of(uv, field.valid, field.resolution_m_s, field.is_usual, how)
                    short.add(number, waves)
            if keeps:
                good = field.valid[..., None] & (not why)
                kept.append(np.where(good, field.velocity_m_s, np.nan).astype(np.float32))
            number += 1
    assert first is not None  # `_usual` has refused a series without chunks
    total, missing = moments.result(), unresolved.result()
    looked = np.zeros(total.count.shape, np.int64) if looked is None else looked
    often = is_measured_often(total, looked)
    too_few, total = (total.count > 0) & ~often, total.only(often)
    shared, lost = missing.share_of_mean(total.mean_uv), selection_sigma(total, looked)
    denoised, of_mean = None, shared
    if settings is not None and has_rough:
        once = NoiseFilter.of(settings, first.step_px, settings.denoise)
        denoised = DenoisedMean.of(rough.result().only(often), total, once)
        of_mean = rough_missing.result().share_of_mean(denoised.mean)
        of_mean = np.maximum(of_mean, short.result().short_wave_sigma(denoised.unfiltered.mean_uv))
        lost = np.hypot(lost, denoised.taken)
    unsure = np.where(lost > 0.0, np.hypot(np.nan_to_num(of_mean), lost), of_mean)
    return MeanFlow(
        first.x_mm,
        first.y_mm,
        first.px_per_mm,
        first.window_px,
        first.step_px,
        dt_s,
        total,
        _of_series(kept) if kept else blocks.result().effective(),
        used,
        usual,
        unsure,
        missing.of_stresses(shared, total.reynolds_stresses),
        dt_sigma_share,
        tuple(left_out),
        denoised=denoised,
        too_few=too_few,
        is_timed=is_timed,
    )


def image_field(mean_m_s: Floats, sigma_m_s: Floats, px_per_m_s: float, windows: WindowGrid) -> VectorField:
    """A mean turned back to where its frames show it: rows from the top, v DOWN, in px of the corrected image.

    Parameters
    ----------
    mean_m_s, sigma_m_s : (ny, nx, 2) float64
        Velocity and its uncertainty, rows from the lowest y up, v UP; NaN where there is none.
    px_per_m_s : float
        Displacement [px] of 1 m/s.
    windows : WindowGrid
        Where the vectors lie on the corrected image.
    """
    shift, sigma = mean_m_s[::-1] * px_per_m_s, sigma_m_s[::-1] * px_per_m_s
    known = np.isfinite(shift).all(axis=-1)
    nothing = np.full(windows.shape, np.nan)
    return VectorField(
        x_px=windows.x_px,
        y_px=windows.y_px,
        u_px=shift[..., 0],
        v_px=-shift[..., 1],
        flags=np.where(known, VectorFlag.VALID, VectorFlag.MASKED).astype(np.uint8),
        peak_ratio=nothing,
        correlation=nothing,
        sigma_u_px=sigma[..., 0],
        sigma_v_px=sigma[..., 1],
        valid_fraction=np.where(known, 1.0, 0.0),
        window_px=windows.size_px,
        step_px=windows.step_px,
        nan_pixels=0,
    )


def too_few_of(means: Iterable[MeanFlow], without_mean: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Places (ny, nx) of several means together that have none because too few pairs had a vector there."""
    known = [mean.too_few for mean in means if mean.too_few is not None]
    return np.logical_or.reduce(known) & without_mean if known else None


def exclusion_reason(field: SeriesField, usual_share: float) -> str:
    """Return the reason why a pair is left out of the statistics of its series; "" if it is not."""
    if field.failure:
        return field.failure
    if field.valid_share < LEAST_OF_USUAL * usual_share:
        here, usual = (f"{100 * share:.0f} %" for share in (field.valid_share, usual_share))
        return f"only {here} of its vectors were measured, and {usual} is usual in this series"
    return ""


def _of_series(kept: list[NDArray[np.float32]]) -> EffectiveSamples:
    """Effective samples of a series that is kept, some rows of the grid at a time."""
    parts = []
    for first in range(0, len(kept[0]), ROWS):
        parts.append(from_series(np.stack([field[first : first + ROWS] for field in kept]).astype(np.float64)))
    samples = np.concatenate([part.samples for part in parts])
    return replace(parts[0], samples=samples, converged=all(part.converged for part in parts))


def _usual(chunks: Iterable[ChunkContent]) -> tuple[float, float, float, int]:
    """Median share of measured vectors, mean time between frames [s], its relative sigma, and pairs in all."""
    shares: list[float] = []
    times: list[float] = []
    unsure: list[float] = []
    pairs = 0
    for chunk in chunks:
        pairs += len(chunk.fields)
        fields = [field for field in chunk.fields if not field.failure]
        shares += [field.valid_share for field in fields]
        times += [field.dt_s for field in fields]
        unsure += [field.dt_sigma_s / field.dt_s for field in fields]
    if not shares or not max(shares) > 0.0:
        raise SeriesError("no pair of this series has a vector; look at the reasons that its evaluation gave")
    if np.isnan(times).any() and not np.isnan(times).all():
        raise SeriesError(
            "the time between the frames is known of some of these pairs; evaluate them with --dt-us"
        )
    return float(np.median(shares)), float(np.mean(times)), float(np.sqrt(np.mean(np.square(unsure)))), pairs
