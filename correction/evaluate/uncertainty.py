"""Random uncertainty of each vector from correlation statistics (Wieneke, MST 26, 074002 (2015)).

At the final displacement both windows should match; what does not match is noise, and its effect on the
correlation peak can be added up.  Along one axis, with C0 = sum a b, C+ = sum a(x) b(x+1), C- = sum a(x+1) b(x),
the elementary asymmetry dC = a(x) b(x+1) - a(x+1) b(x) sums to C+ - C-, whose expectation is 0 and whose
variance is the sum of all covariances of dC, neighbouring pixels being correlated over a particle image:

1. dC is smoothed by (1, 2, 1)/4 along the axis, which takes out the negative covariance of pixel noise at
   one pixel's distance; its mean over the window is removed (a converged vector has sum dC = 0).
2. var = sum over shifts d of S(d) = sum dC(x) dC(x + d), ring by ring until a ring stays below 0.05 S(0).
3. With C = (C+ + C-)/2 and s = sqrt(var) the 3-point Gaussian fit moves by
   sigma = [ln(C + s/2) - ln(C - s/2)] / [4 ln C0 - 2 ln(C + s/2) - 2 ln(C - s/2)].

Only random error is seen: not peak locking, not gradients smaller than a window, not calibration.  The
estimate is meant for sigma below 0.3 px.
"""

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.correlate import CHUNK_BYTES, least_valid
from correction.evaluate.deform import DeformedPair
from correction.evaluate.windows import WindowGrid
from correction.kernels.piv_statistics import REACH, window_sigma
from correction.kernels.piv_windows import cut_windows
from tracer.rows import run_rows


def correlation_statistics(
    pair: DeformedPair, grid: WindowGrid, min_valid: float, threads: int | None = None
) -> NDArray[np.float64]:
    """Standard uncertainty of u and v for every window.

    Parameters
    ----------
    pair : DeformedPair
        Frames deformed by (nearly) the final field, and the pixels valid in both.
    grid : WindowGrid
        Windows.
    min_valid : float
        Share of valid pixels that a window needs.
    threads : int, optional
        Threads to use.

    Returns
    -------
    ndarray of float64, shape (ny, nx, 2)
        Sigma of u, v [px]; NaN where a window has too few valid pixels, no texture, or no clear peak.
    """
    ny, nx = grid.shape
    size = grid.size_px
    rows, columns = (
        np.ascontiguousarray(grid_.ravel()) for grid_ in np.meshgrid(grid.row, grid.column, indexing="ij")
    )
    sigma = np.empty((2, ny * nx))
    least = least_valid(grid, min_valid)

    def some(first: int, last: int) -> None:
        a, b = np.empty((2, last - first, size, size), np.float32)
        sums, raw = np.empty((3, size), np.float32), np.empty(size + 2, np.float32)
        field = np.zeros((size + 2 * REACH, size + 2 * REACH), np.float32)
        count, energy = np.empty(last - first, np.int64), np.empty(last - first)
        here = slice(first, last)
        cut_windows(pair.a, pair.b, pair.valid, rows[here], columns[here], least, sums[0], count, energy, a, b)
        window_sigma(a, b, energy, sums, raw, field, sigma[0, here])
        # Along columns it is the same sum over transposed windows.
        a, b = (np.ascontiguousarray(windows.transpose(0, 2, 1)) for windows in (a, b))
        window_sigma(a, b, energy, sums, raw, field, sigma[1, here])

    run_rows(some, ny * nx, block=max(1, CHUNK_BYTES // (4 * size * size)), threads=threads)
    return np.ascontiguousarray(sigma.reshape(2, ny, nx).transpose(1, 2, 0))
