"""What does not move with the flow: background, reflections, dirt on the glass.

Where particles have moved by more than their own size, frames that show nothing else do not match at no
displacement. What matches there all the same, as a share of what the window holds, stands still; it draws every
vector to zero, and no uncertainty sees it.
"""

import numpy as np

from correction.evaluate.deform import DeformedPair
from correction.evaluate.prepare import Pair
from correction.evaluate.refine import refine
from correction.evaluate.settings import PivSettings
from correction.evaluate.vector_field import VectorField
from correction.evaluate.windows import WindowGrid

APART = 4.0  # displacement over the deviation of a particle image: of the correlation 2 % are left
FEWEST = 12  # windows, for a median


def static_share(pair: Pair, field: VectorField, settings: PivSettings, threads: int | None = None) -> float:
    """Share of the light that stands still, median over windows; NaN where all moves too little."""
    rows, columns = slice(None, None, 2), slice(None, None, 2)
    half = (field.window_px - 1) / 2
    grid = WindowGrid(
        (field.y_px[rows] - half).astype(np.int64),
        (field.x_px[columns] - half).astype(np.int64),
        field.window_px,
        2 * field.step_px,
    )
    far = np.hypot(field.u_px, field.v_px)[rows, columns] > APART * np.sqrt(pair.spread_px2)
    if np.count_nonzero(far) < FEWEST:
        return float("nan")
    still = refine(DeformedPair(pair.a, pair.b, pair.valid, pair.floor), grid, settings.window_sigma, threads)
    power = np.sqrt(still.sums[..., 8] * still.sums[..., 9])
    known = far & (power > 0.0)
    return float(np.median(still.sums[..., 0][known] / power[known])) if known.any() else float("nan")
