"""The verdict on sigma of a pair: by its errors where they are known, else a word about what is not judged."""

import numpy as np
from numpy.typing import NDArray

from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.report.tables import Coverage, coverage_of, is_plain, region_label, region_masks

HALF_LOG_2 = 0.5 * np.log(2.0)  # of two components that are right


def sigma_verdict(evaluation: Evaluation) -> str:
    """Return the verdict on sigma: by the errors if they are known, else where it is largest, and of what."""
    if (worst := worst_claim(evaluation)) is not None:
        return claim_said(*worst)
    if evaluation.shift is not None:
        return "sigma is not judged: too few vectors"
    masks = region_masks(evaluation)
    sizes = {name: _rms(evaluation.total_sigma_px[where]) for name, where in masks.items()}
    known = {name: size for name, size in sizes.items() if np.isfinite(size)}
    unjudged = "sigma is not judged: the true displacement is not known"
    if not known:
        return unjudged
    name = max(known, key=lambda name: known[name])
    parts = {what: _rms(part[masks[name]]) for what, part in evaluation.sigma_parts_px.items()}
    main = max(parts, key=lambda what: np.nan_to_num(parts[what]))
    there = "" if is_plain(evaluation) else f" {name}"
    return f"{unjudged}; it is largest{there}, {known[name]:.2g} px, most of it {main}"


def worst_claim(evaluation: Evaluation) -> tuple[str, Coverage] | None:
    """Return the region whose sigma is the farthest off, with what was found there; None without a known shift.

    Where sigma is too small counts before where it is too large, and a region before all of which it is a part: an
    average of too small and too large would be right.
    """
    found = {name: coverage_of(evaluation, where) for name, where in region_masks(evaluation).items()}
    judged = {name: one for name, one in found.items() if one is not None and one.claim != "too few vectors"}
    if not judged:
        return None
    order = {"too small": 2, "too large": 1, "as claimed": 0}
    name = max(
        judged,
        key=lambda name: (order[judged[name].claim], abs(np.log(np.hypot(*judged[name].ratio)) - HALF_LOG_2)),
    )
    return region_label(name, evaluation), judged[name]


def claim_said(region: str, found: Coverage) -> str:
    """Return a verdict on sigma, as "across a rim 1.7 times too small"."""
    times = float(np.hypot(*found.ratio)) / np.sqrt(2.0)
    if found.claim == "as claimed":
        return "sigma is as claimed in every region"
    return f"sigma is {max(times, 1.0 / times):.2g} times {found.claim} {region}"


def _rms(values: NDArray[np.float64]) -> float:
    """Root mean square of a component of the known of (N, 2); NaN if there are none."""
    known = values[np.isfinite(values).all(axis=-1)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
