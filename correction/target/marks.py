"""Marks of a board, whatever it is: corners of squares, or dots.  What looks for them asks here."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from correction.target.chessboard import Chessboard
from correction.target.corners import ARM_LENGTH, CornerFit, CornerSearch, check_pixels, refine_corners
from correction.target.dot_centres import refine_dots
from correction.target.dots_seen import find_dots
from correction.target.lattice_growth import Patch, Saddles, coarse_saddles, find_saddles, grow_patches
from correction.target.two_levels import grow_levels

ANYWHERE = CornerSearch()  # as far as the fit of a mark follows by itself


def find_marks(
    frame: NDArray[Any],
    board: Chessboard,
    mask: NDArray[np.bool_] | None = None,
    square_px: float | None = None,
    beside_walls: bool = False,
) -> Saddles:
    """Find all that may be marks of a board, wherever they are.

    Parameters
    ----------
    frame : (H, W) uint8, uint16 or float32
        The frame.
    board : Chessboard
    mask : (H, W) bool, optional
        True where marks may lie.
    square_px : float, optional
        Side of a square, or from dot to dot, as seen without glass: large squares are looked for faster.
    beside_walls : bool
        As of `find_dots`.
    """
    if board.dots is not None:
        dot_px = None if square_px is None else square_px * board.disc_mm / board.square_mm
        return find_dots(frame, board.dots, board.square_mm, dot_px, mask, beside_walls)
    return find_saddles(frame, mask) if square_px is None else coarse_saddles(frame, square_px, mask)


def grow_marks(saddles: Saddles) -> list[Patch]:
    """Return patches of lattice, largest first, of a board on one level or on two."""
    return grow_levels(saddles) if saddles.levels else grow_patches(saddles)


def refine_marks(
    image: NDArray[Any],
    board: Chessboard,
    index: NDArray[np.int64],
    start_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    mask: NDArray[np.bool_] | None = None,
    window: float | ArrayLike = ARM_LENGTH,
    search: CornerSearch = ANYWHERE,
) -> CornerFit:
    """Find the places of marks to sub-pixel.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float
        The frame.
    board : Chessboard
    index : (N, 2) int64
        Corner or dot (i, j) of the board.
    start_px, axes_px, mask, window, search
        As of `refine_corners`; a dot is as wide as it is, whatever the window.

    Raises
    ------
    FrameError
        Not a frame, NaN in it, or shapes that do not belong together.
    """
    if board.dots is None:
        sign = board.corner_sign(index)
        return refine_corners(image, start_px, axes_px, sign=sign, mask=mask, window=window, search=search)
    pixels, usable = check_pixels(image, mask)
    axes = np.broadcast_to(np.asarray(axes_px, np.float64), (len(index), 2, 2))
    start = np.asarray(start_px, np.float64).reshape(-1, 2)
    return refine_dots(pixels, start, axes, board.dot_share(index), board.dots, usable, search)
