"""The figure that a reader wants next: the total error of a region, its parts, and whether sigma keeps its claim.

Where the true shift is known the total error of a region is the rms of its vectors' errors, u and v apart, and

    total^2 = bias^2 + scatter^2.

The bias may be the stage's (it moved the sheet by something else than it reported) or the map's; how large either
may be stands in the budget of the comparison, and is no part of the total.  Where no shift is known, the total is
what vectors are unsure of: random sigma of the correlation and map sigma, in squares.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.regions import Region
from correction.evaluate.shift import shift_errors
from correction.evaluate.verdicts import Claim, claim_of, independent_share
from piv.correlation.vector_field import VectorFlag
from rtpiv.analysis.pairs.evaluation import Evaluation

GLASS, DIRECT = "behind glass", "seen directly"
REGIONS = {GLASS: Region.GLASS, DIRECT: Region.DIRECT}
Pair = tuple[float, float]


@dataclass(frozen=True)
class Total:
    """Error, or without a known shift uncertainty, of the vectors of a region.

    Parameters
    ----------
    region : str
        Which vectors.
    count : int
        How many.
    total_px : (float, float)
        Along u and v.
    parts : tuple of (str, (float, float))
        What it is made of, in squares: none is larger than the total.
    is_error : bool
        True of an error against a known shift, False of an uncertainty.
    """

    region: str
    count: int
    total_px: Pair
    parts: tuple[tuple[str, Pair], ...]
    is_error: bool

    def nodes(self, evaluation: Evaluation) -> int:
        """Nodes of the region that are not masked: how many vectors could be measured there."""
        field = evaluation.field
        return int(
            np.count_nonzero(
                (evaluation.regions.region == REGIONS[self.region]) & (field.flags != VectorFlag.MASKED)
            )
        )

    def where(self, evaluation: Evaluation) -> NDArray[np.bool_]:
        """Its vectors (ny, nx)."""
        return np.asarray((evaluation.regions.region == REGIONS[self.region]) & evaluation.field.valid)

    @property
    def said(self) -> str:
        """What the total is."""
        what = "total error" if self.is_error else "total standard uncertainty"
        return f"{what} u, v of the {self.count} vectors {self.region}"


@dataclass(frozen=True)
class Coverage:
    """How errors compare with their sigma, along u and v: `inside` 1 and 2 sigma as shares, scatter over sigma."""

    within_1: Pair
    within_2: Pair
    ratio: Pair
    claim: Claim


def totals_of(evaluation: Evaluation) -> list[Total]:
    """Total of the vectors behind glass, then of those seen directly; regions without vectors are left out."""
    found = []
    for name, region in REGIONS.items():
        where = (evaluation.regions.region == region) & evaluation.field.valid
        if where.any():
            found.append(_total(evaluation, name, where))
    return found


def _total(evaluation: Evaluation, name: str, where: NDArray[np.bool_]) -> Total:
    field, result, joined = evaluation.field, evaluation.shift, evaluation.map_sigma
    count = int(where.sum())
    if result is not None:
        found = result.regions[name]
        return Total(
            name, count, found.total_px, (("bias", found.bias_px), ("scatter", found.std_px)), is_error=True
        )
    random = _rms(np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)[where])
    by_map = None if joined is None else _rms(joined.displacement_px[where])
    parts = [("random sigma", random)] + ([] if by_map is None else [("sigma by the fitted map", by_map)])
    return Total(name, count, _hypot(random, by_map or (0.0, 0.0)), tuple(parts), is_error=False)


def coverage_of(evaluation: Evaluation, where: NDArray[np.bool_]) -> Coverage | None:
    """Hold the errors of some vectors (ny, nx) against random and map sigma together; None without a known shift.

    What the stage missed is the same for all vectors: the median error is taken off first.
    """
    if evaluation.shift is None:
        return None
    field, joined = evaluation.field, evaluation.map_sigma
    errors = shift_errors(field, evaluation.shift.shift_px)
    errors = errors - np.nanmedian(errors.reshape(-1, 2), axis=0)
    sigma = np.stack((field.sigma_u_px, field.sigma_v_px), axis=-1)
    if joined is not None:
        sigma = np.hypot(sigma, np.nan_to_num(joined.displacement_px))
    known = where & np.isfinite(errors).all(axis=-1) & np.isfinite(sigma).all(axis=-1) & (sigma > 0.0).all(axis=-1)
    if not known.any():
        return None
    ratio = np.abs(errors[known]) / sigma[known]
    scatter, claimed = _rms(errors[known]), _rms(sigma[known])
    share = independent_share(field.step_px, field.window_px)
    normal = float(np.sqrt(np.mean(np.square(errors[known] / sigma[known]))))
    within_1, within_2 = np.mean(ratio < 1.0, axis=0), np.mean(ratio < 2.0, axis=0)
    return Coverage(
        (float(within_1[0]), float(within_1[1])),
        (float(within_2[0]), float(within_2[1])),
        (scatter[0] / claimed[0], scatter[1] / claimed[1]),
        claim_of(normal, 1.0, int(known.sum()), share),
    )


def _rms(values: NDArray[np.float64]) -> Pair:
    """Root mean square of the known of (N, 2), along u and v."""
    known = values[np.isfinite(values).all(axis=-1)]
    if not len(known):
        return float("nan"), float("nan")
    u, v = np.sqrt(np.mean(np.square(known), axis=0))
    return float(u), float(v)


def _hypot(one: Pair, other: Pair) -> Pair:
    return float(np.hypot(one[0], other[0])), float(np.hypot(one[1], other[1]))
