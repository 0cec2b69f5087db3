"""Tables of an evaluation, for the page and for the terminal; first the total error of a region.

Where the true shift is known the total error of a region is the rms of its vectors' errors, u and v apart, and

    total^2 = bias^2 + scatter^2.

The page begins with the scatter; the bias, a common offset, stands below. It may be that of the stage (it moved
the sheet by another distance than it reported) or of the map; how large either may be stands in the budget of the
comparison, and is no part of the total. Where no shift is known, the total is the standard uncertainty: the root
sum of squares of random sigma, spatial resolution, map sigma and perspective error of out-of-plane motion.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.claims import Claim, claim_of, independent_share
from correction.evaluate.regions import MIDDLE, Region, Regions, shift_errors
from correction.node_status import MEANING, NodeStatus
from daq.runs.run_views import length_unit
from piv.correlation.response import response_of
from piv.correlation.settings import PivSettings
from piv.correlation.vector_field import VectorField
from piv.preprocessing.image_figures import ImageFigures
from rtpiv.analysis.digits import two_digits
from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.pairs.pair_vectors import per_px
from rtpiv.analysis.pictures.rasters import COLOURS, web
from rtpiv.analysis.report.table import Table

GLASS, DIRECT = "behind glass", "seen directly"
ALL = "all"  # where nothing stands before the camera
REGIONS = {GLASS: Region.GLASS, DIRECT: Region.DIRECT}
Pair = tuple[float, float]


@dataclass(frozen=True)
class Total:
    """Error, or without a known shift uncertainty, of the vectors of a region.

    Parameters
    ----------
    region : str
        Region of the vectors.
    count : int
        Number of them.
    total_px : (float, float)
        Along u and v.
    parts : tuple of (str, (float, float))
        Its parts, whose root sum of squares it is: none is larger than the total.
    is_error : bool
        True of an error against a known shift, False of an uncertainty.
    is_plain : bool
        Whether nothing stands before the camera, so that there are no regions.
    """

    region: str
    count: int
    total_px: Pair
    parts: tuple[tuple[str, Pair], ...]
    is_error: bool
    is_plain: bool = False

    def nodes(self, evaluation: Evaluation) -> int:
        """Nodes of the region that are not masked: how many vectors could be measured there."""
        field = evaluation.field
        return int(np.count_nonzero((evaluation.regions.region == REGIONS[self.region]) & field.asked))

    def where(self, evaluation: Evaluation) -> NDArray[np.bool_]:
        """Its vectors (ny, nx)."""
        return np.asarray((evaluation.regions.region == REGIONS[self.region]) & evaluation.field.valid)

    @property
    def head_px(self) -> Pair:
        """Scatter of the errors, where they are known, else the total uncertainty: the head of a page."""
        return dict(self.parts)["scatter"] if self.is_error else self.total_px

    @property
    def label(self) -> str:
        """Name of `head_px`."""
        what = "scatter of the errors" if self.is_error else "total standard uncertainty"
        return f"{what} u, v of the {self.count} vectors{self.where_said}"

    @property
    def where_said(self) -> str:
        """Name of the region behind a word; nothing where there are no regions."""
        return "" if self.is_plain else f" {self.region}"


@dataclass(frozen=True)
class Coverage:
    """Errors over sigma, along u and v: shares within 1 and 2 sigma, and rms."""

    within_1: Pair
    within_2: Pair
    ratio: Pair
    claim: Claim


def is_plain(evaluation: Evaluation) -> bool:
    """Return whether nothing stands before the camera, so that there are no regions."""
    return not evaluation.task.scene.bodies


def region_label(name: str, evaluation: Evaluation) -> str:
    """Return the name of a region: "all" where nothing stands before the camera."""
    return ALL if is_plain(evaluation) else name


def totals_of(evaluation: Evaluation) -> list[Total]:
    """Return the total of the vectors behind glass, then of those seen directly; empty regions are left out."""
    found = []
    for name, region in REGIONS.items():
        where = (evaluation.regions.region == region) & evaluation.field.valid
        if where.any():
            found.append(_total(evaluation, name, where))
    return found


def _total(evaluation: Evaluation, name: str, where: NDArray[np.bool_]) -> Total:
    result = evaluation.shift
    count = int(where.sum())
    if result is not None:
        found = result.regions[name]
        bias_and_scatter = (("bias", found.bias_px), ("scatter", found.std_px))
        return Total(name, count, found.total_px, bias_and_scatter, True, is_plain(evaluation))
    parts = [(what, _rms_uv(part[where])) for what, part in evaluation.sigma_parts_px.items()]
    total = _uv(functools.reduce(np.hypot, (np.array(part) for _, part in parts)))
    return Total(name, count, total, tuple(parts), False, is_plain(evaluation))


def coverage_of(evaluation: Evaluation, where: NDArray[np.bool_]) -> Coverage | None:
    """Compare the errors of some vectors (ny, nx) with their total sigma; None without a known shift.

    An error of the stage is the same for all vectors: the median error is subtracted first, and the part of the
    map's sigma that is the same for all vectors likewise.
    """
    if evaluation.shift is None:
        return None
    field, sigma = evaluation.field, evaluation.relative_sigma_px
    errors = shift_errors(field, evaluation.shift.shift_px)
    errors = errors - np.nanmedian(errors.reshape(-1, 2), axis=0)
    known = where & np.isfinite(errors).all(axis=-1) & np.isfinite(sigma).all(axis=-1) & (sigma > 0.0).all(axis=-1)
    if not known.any():
        return None
    in_sigmas = np.abs(errors[known]) / sigma[known]
    ratio = _rms_uv(in_sigmas)
    share = independent_share(field.step_px, field.window_px)
    return Coverage(
        _uv(np.mean(in_sigmas < 1.0, axis=0)),
        _uv(np.mean(in_sigmas < 2.0, axis=0)),
        ratio,
        claim_of(float(np.hypot(*ratio) / np.sqrt(2.0)), 1.0, int(known.sum()), share),
    )


def _random(field: VectorField) -> NDArray[np.float64]:
    """Random sigma (ny, nx, 2) of the correlation."""
    return np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)


def _resolution(field: VectorField) -> NDArray[np.float64]:
    """Uncertainty by spatial resolution (ny, nx, 2), the same along u and v; NaN where it is not known."""
    found = field.resolution_px
    return np.full((*field.flags.shape, 2), np.nan) if found is None else np.stack((found, found), axis=-1)


def _rms_uv(values: NDArray[np.float64]) -> Pair:
    """Root mean square of the known of (N, 2), along u and v."""
    known = values[np.isfinite(values).all(axis=-1)]
    if not len(known):
        return float("nan"), float("nan")
    return _uv(np.sqrt(np.mean(np.square(known), axis=0)))


def _uv(pair: NDArray[np.float64]) -> Pair:
    return float(pair[0]), float(pair[1])


def mask_swatches(shares: Mapping[NodeStatus, float]) -> list[tuple[str, str, str]]:
    """Return colour, meaning and share of each status of nodes."""
    return [(web(COLOURS[status]), MEANING[status], f"{100 * share:.2f} %") for status, share in shares.items()]


def _by_region(
    evaluation: Evaluation,
    title: str,
    columns: tuple[str, ...],
    masks: Mapping[str, NDArray[np.bool_]],
    cells: Callable[[NDArray[np.bool_]], tuple[str, ...] | None],
) -> Table:
    """Table with a row for each region whose cells are known."""
    rows = [
        (region_label(name, evaluation), str(int(where.sum())), *found)
        for name, where in masks.items()
        if (found := cells(where)) is not None
    ]
    return Table(title, ("region", "vectors", *columns), rows)


def displacement_table(evaluation: Evaluation) -> Table:
    """Medians beside and behind the glass, v down, y up, and the median uncertainty of a vector.

    Velocities where the time between the frames is known.
    """
    field, dt_s = evaluation.field, evaluation.task.dt_s
    scale, sigma = per_px(evaluation.grid.pitch_mm, dt_s), evaluation.total_sigma_px
    name, unit = ("displacement", length_unit(evaluation.task.scene)) if dt_s is None else ("velocity", "m/s")

    def cells(where: NDArray[np.bool_]) -> tuple[str, ...]:
        u, v = float(np.median(field.u_px[where])), float(np.median(field.v_px[where]))
        unsure = ", ".join(f"{part * scale:.2g}" for part in np.median(sigma[where], axis=0))
        return f"{u:+z.3f}, {v:+z.3f}", f"{u * scale:+z.4f}, {-v * scale:+z.4f}", unsure

    columns = ("displacement u, v [px]", f"{name} x, y [{unit}]", f"its total sigma, median [{unit}]")
    masks = {total.region: total.where(evaluation) for total in totals_of(evaluation)}
    return _by_region(evaluation, "Median displacement: u right, v down; x right, y up", columns, masks, cells)


def shift_table(evaluation: Evaluation) -> Table:
    """Errors against the known shift."""
    result = evaluation.shift
    assert result is not None
    rows = [
        (
            region_label(name, evaluation),
            str(found.count),
            *(_pair(found.total_px), _pair_with_sign(found.bias_px), _pair(found.std_px), _pair(found.sigma_px)),
        )
        for name, found in result.regions.items()
    ]
    columns = ("region", "vectors", "total u, v", "bias u, v", "scatter u, v", "random sigma u, v")
    return Table(f"Errors against the known shift [{pixels_of(evaluation)}], v down", columns, rows)


def sigma_table(evaluation: Evaluation) -> Table:
    """Root mean square of each part of the uncertainty along u and v."""
    field, of_map = evaluation.field, evaluation.map_sigma
    random, unresolved = _random(field), _resolution(field)
    nothing = np.full_like(random, np.nan)
    place, moved = (nothing, nothing) if of_map is None else (of_map.position_px, of_map.displacement_px)
    return _by_region(
        evaluation,
        f"Standard uncertainty, rms [{pixels_of(evaluation)}]",
        ("random u, v", "not resolved u, v", "map: displacement u, v", "map: position u, v"),
        region_masks(evaluation),
        lambda where: tuple(_rms_pair(sigma[where]) for sigma in (random, unresolved, moved, place)),
    )


def claim_table(evaluation: Evaluation) -> Table:
    """Coverage of the total sigma by the errors; without rows where no shift is known.

    An offset that all vectors share, as an error of the stage, is subtracted from the errors and from sigma first.
    """

    def cells(where: NDArray[np.bool_]) -> tuple[str, ...] | None:
        found = coverage_of(evaluation, where)
        if found is None:
            return None
        inside = (f"{100 * u:.0f}, {100 * v:.0f} %" for u, v in (found.within_1, found.within_2))
        return *inside, "{:.2f}, {:.2f}".format(*found.ratio), found.claim

    masks = region_masks(evaluation)
    glass = (evaluation.regions.region == Region.GLASS) & evaluation.field.valid
    if glass.any():  # the region of the head of the page, before its parts
        masks = {GLASS: glass} | masks
    columns = ("within 1 sigma u, v", "within 2 sigma u, v", "rms of error / sigma u, v", "sigma is")
    return _by_region(evaluation, "Coverage of the stated uncertainty (68 and 95 %)", columns, masks, cells)


def count_table(field: VectorField) -> Table:
    """Vectors by what became of them."""
    return Table("", ("vectors", "count"), [(name, str(count)) for name, count in field.counts.items()])


def parts_of(regions: Regions) -> dict[str, NDArray[np.bool_]]:
    """Return the vectors (ny, nx) of the parts of a view, by their names in tables."""
    glass, middle = regions.region == Region.GLASS, regions.middle
    return {
        DIRECT: np.asarray(regions.region == Region.DIRECT),
        f"behind glass, r < {MIDDLE} R": middle,
        f"behind glass, r > {MIDDLE} R": np.asarray(glass & ~middle),
        "across a rim": np.asarray(regions.region == Region.RIM),
    }


def region_masks(evaluation: Evaluation) -> dict[str, NDArray[np.bool_]]:
    """Return measured vectors (ny, nx) by region."""
    measured = {name: where & evaluation.field.valid for name, where in parts_of(evaluation.regions).items()}
    return {name: where for name, where in measured.items() if where.any()}


def pixels_of(evaluation: Evaluation) -> str:
    """Return the unit of errors."""
    return "px" if is_plain(evaluation) else "px of the corrected frame"


def track_summary(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return tracks by region: number, and in corrected px the median sigma of a component and its rms error.

    The error and `within_sigma`, a share, are None where no true shift is known.
    """
    tracks = evaluation.tracks
    assert tracks is not None
    pitch, radius = evaluation.grid.pitch_mm, tracks.radius
    sigma = tracks.vectors.sigma_mm / pitch
    errors = None
    if evaluation.shift is not None:
        errors = tracks.vectors.shift_mm / pitch * (1.0, -1.0) - evaluation.shift.shift_px
    chosen = {
        DIRECT: tracks.vectors.branch == 0,
        f"behind glass, r < {MIDDLE} R": radius < MIDDLE,
        f"behind glass, r > {MIDDLE} R": radius >= MIDDLE,
    }
    return [
        {
            "region": name,
            "tracks": int(where.sum()),
            "median_sigma_px": float(np.median(sigma[where])),
            "rms_error_px": None if errors is None else float(np.sqrt(np.mean(np.square(errors[where])))),
            "within_sigma": None if errors is None else float(np.mean(np.abs(errors[where]) < sigma[where])),
        }
        for name, where in chosen.items()
        if where.any()
    ]


