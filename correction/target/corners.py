"""Sub-pixel positions of chessboard corners, near the noise limit, with an honest sigma.

The model is in `kernels.corner_model`, its fit in `corner_fit`.  What the caller knows of the view
goes in as an affine frame: `axes_px` says where one square along the board's +x and +y lies in the image.  Behind
glass squares are stretched, inverted and turned, and the window follows: it is a cross of arms along the
two edges, `window` squares long each way and `arm` squares to either side, so that neither the next corner
nor a disc is ever inside.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from correction.target.chessboard import DISC_ARM
from correction.target.kernels import corner_fit, corner_model
from correction.target.kernels.corner_block import PIXEL_LANES, draw_smeared
from correction.target.kernels.corner_model import FREE
from ground.rows import run_rows
from piv.errors import FrameError
from piv.resampling.sample import checked_frame

# Half length of the arms in squares: 0.25, 0.33, 0.45 gave 0.022, 0.020, 0.0165 px on a bare board
ARM_LENGTH = 0.45
MIN_HALF_WINDOW_PX = 4.0  # smallest half window: below, twelve numbers are not worth fitting
DRAWN = 256  # corners drawn at a time: some 8 MB
WINDOW_GAP_PX = 3.0  # of a drawn corner's window from those of the next
LARGEST_RESIDUAL = 0.25  # rms, of the half contrast: more is a MISFIT
LARGEST_SIGMA_PX = 0.25  # more is UNSURE
ASIDE_PX = (0.3, 0.2)  # where the fit of a drawn corner starts: exactly in its middle nothing pulls
SATURATED_LEVELS = (255, 1023, 4095, 16383, 65535, 65520)  # full scale of 8, 10, 12, 14, 16 bit, 12 in 16 bit


class CornerReason(IntEnum):
    """Reason for which a corner is not valid."""

    OK = corner_model.OK
    EDGE = corner_model.EDGE  # the smallest window leaves the frame
    MASKED = corner_model.MASKED  # the smallest window meets masked pixels
    SMALL = corner_model.SMALL  # the squares are too small in the image, or the start is not a number
    LOST = corner_model.LOST  # the fit did not settle
    MOVED = corner_model.MOVED  # the fit left the neighbourhood of the start
    INVERTED = 6  # bright and dark are exchanged: another corner of the lattice
    MISFIT = 7  # the window does not look like two crossing edges
    UNSURE = 8  # sigma above the limit


@dataclass(frozen=True)
class CornerSearch:
    """Search range of a corner, seen from its start.

    Parameters
    ----------
    arm : float
        Half width of the window's arms in squares.
    start_error_px : float
        How far off the starts may be; smaller is faster, larger than a sixth of a square has no effect.
    max_shift : float
        Largest move from the start in squares.
    """

    arm: float = DISC_ARM
    start_error_px: float = 5.0
    max_shift: float = 0.45


@dataclass(frozen=True)
class CornerFit:
    """Fitted corners, N of them; numbers of invalid corners are NaN where nothing was fitted.

    Attributes
    ----------
    position_px : (N, 2) float64
        u, v.
    sigma_px : (N, 2) float64
        Standard deviation of u and v from the residuals.
    covariance_px2 : (N, 2, 2) float64
        The same with its correlation.
    residual : (N,) float64
        Rms residual as a fraction of the half contrast.
    contrast : (N,) float64
        Bright minus dark in grey levels, positive if the square to +x, +y is bright.
    blurs_px : (N, 2) float64
        Standard deviation of the spread of the edges along the board's +x and +y, pixel integration included.
    valid : (N,) bool
    reason : (N,) uint8
        `CornerReason`.
    """

    position_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    covariance_px2: NDArray[np.float64]
    residual: NDArray[np.float64]
    contrast: NDArray[np.float64]
    blurs_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
    reason: NDArray[np.uint8]

    @property
    def blur_px(self) -> NDArray[np.float64]:
        """Root mean square (N,) of both blurs."""
        return np.asarray(np.sqrt(np.mean(self.blurs_px**2, axis=1)))

    @classmethod
    def of_rows(
        cls,
        out: NDArray[np.float64],
        verdict: NDArray[np.uint8],
        sigma_px: NDArray[np.float64],
        residual: NDArray[np.float64],
        contrast: NDArray[np.float64],
    ) -> "CornerFit":
        """Return the fit of a kernel's rows: places, their covariance in columns 2 to 4, blurs in 8 and 9."""
        places, covariance = out[:, :2].copy(), out[:, [2, 4, 4, 3]].reshape(-1, 2, 2)
        is_ok = verdict == CornerReason.OK
        return cls(places, sigma_px, covariance, residual, contrast, out[:, 8:10].copy(), is_ok, verdict)

    def counts(self) -> dict[str, int]:
        """Return how many corners ended with which reason, in words."""
        return {r.name: n for r in CornerReason if (n := int(np.count_nonzero(self.reason == r)))}


