"""The verdict on the sigma of a pair whose shift is known: that of its worst region."""

import numpy as np

from rtpiv.analysis.pairs.evaluation import Evaluation
from rtpiv.analysis.report.tables import Coverage, coverage_of, region_label, region_masks

HALF_LOG_2 = 0.5 * np.log(2.0)  # of two components that are right


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
