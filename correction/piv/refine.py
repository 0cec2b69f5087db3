"""What is left of the displacement where it is known to a pixel: weighted windows, no transform.

See `correction.piv.kernels.lags`. A window whose correlation is not highest in the middle gives NaN: it has
to be searched as a whole.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from correction.piv.deform import DeformedPair
from correction.piv.kernels.lags import SUMS, lag_sums, read_lags
from correction.piv.windows import WindowGrid
from ground.rows import run_rows

Floats = NDArray[np.float64]


class Refined(NamedTuple):
    """What the middle of the correlation says: shift_px (ny, nx, 2), the others (ny, nx), sums (ny, nx, SUMS)."""

    shift_px: Floats
    correlation: Floats
    valid_fraction: Floats
    sums: Floats


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
    shift, correlation, share = np.empty((*grid.shape, 2)), np.empty(grid.shape), np.empty(grid.shape)
    weights = whole.astype(np.float32), window_weights(grid.size_px, window_sigma, half=True).astype(np.float32)
    total = float(whole.sum()) ** 2

    def rows(first: int, last: int) -> None:
        columns = np.empty((SUMS, pair.a.shape[1]), np.float32)
        for j in range(first, last):
            lag_sums(pair.a, pair.b, pair.valid, grid.row[j], grid.column, *weights, columns, sums[j])
            read_lags(sums[j], total, pair.floor, shift[j], correlation[j], share[j])

    run_rows(rows, grid.shape[0], block=2, threads=threads)
    return Refined(shift, correlation, share, sums)