def half_widths_px(axes_px: NDArray[np.float64], window: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half width (N,) [px] of the windows that corners get, across the narrow side of their squares.

    Corners with less than MIN_HALF_WINDOW_PX are refused.  ``axes_px`` (N, 2, 2), ``window`` (N,) [squares] as for
    `refine_corners`.
    """
    thin = np.abs(np.linalg.det(axes_px)) / np.linalg.norm(axes_px, axis=1).max(axis=1)
    extent = np.abs(axes_px).sum(axis=2).max(axis=1)
    return np.asarray(np.minimum(window, 0.5 * (corner_model.SIDE - 2) / extent) * thin)


def refine_corners(
    image: NDArray[Any],
    start_px: ArrayLike,
    axes_px: ArrayLike,
    *,
    sign: ArrayLike | None = None,
    mask: NDArray[np.bool_] | None = None,
    window: float | ArrayLike = ARM_LENGTH,
    search: CornerSearch = CornerSearch(),
    threads: int | None = None,
) -> CornerFit:
    """Fit corners from start positions.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float
        The frame.
    start_px : (N, 2) float
        Start positions; NaN is allowed and gives an invalid corner.
    axes_px : (N, 2, 2) or (2, 2) float
        ``axes_px[n, :, 0]`` is the image displacement (u, v) of one square along the board's +x,
        ``[:, 1]`` along +y; any handedness.
    sign : (N,) int, optional
        +1 if the square to +x, +y of the corner is bright, -1 if dark (`Chessboard.corner_sign`); the other
        shade makes the corner INVERTED.
    mask : (H, W) bool, optional
        True where pixels may be used.
    window : float or (N,) float
        Half length of the arms in squares.  At the border of frame or mask the window shrinks to
        MIN_HALF_WINDOW_PX, then the corner is refused.
    search : CornerSearch
        Where the corner may be.
    threads : int, optional
        Threads to use.

    Returns
    -------
    CornerFit
        In the order of `start_px`.

    Raises
    ------
    FrameError
        Not a frame, NaN in it, or shapes that do not belong together.
    """
    pixels, usable = check_pixels(image, mask)
    start = np.ascontiguousarray(start_px, dtype=np.float64).reshape(-1, 2)
    count = len(start)
    axes = np.ascontiguousarray(np.broadcast_to(np.asarray(axes_px, dtype=np.float64), (count, 2, 2)))
    reaches = np.ascontiguousarray(np.broadcast_to(np.asarray(window, dtype=np.float64), (count,)))
    out, verdict = np.full((count, 11), np.nan), np.zeros(count, np.uint8)

    def fit(some: NDArray[np.intp], error_px: float) -> None:
        starts, frames, lengths = start[some], axes[some], reaches[some]
        results, verdicts = np.full((len(some), 11), np.nan), np.zeros(len(some), np.uint8)

        def rows(first: int, last: int) -> None:
            corner_fit.fit_corners(
                pixels, usable, starts, frames, lengths, search.arm, MIN_HALF_WINDOW_PX, search.max_shift,
                error_px, first, last, corner_fit.new_scratch(), results, verdicts,
            )  # fmt: skip

        run_rows(rows, len(some), block=64, threads=threads)
        out[some], verdict[some] = results, verdicts

    fit(np.arange(count), search.start_error_px)
    # A start too far for the blur of the first guess is often within reach of twice the blur.
    again = np.flatnonzero((verdict == CornerReason.LOST) | (verdict == CornerReason.MOVED))
    fit(again, 2.0 * search.start_error_px)
    return _judge(out, verdict, sign)


def check_pixels(
    image: NDArray[Any], mask: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Pixels (H, W) of a frame, and which of them may be used, (1, 1) if all; FrameError as `refine_corners`."""
    pixels = checked_frame(image).astype(np.float32, copy=False)
    usable = np.ones((1, 1), np.uint8) if mask is None else np.ascontiguousarray(mask, dtype=np.uint8)
    if mask is not None and usable.shape != pixels.shape:
        raise FrameError(f"the mask has shape {usable.shape}, the frame {pixels.shape}; they must agree")
    if not np.isfinite(pixels.sum(dtype=np.float64)):
        raise FrameError("the frame holds NaN or infinity; fill those pixels and mask them")
    return pixels, usable


def find_smeared(
    axes_px: NDArray[np.float64],
    window: NDArray[np.float64],
    blur_px: NDArray[np.float64],
    steps_px: NDArray[np.float64],
    share: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find corners as `refine_corners` does where parts of the light show them side by side.

    It wishes both edges of a corner to be blurred alike, and where squares are small has its way; a wide smear
    goes into the shape of the edge as well, and an uneven one draws it aside.  How much, the fit itself says:
    corners are drawn and fitted.

    Parameters
    ----------
    axes_px, window
        As of `refine_corners`.
    blur_px : (N,) float64
        Blur of each part.
    steps_px : (K, N, 2) float64
        Where each part shows a corner, from where it is.
    share : (K, N) float64
        Of each part, 1 in sum over the parts.

    Returns
    -------
    aside_px : (N, 2) float64
        Where the corners are found, from where they are; NaN where the fit gives up.
    blurs_px : (N, 2) float64
        Their blurs.
    """
    aside, blurs = np.full((2, len(axes_px), 2), np.nan)
    extent = np.abs(axes_px).sum(axis=2).max(axis=1, initial=0.0) * window
    half = int(np.ceil(extent.max(initial=0.0) + WINDOW_GAP_PX))
    for first in range(0, len(axes_px), DRAWN):
        some = slice(first, first + DRAWN)
        axes, blur = np.ascontiguousarray(axes_px[some]), np.ascontiguousarray(blur_px[some])
        steps, parts = np.ascontiguousarray(steps_px[:, some]), np.ascontiguousarray(share[:, some])
        tiles = np.empty((len(axes), 2 * half + 1, 2 * half + 1))
        middle = half + len(tiles[0]) * np.arange(len(axes))

        def rows(first: int, last: int) -> None:
            scratch = np.empty(FREE), np.empty(4), np.empty((FREE + 3, PIXEL_LANES))
            draw_smeared(axes, blur, steps, parts, first, last, *scratch, tiles)  # noqa: B023

        run_rows(rows, len(axes))
        place = np.column_stack((np.full(len(axes), half), middle))
        fit = refine_corners(tiles.reshape(-1, tiles.shape[2]), place + ASIDE_PX, axes, window=window[some])
        aside[some] = np.where(fit.valid[:, None], fit.position_px - place, np.nan)
        blurs[some] = np.where(fit.valid[:, None], fit.blurs_px, np.nan)
    return aside, blurs


def _judge(
    out: NDArray[np.float64],
    verdict: NDArray[np.uint8],
    sign: ArrayLike | None,
) -> CornerFit:
    """Name what the kernel found and apply the limits."""
    amplitude = out[:, 7]
    with np.errstate(invalid="ignore", divide="ignore"):
        residual = out[:, 5] / np.abs(amplitude)
        sigma = np.sqrt(out[:, 2:4])
        fitted = verdict == CornerReason.OK
        verdict[fitted & ~(sigma.max(axis=1) <= LARGEST_SIGMA_PX)] = CornerReason.UNSURE
        verdict[fitted & ~(residual <= LARGEST_RESIDUAL)] = CornerReason.MISFIT
        if sign is not None:
            verdict[fitted & (np.sign(amplitude) != np.asarray(sign))] = CornerReason.INVERTED
    return CornerFit.of_rows(out, verdict, sigma, residual, 2.0 * amplitude)


def fraction_saturated(image: NDArray[Any]) -> float:
    """Fraction of pixels at the full scale of a common bit depth, if that is the largest value; else 0."""
    if not np.issubdtype(image.dtype, np.integer):
        return 0.0
    top = int(image.max())
    return float(np.mean(image == top)) if top in SATURATED_LEVELS else 0.0
