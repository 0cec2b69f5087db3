"""The plane of the sheet from heights of cells: weighted least squares with what was known before.

Unknown are corrections of z and of the two slopes; each cell says  dz + x da + y db = height +- sigma.  Cells that
lie off by more than they may are given less weight (Huber).  If the rest scatters more than its sigmas say, all of
these are enlarged.  Errors that cells share (`Disparities.common_mm`) are unknowns beside the plane, each 0 +- 1:
so what they make of the plane stays in its covariance however many cells there are.  If kinds of views disagree,
or something moved across D, the sheet alone is not what is off.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.light_sheet.disparities import BLOCKS, Disparities

TUNING, FARTHEST = 1.5, 5.0  # usual deviations from which on a cell counts less, and not at all
FALSE_ALARMS = 0.001
ROUNDS = 20
LEAST_ACROSS_PX, LEAST_APART_MM = 0.08, 0.03  # what corner and particle models leave; less is no finding
LEAST_SHARE = 0.05  # the same, of the width of the peaks


@dataclass(frozen=True)
class PlaneFit:
    """Correction of the sheet's plane.

    Parameters
    ----------
    step : (3,) float64
        dz [mm], da, db.
    covariance : (3, 3) float64
        With what was known before.
    scatter : float
        Root of chi^2 a degree of freedom of the cells' heights; sigmas are enlarged by it if it is above 1.
    residual_mm : (C,) float64
        Heights of cells minus the plane, and minus what is common to them.
    weight : (C,) float64
        1, or less for cells that lie off.
    across_px : float
        Weighted rms of the disparities across D beyond their sigmas; 0 if chance makes as much.
    kinds_mm : dict
        Kind -> mean height of its cells over the plane found, and sigma.
    """

    step: NDArray[np.float64]
    covariance: NDArray[np.float64]
    scatter: float
    residual_mm: NDArray[np.float64]
    weight: NDArray[np.float64]
    across_px: float
    kinds_mm: dict[int, tuple[float, float]]

    @property
    def kinds_disagree(self) -> bool:
        """Whether some kind of views sees another height than the plane of all."""
        limit = float(np.sqrt(scipy.stats.chi2.isf(FALSE_ALARMS / max(len(self.kinds_mm), 1), 1)))
        return len(self.kinds_mm) > 1 and any(
            abs(off) > max(limit * sigma, LEAST_APART_MM) for off, sigma in self.kinds_mm.values()
        )


def fit_plane(found: Disparities, known: NDArray[np.float64], covariance: NDArray[np.float64]) -> PlaneFit:
    """Fit the plane.

    Parameters
    ----------
    found : Disparities
        Of at least one cell.
    known : (3,) float64
        What was known before of (dz, da, db), relative to the plane of the map.
    covariance : (3, 3) float64
        Of what was known.
    """
    design = np.column_stack((np.ones(len(found.kind)), found.place_mm, found.common_mm))
    height, sigma = found.height_mm, found.height_sigma_mm
    before = np.eye(design.shape[1])
    before[:3, :3] = np.linalg.inv(covariance)
    expected = np.concatenate((known, np.zeros(len(before) - 3)))
    share, scatter, answer = np.ones(len(height)), 1.0, expected
    for _ in range(ROUNDS):
        weight = share / (sigma * scatter) ** 2
        normal = design.T @ (weight[:, None] * design) + before
        answer = np.asarray(np.linalg.solve(normal, design.T @ (weight * height) + before @ expected), np.float64)
        off = np.abs(height - design @ answer) / sigma
        usual = max(1.0, 1.4826 * float(np.median(off)))
        share = np.where(off < FARTHEST * usual, np.minimum(1.0, TUNING * usual / np.maximum(off, 1e-9)), 0.0)
        freedom = max(1.0, float(share.sum()) - 3.0)
        scatter = max(1.0, float(np.sqrt(np.sum(share * off**2) / freedom)))
    residual = height - design @ answer
    kinds = {}
    for kind in np.unique(found.kind):
        here = found.kind == kind
        trust = share[here] / (sigma[here] * scatter) ** 2
        if trust.sum() > 0.0:
            kinds[int(kind)] = (float(trust @ residual[here] / trust.sum()), float(1.0 / np.sqrt(trust.sum())))
    covered = np.asarray(np.linalg.inv(normal)[:3, :3], np.float64)
    return PlaneFit(answer[:3], covered, scatter, residual, share, _across(found, share), kinds)


def _across(found: Disparities, share: NDArray[np.float64]) -> float:
    """Disparity across D beyond what chance makes [px], of cells that count."""
    off, sigma = found.across_px[share > 0.0], found.across_sigma_px[share > 0.0]
    unsure = (BLOCKS - 1.0) / (BLOCKS - 3.0)  # of sigmas that ten parts of the frames have told
    if np.sum((off / sigma) ** 2) < unsure * scipy.stats.chi2.isf(FALSE_ALARMS, len(off)):
        return 0.0
    weight = sigma**-2.0
    excess = float(np.sum(weight * (off**2 - sigma**2)) / weight.sum())
    size = float(np.sqrt(max(excess, 0.0)))
    widest_px = float(found.width_px[share > 0.0].max())
    return size if size > max(LEAST_ACROSS_PX, LEAST_SHARE * widest_px) else 0.0
