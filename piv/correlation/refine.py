"""Residual displacement within a pixel, by weighted windows without a transform.

See `piv.correlation.kernels.lags`. A window whose correlation is not highest in the middle gives NaN: it has
to be searched as a whole.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.deform import DeformedPair
from piv.correlation.kernels.lags import SUMS, lag_sums, read_lags
from piv.correlation.windows import WindowGrid

LEAST_GAIN = 0.02  # beyond which a window knows nothing of its own, and its sigma says so
LEAST_MATCH = (
    0.25  # correlation where frames complete each other: strangers have less, and nothing can be searched
)
Floats = NDArray[np.float64]


class Refined(NamedTuple):
    """Peaks in the middle of the correlation: shift_px (ny, nx, 2), the others (ny, nx), sums (ny, nx, SUMS).

    `gain` is what differences between the frames are worth, see `DeformedPair`: as much of a displacement is seen,
    and shift_px is already corrected for it; `gain_squares` the mean of its square. valid_fraction counts filled
    pixels among the valid ones.
    """

    shift_px: Floats
    correlation: Floats
    valid_fraction: Floats
    sums: Floats
    gain: Floats
    gain_squares: Floats


def window_weights(size_px: int, window_sigma: float, half: bool = False) -> Floats:
    """Weights of the products along one axis: the square of those in each frame.

    Parameters
    ----------
    size_px : int
        Side of the window.
    window_sigma : float
        Standard deviation of the weights in each frame, in sides; 0 for none.
    half : bool
        At the middles between pixels, one fewer, with the same sum.

    Returns
    -------
    ndarray of float64, shape (size_px,) or (size_px - 1,)
    """
    x = np.arange(size_px) - (size_px - 1) / 2
    whole, between = (
        np.exp(-((place / (window_sigma * size_px)) ** 2)) if window_sigma else np.ones_like(place)
        for place in (x, x[:-1] + 0.5)
    )
    return between * (whole.sum() / between.sum()) if half else whole


def refine(pair: DeformedPair, grid: WindowGrid, window_sigma: float, threads: int | None = None) -> Refined:
    """Look for the displacement that is left, within a pixel.

    Parameters
    ----------
    pair : DeformedPair
        Frames deformed by what is known, and how far their pixels are valid.
    grid : WindowGrid
        Windows.
    window_sigma : float
        See `window_weights`.
    threads : int, optional
        Threads to use.
    """
    whole = window_weights(grid.size_px, window_sigma)
    sums = np.empty((*grid.shape, SUMS))
    column = np.ascontiguousarray(grid.column)  # a kernel is compiled once more for a slice
    weights = whole.astype(np.float32), window_weights(grid.size_px, window_sigma, half=True).astype(np.float32)

    def rows(first: int, last: int) -> None:
        columns = np.empty((SUMS, pair.a.shape[1]), np.float32)
        for j in range(first, last):
            lag_sums(pair.a, pair.b, pair.valid, grid.row[j], column, *weights, columns, sums[j])

    run_rows(rows, grid.shape[0], block=2, threads=threads)
    total = float(whole.sum())
    gain = squares = np.ones(grid.shape)
    if pair.worth is not None:
        gain, squares = (_means(part, grid, whole / total) for part in (pair.worth, np.square(pair.worth)))
    return read_windows(sums, total**2, pair.floor, gain, squares)


def read_windows(sums: Floats, total: float, floor: float, gain: Floats, gain_squares: Floats) -> Refined:
    """Find the peaks from sums over windows.

    Parameters
    ----------
    sums : ndarray of float64, shape (ny, nx, SUMS)
        See `piv.correlation.kernels.lags`.
    total : float
        Sum of a window's weights.
    floor : float
        Mean square up to which a window counts as constant.
    gain, gain_squares : ndarray of float64, shape (ny, nx)
        See `Refined`.
    """
    shape = sums.shape[:2]
    shift, correlation, share = np.empty((*shape, 2)), np.empty(shape), np.empty(shape)
    read_lags(sums.reshape(-1, SUMS), total, floor, shift.reshape(-1, 2), correlation.ravel(), share.ravel())
    if (gain == 1.0).all():
        return Refined(shift, correlation, share, sums, gain, gain_squares)
    gain = np.maximum(gain, LEAST_GAIN)
    # Frames that complete each other match there, whatever they show: what is left of their difference counts.
    power = sums[..., 8] + sums[..., 9]
    seen = power * gain_squares
    apart = np.divide(power - 2.0 * sums[..., 0], seen, out=np.ones_like(power), where=seen > 0.0)
    shift[~(1.0 - apart > LEAST_MATCH)] = np.nan
    return Refined(np.clip(shift / gain[..., None], -1.0, 1.0), 1.0 - apart, share, sums, gain, gain_squares)


def _means(values: NDArray[np.float32], grid: WindowGrid, weights: Floats) -> Floats:
    """Weighted means (ny, nx) of values (H, W) over windows."""
    lines = np.stack([weights @ values[row : row + grid.size_px] for row in grid.row])
    return np.stack([lines[:, column : column + grid.size_px] @ weights for column in grid.column], axis=-1)