def track_table(evaluation: Evaluation) -> Table:
    """Tracks of single particles by region."""
    rows = [
        (
            str(found["region"]),
            str(found["tracks"]),
            f"{found['median_sigma_px']:.4f}",
            "-" if found["rms_error_px"] is None else f"{found['rms_error_px']:.4f}",
            "-" if found["within_sigma"] is None else f"{100 * found['within_sigma']:.0f} %",
        )
        for found in track_summary(evaluation)
    ]
    columns = ("region", "tracks", "median sigma", "rms error", "errors within 1 sigma")
    return Table("Displacement of single particles [px of the corrected frame]", columns, rows)


def image_table(figures: Mapping[str, ImageFigures], full_scale: float) -> Table:
    """Figures of merit of a frame, as acquired and corrected."""
    rows = [
        (
            name,
            f"{f.particles_per_px:.4f}",
            f"{f.diameter_u_px:.2f}, {f.diameter_v_px:.2f}",
            _ratio(f.signal_to_noise),
            f"{100 * f.saturated:.3f} %",
            str(f.nan_pixels),
        )
        for name, f in figures.items()
    ]
    columns = ("frame", "particles per px", "diameter u, v [px]", "signal to noise", "saturated", "NaN px")
    return Table(f"Figures of merit of the frame; saturated at {full_scale:.0f}", columns, rows)


