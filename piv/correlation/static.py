"""What does not move with the flow: background, reflections, dirt on the glass.

Where particles have moved by more than their own size, frames that show nothing else do not match at no
displacement. What matches there all the same, as a share of what the window holds, stands still; it draws every
vector to zero, and no uncertainty sees it.
"""

import numpy as np
from numpy.typing import NDArray

from piv.correlation.deform import DeformedPair
from piv.correlation.refine import refine
from piv.correlation.vector_field import VectorField
from piv.correlation.windows import WindowGrid

APART = 4.0  # displacement over the deviation of a particle image: of the correlation 2 % are left
FEWEST = 12  # windows, for a median

Floats = NDArray[np.float64]


def still_correlation(pair: DeformedPair, grid: WindowGrid, window_sigma: float, threads: int | None) -> Floats:
    """Correlation coefficient at no displacement, for every second window of each direction; `pair` undeformed."""
    every = slice(None, None, 2)
    coarse = WindowGrid(grid.row[every], grid.column[every], grid.size_px, 2 * grid.step_px)
    sums = refine(pair, coarse, window_sigma, threads).sums
    power = np.sqrt(sums[..., 8] * sums[..., 9])
    return np.where(power > 0.0, sums[..., 0] / np.where(power > 0.0, power, 1.0), np.nan)


def static_share(still: Floats, field: VectorField, spread_px2: float) -> float:
    """Share of the light that stands still, median over windows; NaN where all moves too little.

    Parameters
    ----------
    still : ndarray of float64
        From `still_correlation`, on the grid of `field`.
    field : VectorField
        How far it moves.
    spread_px2 : float
        Variance of a particle image.
    """
    far = np.hypot(field.u_px, field.v_px)[::2, ::2] > APART * np.sqrt(spread_px2)
    known = still[far & np.isfinite(still)]
    return float(np.median(known)) if len(known) >= FEWEST else float("nan")
