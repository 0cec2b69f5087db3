"""Cells of an ensemble correlation that show something solid, which shines, and no flow.

Together three things tell a bright wall from a flow: dust on the glass stands still, with particles
moving behind it; where particles leave the sheet they have no partner; what is dark shows neither.

* A share of the light's squares stands still in all pairs, taken off frames as they are: in a wall 0.97, and 0.6
  when the sliding minimum of its frames is off and only the flicker of the laser is left of it.
* Of what does not stand still little has a partner in the other frame: the sum of R_AB over that of R_AA, about no
  displacement, is a small part of what is usual in the frame: 0.07 to 0.17 of it in walls, 0.66 in the first 8 px
  beside one that glares, 0.2 where four of five particles leave the sheet.
* A wall is large: cells count that make up squares of 2 x 2. A grain of dust is in one.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from piv.statistics.ensemble import EnsembleSums, Planes

FEWEST_PAIRS = 8  # fewer stand still by chance
LEAST_STILL, MOST_ALIKE = 0.25, 0.25  # of the light's squares; of the usual share with a partner
NEAR_PX, USUAL = 2, 75.0  # displacements that are summed; percentile over the cells


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
