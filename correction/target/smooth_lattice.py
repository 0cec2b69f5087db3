"""A lattice seen through air bends as a lens bends it, and no more.

Seen through air, board and image are joined by a smooth map: a polynomial of order 5 follows any tilt and
any usable lens to a fraction of a pixel.  Corners seen through something that bends the view (glass left in
front of the target, a mirror) may be linked to the bare lattice at a rim and would be counted on with
indices that look right.  They do not lie on the smooth map of the others, and that shows them.
"""

import numpy as np
from numpy.typing import NDArray

ORDER = 5
LARGEST_SQUARES = 0.35  # from the smooth map, at most
SMALLEST_SQUARES = 0.03  # nothing is judged more finely than this
TIMES_MEDIAN = 12.0  # of all deviations: between, the limit follows how well the map fits
KNEE_SQUARES = 0.15  # deviations beyond weigh little
ROUNDS = 25


def on_smooth_map(
    index: NDArray[np.int64], position_px: NDArray[np.float64], axes_px: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Corners (N,) that lie on one smooth map with the majority.

    Parameters
    ----------
    index : (N, 2) int
        Lattice indices.
    position_px : (N, 2) float
    axes_px : (N, 2, 2) float
        Image displacement by one square along each index.

    Notes
    -----
    Iteratively reweighted least squares with Cauchy weights squared, from a plane up to order 5 (less for few
    corners), so that a minority of foreign corners does not drag the map along.
    """
    if not len(index):  # a frame in which nothing of the board was found
        return np.zeros(0, dtype=bool)
    size = max(float(np.ptp(index, axis=0).max()), 1.0)
    x, y = (2.0 * (index - index.mean(axis=0)) / size).T
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    weight = np.ones(len(index))
    off = np.zeros(len(index))
    for round_ in range(ROUNDS):
        order = min(1 + round_ // 3, ORDER)
        powers = [(k, m) for k in range(order + 1) for m in range(order + 1 - k)]
        if 3 * len(powers) > len(index):
            break
        terms = np.stack([x**k * y**m for k, m in powers], axis=-1)
        weighted = terms * weight[:, None] ** 2
        solution = np.linalg.solve(weighted.T @ terms, weighted.T @ position_px)  # condition 1e3: fine squared
        off = np.hypot(*(position_px - terms @ solution).T) / side
        knee = max(KNEE_SQUARES, float(np.median(off)))
        weight = 1.0 / (1.0 + (off / knee) ** 2)
    limit = min(max(TIMES_MEDIAN * float(np.median(off)), SMALLEST_SQUARES), LARGEST_SQUARES)
    return np.asarray(off <= limit, dtype=bool)
