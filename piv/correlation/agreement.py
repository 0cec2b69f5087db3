"""Measured resolution error of vectors: the displacement on which neighbouring blocks of the frames still agree.

No model of a spectrum says what windows leave out: the part that matters is the one that they do not show. The
frames do. Block by block they lean to one side (`piv.correlation.uncertainty`); with p, what a displacement of a
pixel makes of a block, and what the final vectors already tell taken off, there remains

    l = p r + n,

r what the flow does beyond the vectors at that place, n noise. Noise of blocks that share no particle image has
nothing in common. So for two blocks on opposite sides of a third, the products over many places add to

    sum l1 l2 = r^2 sum p1 p2,

and noise adds nothing to them. Taken from blocks around the nodes (`NEAR`: between nodes the spline errs too),
averaged over both components and the neighbours within half a window, r^2 is the mean square error of vectors,
whatever it comes from: waves that windows average out, at whatever overlap, light seen in the wrong place, detail
that went with the noise. In flows finer than windows of 32 px, and little noise, errors are 0.7 to 1.1 of the
sigma that comes of it, and were up to 2.2 of what vectors tell of themselves (ADR 38).

**How far it is to be believed.** Vectors follow the noise of the very blocks they are made of. Of N equal blocks
under a Gaussian window a vector takes e = sum w n/sum w p, whose covariance with the block in its middle is twice
its variance s^2; so where all detail is kept the products lack 4 s^2 of the whole error, and 5 s^2 after passes
(`FOLLOWED`, f, is the theory's), s^2 of one correlation or, if that is less, of the vector after the last filter.
Particle images of variance s_p^2 lean by less than in proportion, of a random displacement
(1 + s^2/(2 s_p^2))^-1.5. With that given back to a measurement m, what vectors miss beside their random variance
s_0^2 is

    x = max(m + f s^2 - s_0^2, 0).

Products are random by themselves too, by a deviation S which their scatter tells, so x counts by the share
x^4/(x^4 + (5 S)^4), and the model of `piv.correlation.resolution` by the rest. Of windows that were halved, what
halving explains is known as well: detail is in that already, the noise that vectors follow is not, so x adds to
it. A fifth of m is no part of that noise (`OF_FLOW`): what the flow does beyond the vectors makes windows
uncertain too, as they hold few particles. In windows of less than `LEAST_BLOCKS` a side both blocks of a pair have
made the vector, and agree on nothing beyond it: there nothing is measured (ADR 38, 81, 83).
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import map_parts
from piv.correlation.uncertainty import Blocks
from piv.correlation.windows import WindowGrid, interpolation_matrix

OPPOSITE = (1, 0), (0, 1), (1, 1), (1, -1)  # rows and columns to one block and, negative, to the other
NEAR = 0.8  # of a block's side: standard deviation of what belongs to a node
POOLED = 2.0  # windows: standard deviation of means over nodes
CLEAR_OF_CHANCE = 5.0  # times the chance deviation of a measurement
FOLLOWED = 4.0  # variances of noise that are given back
OF_FLOW = 0.2  # of what is measured: adds to the variance of windows
LEAST_BLOCKS = 10  # a side of windows whose vectors are measured
EDGE_BLOCKS = 2  # blocks at the edge of frames that lack pixels

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


class Agreed(NamedTuple):
    """Mean square (ny, nx) [px^2] of what vectors miss, by what blocks agree on, and its chance deviation.

    The first is less by the noise that vectors follow, see the top.
    """

    square_px2: Floats
    chance_px2: Floats


def measure_agreement(
    blocks: Blocks, grid: WindowGrid, beyond_px: Floats, weight: Floats, window_px: int
) -> Agreed:
    """Measure the displacement beyond the vectors on which pairs of blocks around each node agree.

    Parameters
    ----------
    blocks : Blocks
        Of the deformed frames.
    grid : WindowGrid
        Nodes of the vectors.
    beyond_px : ndarray of float64, shape (ny, nx, 2)
        Vectors less what has deformed the frames, finite everywhere.
    weight : ndarray of float64, shape (ny, nx)
        How much of a displacement the frames show there, from 0 to 1; 0 for vectors that do not count, of which
        nothing is measured.
    window_px : int
        Side of the usual windows.

    Returns
    -------
    Agreed
        Means over the neighbours (`POOLED`).
    """
    nodes = (grid.y_px, grid.x_px)
    rows, columns = (
        _weights(place, node, NEAR * blocks.side_px) for place, node in zip(blocks.centres, nodes, strict=True)
    )
    down, along = (
        interpolation_matrix(node, place, grid.step_px) for place, node in zip(blocks.centres, nodes, strict=True)
    )
    shown = np.square(weight)

    def sums_of(axis: int) -> tuple[Floats, Floats, Floats]:
        by_shift = blocks.by_shift[axis]
        known = down @ ((weight * beyond_px[..., axis]).astype(np.float32) @ along.T)
        pairs = _opposite(blocks.lean[axis] - known * by_shift)
        expected = shown * (rows @ _opposite(by_shift) @ columns.T)
        return rows @ pairs @ columns.T, expected, rows**2 @ pairs**2 @ (columns**2).T

    product, expected, square = np.zeros((3, *grid.shape))
    for of_component in map_parts(sums_of, range(2)):
        product, expected, square = product + of_component[0], expected + of_component[1], square + of_component[2]
    seen = weight > 0.0
    steps = POOLED * window_px / grid.step_px
    whole = np.maximum(_mean_over_nodes(np.where(seen, expected, 0.0), steps), 1e-30)
    # The square of a Gaussian is one of half its variance.
    scatter = _mean_over_nodes(np.where(seen, square, 0.0), steps / np.sqrt(2.0)) / max(
        4.0 * np.pi * steps**2, 1.0
    )
    chance = np.where(seen, np.sqrt(scatter) / whole, np.inf)
    return Agreed(_mean_over_nodes(np.where(seen, product, 0.0), steps) / whole, chance)


def resolution_of(
    measured: Agreed,
    modelled_px: Floats,
    is_halved: NDArray[np.bool_],
    sigma_px: Floats,
    one_px: Floats,
    spread_px2: float,
) -> Floats:
    """Standard deviation (ny, nx) of a component beside its random sigma: measured as far as it can be.

    Parameters
    ----------
    measured : Agreed
        What blocks agree on.
    modelled_px : ndarray of float64, shape (ny, nx)
        What the model says of it.
    is_halved : ndarray of bool, shape (ny, nx)
        Windows that were halved.
    sigma_px, one_px : ndarray of float64, shape (ny, nx, 2)
        Random sigma of the vectors, and of one correlation; NaN where not known.
    spread_px2 : float
        Variance of a particle image.
    """
    random, noise = (np.nan_to_num(np.square(part).mean(axis=-1), nan=1.0) for part in (sigma_px, one_px))
    of_noise = np.maximum(np.minimum(random, noise) - OF_FLOW * np.maximum(measured.square_px2, 0.0), 0.0)
    followed = FOLLOWED * of_noise * (1.0 + 0.5 * noise / spread_px2) ** -1.5
    beyond = np.maximum(measured.square_px2 + followed - random, 0.0)
    share = 1.0 / (1.0 + (CLEAR_OF_CHANCE * measured.chance_px2 / np.maximum(beyond, 1e-12)) ** 4)
    return np.asarray(np.sqrt(np.where(is_halved, 1.0, 1.0 - share) * np.square(modelled_px) + share * beyond))


def _opposite(values: Singles) -> Singles:
    """Sum (rows, columns) of the products of blocks on opposite sides of each, in four directions."""
    total = np.zeros_like(values)
    rows, columns = values.shape
    inner = slice(EDGE_BLOCKS, rows - EDGE_BLOCKS), slice(EDGE_BLOCKS, columns - EDGE_BLOCKS)
    for down, right in OPPOSITE:
        one, other = (
            values[
                EDGE_BLOCKS + s * down : rows - EDGE_BLOCKS + s * down,
                EDGE_BLOCKS + s * right : columns - EDGE_BLOCKS + s * right,
            ]
            for s in (1, -1)
        )
        total[inner] += one * other
    return total


def _weights(place_px: Floats, node_px: Floats, deviation_px: float) -> Singles:
    """Weights (nodes, places) of a Gaussian around each node."""
    off = (place_px[None] - node_px[:, None]) / deviation_px
    return np.where(np.abs(off) < 5.0, np.exp(-0.5 * off**2), 0.0).astype(np.float32)


def _mean_over_nodes(values: Floats, reach_steps: float) -> Floats:
    pooled: Floats = scipy.ndimage.gaussian_filter(values, reach_steps, mode="constant")
    return pooled
