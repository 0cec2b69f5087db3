"""The one resampler of the house: a frame at any float64 position, without rounded weights.

The frame corrector and the window deformation of the evaluation both sample through the kernels of
`piv.resampling.kernels.bspline`; this module is their front for whole arrays.

    coefficients = prefilter(frame)                  # once a frame
    values = sample(coefficients, positions)         # quintic B-spline
    values = sample(frame, positions, "bilinear")    # no preparation

Results are float32: a spline overshoots beside bright particles and uint16 would cut its negative lobes,
which moves centroids by up to 0.03 px.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ground.rows import run_rows
from piv.errors import FrameError
from piv.resampling.kernels.bspline import sample_bilinear, sample_quintic
from piv.resampling.kernels.prefilter import REACH, SPREAD, filter_tile

Method = Literal["bilinear", "quintic"]
FRAME_TYPES = (np.uint8, np.uint16, np.float32)
MIN_SIDE_PX = 4  # mirroring a footprint of 6 px needs as much
TILE = (128, 512)  # rows and columns filtered in one go: 0.4 MB with margins, in the second-level cache
TILES_PER_CALL = 2


def checked_frame(frame: NDArray[Any]) -> NDArray[Any]:
    """Return `frame` as a C-contiguous 2-D array of uint8, uint16 or float32.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        Intensities; float64 becomes float32.

    Raises
    ------
    FrameError
        Not 2-D, smaller than 4 x 4 px, or another kind of number.
    """
    frame = np.asarray(frame)
    if frame.ndim != 2 or min(frame.shape) < MIN_SIDE_PX:
        raise FrameError(
            f"a frame is a 2-D array of at least {MIN_SIDE_PX} x {MIN_SIDE_PX} px, this one has shape"
            f" {frame.shape}; pass one channel of one frame"
        )
    if frame.dtype == np.float64:
        frame = frame.astype(np.float32)
    if frame.dtype not in FRAME_TYPES:
        raise FrameError(f"a frame holds uint8, uint16 or float32, not {frame.dtype}; convert it first")
    return np.ascontiguousarray(frame)


def prefilter(
    frame: NDArray[Any], out: NDArray[np.float32] | None = None, threads: int | None = None
) -> NDArray[np.float32]:
    """Quintic B-spline coefficients of a frame, mirrored at its outermost pixel centres.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        uint8, uint16 or float32, all finite.
    out : ndarray of float32, shape (H, W), optional
        Where to put the coefficients; C-contiguous, not `frame` itself.
    threads : int, optional
        Threads to use; default all cores of the process.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Coefficients, accurate to float32.

    Raises
    ------
    FrameError
        Not a frame, or it holds NaN or infinity (one such pixel would spoil its row and column).
    """
    frame = checked_frame(frame)
    if out is None:
        out = np.empty(frame.shape, np.float32)
    elif out.shape != frame.shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise FrameError(f"out must be a C-contiguous float32 array of shape {frame.shape}")
    filter_tiles(frame, 0, tile_grid(frame.shape).reshape(-1, 4), out, threads)
    return out


def tile_grid(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Tiles of an array of coefficients, (down, across, 4): first row and column, last row and column + 1."""
    top, left = np.meshgrid(*(np.arange(0, n, step) for n, step in zip(shape, TILE, strict=True)), indexing="ij")
    bottom, right = (np.minimum(low + step, n) for low, step, n in zip((top, left), TILE, shape, strict=True))
    return np.stack((top, left, bottom, right), axis=-1)


def filter_tiles(
    frame: NDArray[Any], rim: int, tiles: NDArray[np.int64], out: NDArray[np.float32], threads: int | None = None
) -> None:
    """Write the coefficients of some tiles of a checked frame.

    Parameters
    ----------
    frame : ndarray, shape (H, W)
        As `checked_frame` returns it.
    rim : int
        Mirrored pixels that `out` begins with above and to the left of the frame; it may end beyond it as well.
    tiles : ndarray of int64, shape (T, 4)
        Some of `tile_grid` of the shape of `out`.  A tile's bits do not depend on the others.
    out : ndarray of float32
        Where the coefficients go; other tiles stay as they are.
    threads : int, optional
        Threads to use; default all cores of the process.

    Raises
    ------
    FrameError
        The frame holds NaN or infinity.
    """
    if frame.dtype == np.float32 and not np.isfinite(frame.sum(dtype=np.float64)):
        bad = int(np.count_nonzero(~np.isfinite(frame)))
        raise FrameError(f"{bad} of {frame.size} pixels are NaN or infinite; mask and fill them before resampling")

    def work(first: int, last: int) -> None:
        lines = np.empty((2, TILE[1] + 2 * SPREAD), np.float32)
        tile = np.empty((TILE[0] + 2 * REACH + 1, TILE[1]), np.float32)
        for place in tiles[first:last].tolist():
            filter_tile(frame, rim, tuple(place), (lines, tile), out)

    run_rows(work, len(tiles), block=TILES_PER_CALL, threads=threads)


def sample(
    image: NDArray[Any],
    positions: NDArray[np.float64],
    method: Method = "quintic",
    threads: int | None = None,
) -> NDArray[np.float32]:
    """Values of an image at pixel positions.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The coefficients from `prefilter` for "quintic", the frame itself for "bilinear".
    positions : ndarray of float64, shape (..., 2)
        Pixel positions u, v; (0, 0) is the centre of the top-left pixel.
    method : {"quintic", "bilinear"}
        Interpolation.
    threads : int, optional
        Threads to use; default all cores of the process.

    Returns
    -------
    ndarray of float32, shape (...)
        Values; NaN where a position is NaN or outside the outermost pixel centres.

    Raises
    ------
    FrameError
        Not a frame, positions without a last axis of 2, or an unknown method.
    """
    image = checked_frame(image)
    positions = np.asarray(positions, np.float64)
    if positions.ndim == 0 or positions.shape[-1] != 2:
        raise FrameError(f"positions need a last axis of u, v, got shape {positions.shape}")
    if method not in ("quintic", "bilinear"):
        raise FrameError(f"the method is 'quintic' or 'bilinear', not {method!r}")
    if method == "quintic" and image.dtype != np.float32:
        raise FrameError("quintic sampling takes the coefficients that prefilter returns, not the frame")
    points = np.ascontiguousarray(positions.reshape(-1, 2))
    out = np.empty(len(points), np.float32)
    kernel = sample_quintic if method == "quintic" else sample_bilinear
    run_rows(
        lambda first, last: kernel(image, points, first, last, out), len(points), block=1 << 15, threads=threads
    )
    return out.reshape(positions.shape[:-1])