def _ratio(signal_to_noise: float) -> str:
    """Signal-to-noise ratio; the noise may be too small to be separated from the particles."""
    if np.isinf(signal_to_noise):
        return "no noise seen"
    return "-" if np.isnan(signal_to_noise) else f"{signal_to_noise:.1f}"


def lead_of(total: Total) -> tuple[str, Table]:
    """Return the value at the head of a page, and the table of its parts, whose title names the value."""
    rows = []
    for name, pair in total.parts:
        known, form = ("common offset", "+z.4f") if name == "bias" else (name, ".4f")
        rows.append((known, *(format(part, form) for part in pair)))
    rows.append(("total (root sum of squares)", *(f"{part:.4f}" for part in total.total_px)))
    return "{:.4f}, {:.4f} px".format(*total.head_px), Table(total.label, ("[px]", "u", "v"), rows)


def offset_said(evaluation: Evaluation) -> str:
    """Attribute the common offset of all errors to stage or map; "" without a known shift.

    The stage moves everything alike: its offset is the same behind and beside the glass, within the uncertainty of
    the two means and of the fitted map, and no larger than twice the sigma of two of its positions.
    """
    result = evaluation.shift
    if result is None:
        return ""
    first, *others = totals_of(evaluation)
    offset = np.array(result.regions[first.region].bias_px)
    allowed_px = 2.0 * float(np.hypot(*result.stage_px))  # two positions, two components
    said = f"Common offset {_norm(offset)} px"
    if not others:
        return f"{said}, of the stage or of the map (the stage is allowed {allowed_px:.2g} px)."
    share = independent_share(evaluation.field.step_px, evaluation.field.window_px)
    means = [
        np.array(result.regions[total.region].std_px) / np.sqrt(max(1.0, share * total.count))
        for total in (first, *others)
    ]
    moved = evaluation.map_sigma
    by_map = 0.0 if moved is None else _rms_uv(moved.displacement_px[first.where(evaluation)])
    apart = np.abs(offset - result.regions[others[0].region].bias_px)
    if (apart > 3.0 * np.sqrt(np.square(means).sum(axis=0) + np.square(by_map))).any():
        beside = _norm(np.array(result.regions[others[0].region].bias_px))
        return f"{said}, and {beside} px beside the glass: the map or the scene is off by the difference."
    whose = "that is the stage" if np.hypot(*offset) <= allowed_px else "too much for the stage"
    return f"{said}, the same beside the glass: {whose} (allowed {allowed_px:.2g} px)."


