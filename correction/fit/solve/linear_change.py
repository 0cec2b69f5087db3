"""The difference of two scenes as one that derivatives of the map say.

Sigma follows changes of the full vector by derivatives of the map.  A lens that is far off makes other differences
than they say, which are zero elsewhere.  So to the change between two vectors is added what makes derivatives say,
as nearly as they can, what the two maps truly differ by, all over the view.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.solver import Corners, free_rates, landed
from correction.fit.solve.unknowns import Unknowns

ASKED_BESIDE, ASKED = 16, 48  # pixels each way, beside glass and behind it
NEGLIGIBLE = 0.02  # of a difference of maps


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
    normal, slope = np.eye(moving.shape[1]), np.zeros(moving.shape[1])
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    width, height = unknowns.scene.camera.sensor_px
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
        flat = (weight[:, None, None] * (rate @ moving)).reshape(-1, moving.shape[1])
        off = weight[:, None] * (differ - rate @ (other - full))
        normal += flat.T @ flat
        slope += flat.T @ off.ravel()
    return np.asarray(moving @ np.linalg.solve(normal, slope))
