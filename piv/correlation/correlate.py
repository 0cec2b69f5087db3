"""Windows of a deformed pair and the displacement between them.

Windows whose side is a power of two go through our own transforms, 32 pairs at once and three times as fast
as through scipy.fft; any other size goes through scipy.fft.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.correlation.deform import DeformedPair
from piv.correlation.kernels.fft import BLOCK, PAIRS, correlate_pairs
from piv.correlation.kernels.windows import cut_windows, find_peaks, multiply_conjugate
from piv.correlation.windows import WindowGrid

CHUNK_BYTES = 1 << 18  # windows worked on at once: what a second-level cache holds beside their spectra
Floats = NDArray[np.float32]


class Searched(NamedTuple):
    """Result of the correlation of each window; all (ny, nx), shift_px with a last axis of u, v."""

    shift_px: NDArray[np.float64]
    correlation: NDArray[np.float64]
    valid_fraction: NDArray[np.float64]


def least_valid(grid: WindowGrid, min_valid: float) -> int:
    """Valid pixels that a window needs."""
    return max(1, int(np.ceil(min_valid * grid.size_px**2)))


def _power_of_two(size: int) -> bool:
    return size & (size - 1) == 0


@cache
def _tables(size: int) -> tuple[Floats, NDArray[np.int64]]:
    """Twiddle factors, and where the negative of each bit-reversed frequency stands."""
    angle = -2 * np.pi * np.arange(size // 2) / size
    index = np.arange(size)
    frequency = np.zeros(size, np.int64)
    for bit in range(size.bit_length() - 1):
        frequency = 2 * frequency + (index >> bit & 1)
    # Reversing bits twice changes nothing, so the table also leads back from frequency to index.
    return np.array([np.cos(angle), np.sin(angle)], np.float32), frequency[-frequency % size]


def workspace(size: int) -> Floats:
    """Scratch for `correlation_planes` with windows of this size."""
    return np.empty((3, size * size * BLOCK if _power_of_two(size) else 0), np.float32)


def correlation_planes(a: Floats, b: Floats, work: Floats, out: Floats) -> None:
    """Periodic cross-correlation of each pair of windows.

    Parameters
    ----------
    a, b : ndarray of float32, shape (N, w, w)
        Windows, N at most 32 where w is a power of two.
    work : ndarray of float32
        From `workspace(w)`.
    out : ndarray of float32, shape (N, w, w)
        sum_x a(x) b(x + s) at [s_v, s_u], negative displacements counted from the end.
    """
    size = a.shape[1]
    if _power_of_two(size):
        correlate_pairs(a, b, *_tables(size), work, out)
        return
    spectrum_a, spectrum_b = scipy.fft.rfft2(a), scipy.fft.rfft2(b)
    multiply_conjugate(spectrum_a.reshape(-1), spectrum_b.reshape(-1))
    out[:] = scipy.fft.irfft2(spectrum_a, s=(size, size), overwrite_x=True)


def correlate_windows(
    pair: DeformedPair, grid: WindowGrid, min_valid: float, threads: int | None = None
) -> Searched:
    """Cross-correlate the windows of both frames and find the peak.

    Parameters
    ----------
    pair : DeformedPair
        Frames and common mask.
    grid : WindowGrid
        Windows.
    min_valid : float
        Share of valid pixels that a window needs.
    threads : int, optional
        Threads to use.
    """
    size, least = grid.size_px, least_valid(grid, min_valid)
    found, count = _correlate(pair, grid, np.ones(grid.shape, bool), least, False, threads)
    shaped = found.reshape(*grid.shape, 4)
    return Searched(shaped[..., :2], shaped[..., 2], count.reshape(grid.shape) / size**2)


def peak_ratios(
    pair: DeformedPair, grid: WindowGrid, which: NDArray[np.bool_], min_valid: float, threads: int | None = None
) -> NDArray[np.float64]:
    """Highest over second highest peak (ny, nx) of the windows asked for; NaN of the others."""
    ratios = np.full(grid.shape, np.nan)
    _, ratios[which] = correlate_some(pair, grid, which, min_valid, threads)
    return ratios


def correlate_some(
    pair: DeformedPair, grid: WindowGrid, which: NDArray[np.bool_], min_valid: float, threads: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacements (n, 2) and peak ratios (n,) of the windows asked for."""
    found, _ = _correlate(pair, grid, which, least_valid(grid, min_valid), True, threads)
    return found[:, :2], found[:, 3]


def _correlate(
    pair: DeformedPair,
    grid: WindowGrid,
    which: NDArray[np.bool_],
    least: int,
    with_ratio: bool,
    threads: int | None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Rows of `find_peaks` (N, 4) and valid pixels (N,) of the windows asked for, in the order of the grid."""
    size = grid.size_px
    chunk = PAIRS if _power_of_two(size) else max(1, CHUNK_BYTES // (4 * size * size))
    rows, columns = (
        np.ascontiguousarray(places[which]) for places in np.meshgrid(grid.row, grid.column, indexing="ij")
    )
    windows, solid = len(rows), pair.solid()
    count, energy, found = np.zeros(windows, np.int64), np.zeros(windows), np.empty((windows, 4))

    def some(first: int, last: int) -> None:
        a, b, planes = np.empty((3, chunk, size, size), np.float32)
        scratch, work = np.empty((2, size), np.float32), workspace(size)
        for start in range(first, last, chunk):
            here = slice(start, min(start + chunk, last))
            n = here.stop - start
            cut_windows(
                pair.a, pair.b, solid, rows[here], columns[here], least, pair.floor,
                scratch, count[here], energy[here], a[:n], b[:n],
            )  # fmt: skip
            correlation_planes(a[:n], b[:n], work, planes[:n])
            find_peaks(planes[:n], a[:n], b[:n], energy[here], with_ratio, scratch, found[here])

    # Several chunks a call: memory is handed out once for all of them.
    run_rows(some, windows, block=8 * chunk, threads=threads)
    return found, count