def _norm(offset: NDArray[np.float64]) -> str:
    return f"{np.hypot(*offset):.3f}"


def budget_table(evaluation: Evaluation) -> Table:
    """Uncertainty of the comparison with the true shift, behind the glass."""
    result = evaluation.shift
    assert result is not None
    where = region_masks(evaluation).get(f"behind glass, r < {MIDDLE} R", evaluation.field.valid)
    rows = [
        ("correlation of one vector: scatter", _rms(_random(evaluation.field)[where])),
        ("stage, two positions: a common bias of all vectors", two_digits(float(np.hypot(*result.stage_px)))),
    ]
    if evaluation.map_sigma is not None:
        moved = evaluation.map_sigma.displacement_px[where]
        rows.insert(1, ("fitted map, displacement: smooth over the plane, the same in every pair", _rms(moved)))
    region = "" if is_plain(evaluation) else ", behind the glass"
    columns = ("source, and its effect", "standard uncertainty [px]")
    return Table(f"Budget of the comparison{region}", columns, rows)


def _pair(values: tuple[float, float]) -> str:
    return f"{values[0]:.4f}, {values[1]:.4f}"


def _pair_with_sign(values: tuple[float, float]) -> str:
    return f"{values[0]:+z.4f}, {values[1]:+z.4f}"


def _rms_pair(values: NDArray[np.float64]) -> str:
    """Rms of (N, 2) along u and v."""
    return ", ".join(_rms(values[:, component]) for component in range(2)) if np.isfinite(values).any() else "-"


def _rms(values: NDArray[np.float64]) -> str:
    known = values[np.isfinite(values)]
    return two_digits(float(np.sqrt(np.mean(known**2)))) if len(known) else "-"


def response_table(settings: PivSettings) -> Table:
    """Amplitude of waves in the vectors, by wavelength, far above the noise and below it."""
    window = settings.windows_px[-1]
    lengths = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
    strong, weak = response_of(settings, window * lengths)
    rows = [
        (f"{length:g} ({window * length:.0f} px)", f"{100 * high:.0f} %", f"{100 * low:.0f} %")
        for length, high, low in zip(lengths, strong, weak, strict=True)
    ]
    title = (
        f"Spatial resolution with windows of {settings.windows_text}: measured share of the amplitude of a"
        " velocity wave, by wavelength, for waves far above the noise and below it (linear theory of the passes)."
        " Smaller windows resolve more and are noisier (--final-window)"
    )
    return Table(title, ("wavelength, in windows", "far above the noise", "below the noise"), rows)
