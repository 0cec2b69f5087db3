"""The difference of two scenes as one that derivatives of the map say.

Sigma follows changes of the full vector by derivatives of the map.  A lens that is far off makes other differences
than they say, which are zero elsewhere.  So to the change between two vectors is added what makes derivatives say,
as nearly as they can, what the two maps truly differ by, all over the view.

Beside a rim, where the view turns over, derivatives say differences of hundreds of pixels that are not there, and
no addition takes them back: pixels off by far more than half of their region (Cauchy's loss) weigh next to
nothing.  With equal weights two of three hundred made of a difference of 1 px one of 0.02 px.

What derivatives do not say after all is an error of either direction: where a difference of 1 px crosses zero, one
that is said to a hundredth crosses elsewhere.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from correction.fit.solve.solver import Corners, free_rates, land_corners
from correction.fit.solve.unknowns import Unknowns

ASKED_BESIDE, ASKED = 16, 48  # pixels each way, beside glass and behind it
NEGLIGIBLE = 0.02  # of a difference of maps
MEDIAN = 1.1774  # of the length of two errors of standard deviation 1
SINGULAR = 1e-12
REWEIGHTING_ROUNDS = 12  # of weights by how far pixels are off


def as_linear(
    unknowns: Unknowns, full: NDArray[np.float64], other: NDArray[np.float64], moving: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return the addition to a change of the full vector with which derivatives give the true difference of maps.

    All of the view is asked, since what fits corners may go anywhere beside them.

    Parameters
    ----------
    unknowns, full, other
        Of the fit, and the two vectors.
    moving : (F, K) float64
        Columns along which to add, by as little as does.

    Returns
    -------
    added : (F,) float64
    unsaid_px : (float, float)
        Standard deviation per axis of what derivatives still do not say, beside glass and behind it, raw px.
    """
    every = replace(unknowns, columns=np.eye(len(full)), names=unknowns.full_names)
    width, height = unknowns.scene.camera.sensor_px
    regions: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    to_raw: dict[bool, NDArray[np.float64]] = {}
    for glass, count in ((False, ASKED_BESIDE), (True, ASKED)):
        grid = np.meshgrid(np.linspace(0.0, width - 1.0, count), np.linspace(0.0, height - 1.0, count))
        pixels = np.stack(grid, axis=-1).reshape(-1, 2)
        asked = Corners(0, glass, pixels, np.zeros_like(pixels), 1.0)
        before, after = land_corners(every, full, asked), land_corners(every, other, asked)
        same = before.recovered & after.recovered & (before.key == after.key)
        if glass:  # differences beside the glass, often a hundred times larger, have been asked
            same &= before.key != land_corners(every, full, replace(asked, glass=False)).key
        rate = free_rates(every, full, asked, before)[same]
        differ = (after.point_mm - before.point_mm)[same]
        size = np.linalg.norm(differ, axis=1)
        if not len(size) or not np.median(size) > 0.0:
            continue
        weight = 1.0 / (NEGLIGIBLE * (size + np.median(size)))
        off = weight[:, None] * (differ - rate @ (other - full))
        regions.append((weight[:, None, None] * (rate @ moving), off))
        to_raw[glass] = np.linalg.inv(before.pixel_rate[same]) / weight[:, None, None]
    step = np.zeros(moving.shape[1])
    for _ in range(REWEIGHTING_ROUNDS):
        normal, slope = np.eye(len(step)), np.zeros(len(step))
        for rate, off in regions:
            length = np.linalg.norm(off - rate @ step, axis=1)
            root = 1.0 / np.hypot(1.0, length / max(float(np.median(length)), 1.0))
            flat = (root[:, None, None] * rate).reshape(-1, len(step))
            normal += flat.T @ flat
            slope += flat.T @ (root[:, None] * off).ravel()
        scale = np.diagonal(normal) ** -0.5  # numbers of which nothing was known are free to follow one another
        equal = normal * np.outer(scale, scale)
        step = scale * np.linalg.lstsq(equal, scale * slope, rcond=SINGULAR)[0]
    unsaid = {False: 0.0, True: 0.0}
    for (glass, back), (rate, off) in zip(to_raw.items(), regions, strict=True):
        left = (back @ (off - rate @ step)[:, :, None])[:, :, 0]
        unsaid[glass] = float(np.median(np.linalg.norm(left, axis=1))) / MEDIAN
    return np.asarray(moving @ step), (unsaid[False], unsaid[True])
