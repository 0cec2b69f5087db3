"""Windows of several sizes around the same nodes, from the sums of the smallest.

All that is known of a window are sums of products, each with its place's weight. So a larger window is a weighted
sum of small ones around its node: with Gaussian weights of variance s^2 and a Gaussian of variance b^2 over the
nodes the large window's weights have s^2 + b^2. Nothing is sampled or multiplied anew, and every place can have
the window it needs. Sums of squared weights, on which noise depends, follow too: the square of a Gaussian is one
of half its variance, so they are blurred with b^2/2, and are lower by s^2/(s^2 + b^2) since weights are spread
over more places. At the edge of a frame there are fewer small windows, and all is over the share that is there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piv.correlation.planes import GAUSSIAN_REACH, smooth_field
from piv.correlation.refine import Refined, read_windows, window_weights
from piv.correlation.uncertainty import CorrelationAsymmetry
from piv.correlation.windows import WindowGrid

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    """Window of each node.

    Parameters
    ----------
    sides_px : tuple of int
        Sides there are, the smallest first: that of the grid's own windows.
    which : ndarray of int64, shape (ny, nx)
        Number of a node's side.
    """

    sides_px: tuple[int, ...]
    which: NDArray[np.int64]

    @property
    def side_px(self) -> NDArray[np.int64]:
        """Side (ny, nx) of each node's window."""
        return np.asarray(self.sides_px)[self.which]

    def pick(self, parts: list[NDArray[Any]]) -> NDArray[Any]:
        """Choose from arrays (ny, nx, ...) of every size the values of each node's own size."""
        found = parts[0].copy()
        for number, part in enumerate(parts[1:], 1):
            found[self.which == number] = part[self.which == number]
        return found

    def smooth_field(
        self, field: Floats, good: NDArray[np.bool_], smoothing: Callable[[int], tuple[float, int]]
    ) -> Floats:
        """Field smoothed as the side of each place asks for, in steps and order; sides change over two nodes."""
        total, weights = np.zeros(field.shape), np.zeros(self.which.shape)
        for number, side in enumerate(self.sides_px):
            here = self.which == number
            if here.any():
                weight = blur_nodes(here.astype(np.float64), 1.0)
                total += weight[..., None] * smooth_field(field, good, *smoothing(side))
                weights += weight
        return np.asarray(total / weights[..., None])


def choose_sizes(raw: Refined, sizes: Sizes, grid: WindowGrid, window_sigma: float, floor: float) -> Refined:
    """Read the windows of each node's own size from the sums of the smallest."""
    wide = [raw, *(widen(raw, grid, side, window_sigma, floor) for side in sizes.sides_px[1:])]
    return Refined(*(sizes.pick(list(parts)) for parts in zip(*wide, strict=True)))


def widen(raw: Refined, grid: WindowGrid, side_px: int, window_sigma: float, floor: float) -> Refined:
    """Read windows of `side_px` at the nodes of `grid` from the sums of smaller ones."""
    sums, gain, squares = (
        widen_sums(part, grid, side_px, window_sigma) for part in (raw.sums, raw.gain, raw.gain_squares)
    )
    total = float(window_weights(grid.size_px, window_sigma).sum()) ** 2
    return read_windows(sums, total, floor, gain, squares)


def asymmetry_of_sizes(
    lean: CorrelationAsymmetry, grid: WindowGrid, sizes: Sizes, window_sigma: float
) -> CorrelationAsymmetry:
    """Asymmetry of the correlation of windows of each node's own size."""
    parts = [lean]
    for side in sizes.sides_px[1:]:
        light = widen_sums(lean.light, grid, side, window_sigma)
        variance, squares = (
            widen_squares(part, grid, side, window_sigma) for part in (lean.variance, lean.squares)
        )
        parts.append(CorrelationAsymmetry(variance, light, squares))
    return CorrelationAsymmetry(*(sizes.pick(list(part)) for part in zip(*parts, strict=True)))


def sums_of_sizes(grid: WindowGrid, sizes: Sizes, window_sigma: float, values: Floats) -> tuple[Floats, Floats]:
    """Sums (ny, nx) over windows of each node's size, from those over the windows of `grid`; and the sides."""
    own = window_weights(grid.size_px, window_sigma).sum()
    parts = [values]
    for side in sizes.sides_px[1:]:
        more = float(window_weights(side, window_sigma).sum() / own)
        parts.append(widen_sums(values, grid, side, window_sigma) * more**2)
    return sizes.pick(parts), np.asarray(sizes.side_px, np.float64)


def widen_sums(values: Floats, grid: WindowGrid, side_px: int, window_sigma: float) -> Floats:
    """Sums (ny, nx[, n]) over windows of `side_px`, as means of those over the windows of `grid`."""
    more = _more_steps(grid, side_px, window_sigma)
    found = blur_nodes(values, more)
    return found / _there(values, more)


def match_around(raw: Refined | None, grid: WindowGrid, side_px: int, window_sigma: float) -> Floats:
    """Correlation (ny, nx) in windows of `side_px` of frames as they are deformed, from what those of `grid` show.

    0 after a pass that has searched.
    """
    if raw is None:
        return np.zeros(grid.shape)
    sums = widen_sums(raw.sums[..., [0, 8, 9]].copy(), grid, side_px, window_sigma)
    power = np.sqrt(sums[..., 1] * sums[..., 2])
    return np.divide(sums[..., 0], power, out=np.zeros_like(power), where=power > 0.0)


def widen_squares(values: Floats, grid: WindowGrid, side_px: int, window_sigma: float) -> Floats:
    """The same for sums (ny, nx[, n]) over the squares of weights."""
    more = _more_steps(grid, side_px, window_sigma)
    own, wide = (variance_px2(side, window_sigma) for side in (grid.size_px, side_px))
    found = blur_nodes(values, more / np.sqrt(2.0)) * (own / wide)
    return found / np.square(_there(values, more))


def blur_nodes(values: Floats, sigma_steps: float) -> Floats:
    """Values (ny, nx[, n]) under a Gaussian over nodes; nothing is beyond the grid."""
    import cv2

    if sigma_steps <= 0.0:
        return values
    reach = int(np.ceil(GAUSSIAN_REACH * sigma_steps))
    bell = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1.0) / sigma_steps))
    bell /= bell.sum()
    found: Any = cv2.sepFilter2D(values, -1, bell, bell, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float64)


def variance_px2(side_px: int, window_sigma: float) -> float:
    """Variance of a window's weights along one axis."""
    weights, place = window_weights(side_px, window_sigma), np.arange(side_px) - (side_px - 1) / 2
    return float((weights * place**2).sum() / weights.sum())


def _there(values: Floats, sigma_steps: float) -> Floats:
    """Share of a Gaussian that lies on the grid, in the shape of `values` but for its last axes."""
    share = blur_nodes(np.ones(values.shape[:2]), sigma_steps)
    return share.reshape(*share.shape, *(1,) * (values.ndim - 2))


def _more_steps(grid: WindowGrid, side_px: int, window_sigma: float) -> float:
    """Standard deviation of the Gaussian that widens the windows of `grid` [steps]."""
    own, wide = (variance_px2(side, window_sigma) for side in (grid.size_px, side_px))
    return float(np.sqrt(max(wide - own, 0.0))) / grid.step_px
