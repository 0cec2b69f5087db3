"""Windows of a deformed pair and the displacement between them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from correction.evaluate.deform import DeformedPair
from correction.evaluate.windows import WindowGrid
from correction.kernels.piv_windows import cut_windows, find_peaks, multiply_conjugate
from tracer.rows import run_rows

CHUNK_BYTES = 1 << 18  # windows transformed at once: what a second-level cache holds beside their spectra


class Measured(NamedTuple):
    """What correlation says about each window; all (ny, nx), shift_px with a last axis of u, v."""

    shift_px: NDArray[np.float64]
    correlation: NDArray[np.float64]
    peak_ratio: NDArray[np.float64]
    valid_fraction: NDArray[np.float64]
    dense: NDArray[np.bool_]


def least_valid(grid: WindowGrid, min_valid: float) -> int:
    """Valid pixels that a window needs."""
    return max(1, int(np.ceil(min_valid * grid.size_px**2)))


def correlate_windows(
    pair: DeformedPair, grid: WindowGrid, min_valid: float, with_ratio: bool, threads: int | None = None
) -> Measured:
    """Cross-correlate the windows of both frames and find the peak.

    Parameters
    ----------
    pair : DeformedPair
        Frames and common mask.
    grid : WindowGrid
        Windows.
    min_valid : float
        Share of valid pixels that a window needs.
    with_ratio : bool
        Look for the second peak too.
    threads : int, optional
        Threads to use.
    """
    ny, nx = grid.shape
    size = grid.size_px
    chunk = max(1, CHUNK_BYTES // (4 * size * size))
    rows, columns = (
        np.ascontiguousarray(grid_.ravel()) for grid_ in np.meshgrid(grid.row, grid.column, indexing="ij")
    )
    count, energy = np.zeros(ny * nx, np.int64), np.zeros(ny * nx)
    found = np.empty((ny * nx, 4))
    least = least_valid(grid, min_valid)

    def some(first: int, last: int) -> None:
        a, b = np.empty((2, last - first, size, size), np.float32)
        here = slice(first, last)
        scratch = np.empty((2, size), np.float32)
        cut_windows(
            pair.a,
            pair.b,
            pair.valid,
            rows[here],
            columns[here],
            least,
            pair.floor,
            scratch[0],
            count[here],
            energy[here],
            a,
            b,
        )
        spectrum_a, spectrum_b = fft.rfft2(a), fft.rfft2(b)
        multiply_conjugate(spectrum_a.reshape(-1), spectrum_b.reshape(-1))
        planes = fft.irfft2(spectrum_a, s=(size, size), overwrite_x=True)
        find_peaks(planes, a, b, energy[here], with_ratio, scratch, found[here])

    run_rows(some, ny * nx, block=chunk, threads=threads)
    shaped = found.reshape(ny, nx, 4)
    return Measured(
        shaped[..., :2],
        shaped[..., 2],
        shaped[..., 3],
        (count / size**2).reshape(ny, nx),
        (count >= least).reshape(ny, nx),
    )
