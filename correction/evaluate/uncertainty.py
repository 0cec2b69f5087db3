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

4. That is the noise of one correlation.  Passes feed it back: the smoothed predictor carries noise S n, of which
   the window, averaging with the response B, sees and removes only B S n, so after P passes the result holds
   n sum_m (S (1 - B))^m, m < P.  `pass_gain` is the root mean square of that sum over the noise spectrum
   (1.08 for 32 px windows at 50 % overlap, smoothed over one step), and sigma is multiplied by it.

Only random error is seen: not peak locking, not gradients smaller than a window, not calibration.  The
estimate is meant for sigma below 0.3 px.
"""

import numpy as np
from numpy.typing import NDArray

from correction.evaluate.correlate import CHUNK_BYTES, least_valid
from correction.evaluate.deform import DeformedPair
from correction.evaluate.kernels.statistics import REACH, window_sigma
from correction.evaluate.kernels.windows import cut_windows
from correction.evaluate.windows import WindowGrid
from ground.rows import run_rows


def correlation_statistics(
    pair: DeformedPair, grid: WindowGrid, min_valid: float, gain: float = 1.0, threads: int | None = None
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
    gain : float
        Factor for the noise that passes feed back, see `pass_gain`.
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

    chunk = max(1, CHUNK_BYTES // (4 * size * size))

    def some(first: int, last: int) -> None:
        a, b, turned_a, turned_b = np.empty((4, chunk, size, size), np.float32)
        sums, raw = np.empty((3, size), np.float32), np.empty(size + 2, np.float32)
        field = np.zeros((size + 2 * REACH, size + 2 * REACH), np.float32)
        count, energy = np.empty(chunk, np.int64), np.empty(chunk)
        for start in range(first, last, chunk):
            here = slice(start, min(start + chunk, last))
            n = here.stop - start
            cut_windows(
                pair.a, pair.b, pair.valid, rows[here], columns[here], least, pair.floor,
                sums[:2], count, energy, a[:n], b[:n],
            )  # fmt: skip
            window_sigma(a[:n], b[:n], energy, sums, raw, field, sigma[0, here])
            # Along columns it is the same sum over transposed windows.
            turned_a[:n], turned_b[:n] = a[:n].transpose(0, 2, 1), b[:n].transpose(0, 2, 1)
            window_sigma(turned_a[:n], turned_b[:n], energy, sums, raw, field, sigma[1, here])

    run_rows(some, ny * nx, block=8 * chunk, threads=threads)
    return gain * np.ascontiguousarray(sigma.reshape(2, ny, nx).transpose(1, 2, 0))


def pass_gain(size_px: int, step_px: int, smoothing_steps: float, passes: int) -> float:
    """Growth of random error by `passes` correlations on one grid whose predictor is smoothed in between.

    Parameters
    ----------
    size_px, step_px : int
        Side and spacing of the windows.
    smoothing_steps : float
        Standard deviation of the smoothing in grid steps.
    passes : int
        Correlations on this grid, at least 1.

    Returns
    -------
    float
        1 for a single pass.
    """
    wave = 2 * np.pi * np.fft.fftfreq(128)  # rad a step
    ratio = size_px / step_px
    lags = np.arange(1, int(np.ceil(ratio)))
    # Errors of windows that share pixels correlate in proportion to what they share.
    spectrum = 1.0 + 2.0 * (np.maximum(0.0, 1.0 - lags / ratio)[:, None] * np.cos(lags[:, None] * wave)).sum(0)
    smoothing = np.exp(-0.5 * (smoothing_steps * wave) ** 2)
    window = np.sinc(0.5 * ratio * wave / np.pi)
    kept = np.outer(smoothing, smoothing) * (1.0 - np.outer(window, window))
    growth = sum(kept**m for m in range(passes))
    power = np.outer(spectrum, spectrum)
    return float(np.sqrt((power * growth**2).sum() / power.sum()))
