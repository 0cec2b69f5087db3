"""Selection of corners on one smooth view of a flat target: those seen through something bent do not lie on it.

Seen through air, board and image are joined by a smooth map: a polynomial of order 5 follows any tilt and
any usable lens to a fraction of a pixel.  Corners seen through something that bends the view (glass left in
front of the target, a mirror) may be linked to the bare lattice at a rim and would be counted on with
indices that look right.  They do not lie on the smooth map of the others, and that shows them.

Dots of a plate's other level lie beside that map by another smooth one, of order 2.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

ORDER, LEVEL_ORDER = 5, 2  # of the map, and of what lies between both levels of a plate
LARGEST_SQUARES = 0.35  # from the smooth map, at most
SMALLEST_SQUARES = 0.03  # nothing is judged more finely than this
LEAST_OTHERS = 0.02  # of what says where a corner should be, that comes from others
TIMES_MEDIAN = 12.0  # of all deviations: between, the limit follows how well the map fits
APART_SQUARES = 0.3  # from where the largest piece says, at most
TORN_SQUARES = 0.1  # that neighbours may lie beside where the axes of both have them
KNEE_SQUARES, NARROWER = 0.15, 0.85  # deviations beyond weigh little; the same of each round of the second half
SELECTION_ROUNDS = 25


def on_smooth_map(
    index: NDArray[np.int64],
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    deep: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Corners (N,) that lie on one smooth map with the majority.

    Parameters
    ----------
    index : (N, 2) int
        Lattice indices.
    position_px : (N, 2) float
    axes_px : (N, 2, 2) float
        Image displacement by one square along each index.
    deep : (N,) bool, optional
        Which are on the other level of a plate.

    Notes
    -----
    Iteratively reweighted least squares with Cauchy weights squared, from a plane up to order 5 (less for few
    corners), so that a minority of foreign corners does not drag the map along.  Each is judged by what the others
    say without it: its deviation over 1 - h, with h the share of its own word in its place on the map, so that one
    at the end of the lattice does not bend the map to itself.
    """
    if not len(index):  # a frame in which nothing of the board was found
        return np.zeros(0, dtype=bool)
    size = max(float(np.ptp(index, axis=0).max()), 1.0)
    x, y = (2.0 * (index - index.mean(axis=0)) / size).T
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    across, down = np.vander(x, ORDER + 1, increasing=True).T, np.vander(y, ORDER + 1, increasing=True).T
    weight = np.ones(len(index))
    off = np.zeros(len(index))
    order, terms = 0, np.empty((len(index), 0))
    for round_ in range(SELECTION_ROUNDS):
        wanted = min(1 + round_ // 3, ORDER)
        powers = [(k, m) for k in range(wanted + 1) for m in range(wanted + 1 - k)]
        if 3 * len(powers) > len(index):
            break
        if wanted != order:
            order, terms = wanted, np.stack([across[k] * down[m] for k, m in powers], axis=-1)
            if deep is not None:
                beside = [across[k] * down[m] * deep for k, m in powers if k + m <= LEVEL_ORDER]
                terms = np.column_stack((terms, *beside))
        weighted = terms * weight[:, None] ** 2
        normal = weighted.T @ terms  # condition 1e3: fine squared; singular where all corners lie on few lines
        solution = np.linalg.lstsq(normal, weighted.T @ position_px, rcond=None)[0]
        own = np.sum(weighted * (terms @ np.linalg.pinv(normal)), axis=1)
        off = np.hypot(*(position_px - terms @ solution).T) / side / np.maximum(1.0 - own, LEAST_OTHERS)
        narrower = NARROWER ** max(0, round_ - SELECTION_ROUNDS // 2)
        knee = max(KNEE_SQUARES * narrower, SMALLEST_SQUARES, float(np.median(off)))
        weight = 1.0 / (1.0 + (off / knee) ** 2)
    limit = min(max(TIMES_MEDIAN * float(np.median(off)), SMALLEST_SQUARES), LARGEST_SQUARES)
    return np.asarray(off <= limit, dtype=bool)


def as_the_largest_piece_says(
    index: NDArray[np.int64],
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    deep: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Corners (N,) of the largest piece of lattice, and of those pieces apart that lie where it has them.

    Pieces apart are few corners at the end of a polynomial, or in a hole of it, which follows them wherever they
    lie: a view through a ball beside the board, or before it, passes for a part of it.  So they are judged by what
    the largest says without them, the more strictly the better it can: within it to SMALLEST_SQUARES, and far from
    it by as much more as its own word is worth less there.  Corners side by side that are not a square apart, by
    the axes of both, are of two pieces.

    Parameters
    ----------
    index, position_px, axes_px, deep
        As in `on_smooth_map`.
    """
    number = {(i, j): n for n, (i, j) in enumerate(index.tolist())}
    pairs = [
        (n, number[i + di, j + dj])
        for (i, j), n in number.items()
        for di, dj in ((1, 0), (0, 1))
        if (i + di, j + dj) in number
    ]
    count = len(index)
    start, end = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    along = np.where((index[end] - index[start])[:, None, 0] == 1, axes_px[start, :, 0], axes_px[start, :, 1])
    ahead = np.where((index[end] - index[start])[:, None, 0] == 1, axes_px[end, :, 0], axes_px[end, :, 1])
    miss = position_px[end] - position_px[start] - 0.5 * (along + ahead)
    holds = np.hypot(*miss.T) < TORN_SQUARES * np.hypot(*(0.5 * (along + ahead)).T)
    if deep is not None:  # levels of a plate lie beside each other by more
        holds |= deep[start] != deep[end]
    start, end = start[holds], end[holds]
    joined = scipy.sparse.coo_array((np.ones(len(start)), (start, end)), shape=(count, count))
    pieces, piece = scipy.sparse.csgraph.connected_components(joined, directed=False)
    if pieces < 2:  # usually
        return np.ones(count, dtype=bool)
    kept = np.asarray(piece == np.bincount(piece).argmax())
    x, y = ((index - index[kept].mean(axis=0)) / max(float(np.ptp(index[kept], axis=0).max()), 1.0)).T
    order = 3 if np.count_nonzero(kept) >= 30 else 2
    terms = np.stack([x**k * y**m for k in range(order + 1) for m in range(order + 1 - k)], axis=-1)
    if deep is not None:
        terms = np.column_stack((terms, deep, deep * x, deep * y))
    solution = np.linalg.lstsq(terms[kept], position_px[kept], rcond=None)[0]
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    worth = np.sum(terms * (terms @ np.linalg.pinv(terms[kept].T @ terms[kept])), axis=1)  # about p/n within it
    less = worth * np.count_nonzero(kept) / terms.shape[1]
    limit = np.minimum(SMALLEST_SQUARES * np.maximum(less, 1.0), APART_SQUARES)
    near = np.hypot(*(position_px - terms @ solution).T) < limit * side
    for other in range(pieces):
        kept |= (piece == other) & near[piece == other].all()
    return kept
