"""The one resampler of the house: a frame at any float64 position, without rounded weights.

The frame corrector and the window deformation of the evaluation both sample through the kernels of
`correction.kernels.bspline`; this module is their front for whole arrays.

    coefficients = prefilter(frame)                  # once a frame
    values = sample(coefficients, positions)         # quintic B-spline
    values = sample(frame, positions, "bilinear")    # no preparation

Results are float32: a spline overshoots beside bright particles and uint16 would cut its negative lobes,
which moves centroids by up to 0.03 px.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from correction.errors import FrameError
from correction.kernels.bspline import (
    LANES,
    PAD,
    filter_columns,
    filter_rows,
    sample_bilinear,
    sample_quintic,
)
from tracer.rows import run_rows

Method = Literal["bilinear", "quintic"]
FRAME_TYPES = (np.uint8, np.uint16, np.float32)
MIN_SIDE_PX = 4  # mirroring a footprint of 6 px needs as much


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
    if frame.dtype == np.float32 and not np.isfinite(frame.sum(dtype=np.float64)):
        bad = int(np.count_nonzero(~np.isfinite(frame)))
        raise FrameError(f"{bad} of {frame.size} pixels are NaN or infinite; mask and fill them before resampling")
    height, width = frame.shape
    if out is None:
        out = np.empty((height, width), np.float32)
    elif out.shape != frame.shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise FrameError(f"out must be a C-contiguous float32 array of shape {frame.shape}")
    coefficients = out

    def rows(first: int, last: int) -> None:
        lines = np.zeros((width + 2 * PAD, LANES), np.float32)
        filter_rows(frame, first, last, np.empty(LANES, np.float32), lines, coefficients)

    def columns(first: int, last: int) -> None:
        lines = np.zeros((height + 2 * PAD, LANES), np.float32)
        filter_columns(first, last, np.empty(LANES, np.float32), lines, coefficients)

    run_rows(rows, height, block=LANES, threads=threads)
    run_rows(columns, width, block=LANES, threads=threads)
    return coefficients


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
