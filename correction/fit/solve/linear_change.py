"""The difference of two scenes as one that derivatives of the map say.

Sigma follows changes of the full vector by derivatives of the map.  A lens that is far off makes other differences
than they say, which are zero elsewhere.  So to the change between two vectors is added what makes derivatives say,
as nearly as they can, what the two maps truly differ by, all over the view.

Beside a rim, where the view turns over, derivatives say differences of hundreds of pixels that are not there, and
no addition takes them back: pixels off by far more than half of all (Cauchy's loss) weigh next to nothing.  With
equal weights two of three hundred made of a difference of 1 px one of 0.02 px.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.solver import Corners, free_rates, landed
from correction.fit.solve.unknowns import Unknowns

ASKED_BESIDE, ASKED = 16, 48  # pixels each way, beside glass and behind it
NEGLIGIBLE = 0.02  # of a difference of maps
ROUNDS = 12  # of weights by how far pixels are off


def as_linear(
    unknowns: Unknowns, full: NDArray[np.float64], other: NDArray[np.float64], moving: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What is to be added to a change (F,), from a full vector to another, that derivatives say what it does.

    All of the view is asked, since what fits corners may go anywhere beside them.

    Parameters
    ----------
    unknowns, full, other
        Of the fit, and the two vectors.
    moving : (F, K) float64
        Columns along which to add, by as little as does.
    """
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    width, height = unknowns.scene.camera.sensor_px
    rates, offs = [np.zeros((0, 2, moving.shape[1]))], [np.zeros((0, 2))]
    for glass, count in ((False, ASKED_BESIDE), (True, ASKED)):
        grid = np.meshgrid(np.linspace(0.0, width - 1.0, count), np.linspace(0.0, height - 1.0, count))
        pixels = np.stack(grid, axis=-1).reshape(-1, 2)
        asked = Corners(0, glass, pixels, np.zeros_like(pixels), 1.0)
        before, after = landed(every, full, asked), landed(every, other, asked)
        same = before.recovered & after.recovered & (before.key == after.key)
        if glass:  # differences beside the glass, often a hundred times larger, have been asked
            same &= before.key != landed(every, full, replace(asked, glass=False)).key
        rate = free_rates(every, full, asked, before)[same]
        differ = (after.point_mm - before.point_mm)[same]
        size = np.linalg.norm(differ, axis=1)
        if not len(size) or not np.median(size) > 0.0:
            continue
        weight = 1.0 / (NEGLIGIBLE * (size + np.median(size)))
        rates.append(weight[:, None, None] * (rate @ moving))
        offs.append(weight[:, None] * (differ - rate @ (other - full)))
    rate, off = np.concatenate(rates), np.concatenate(offs)
    step = np.zeros(moving.shape[1])
    for _ in range(ROUNDS):
        length = np.linalg.norm(off - rate @ step, axis=1)
        knee = max(float(np.median(length)), 1.0) if len(length) else 1.0
        root = 1.0 / np.hypot(1.0, length / knee)
        flat = (root[:, None, None] * rate).reshape(-1, len(step))
        normal, slope = flat.T @ flat + np.eye(len(step)), flat.T @ (root[:, None] * off).ravel()
        step = np.linalg.solve(normal, slope)
    return np.asarray(moving @ step)
