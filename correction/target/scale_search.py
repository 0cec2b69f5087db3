"""Search a frame for patches of lattice at several scales.

Saddles of one scale only are lost where noise, JPEG blocks or soft edges are as wide as the filter that looks for
them.  A copy of the frame in which squares are 12 px wide has averaged noise away and shows edges sharp, but no
size of a square is known beforehand: copies for squares of 24, 48 and 96 px are searched beside the frame itself.

The scale that shows most corners wins.  Saddles along the outer edge of a board, or in clutter beside it, join a
lattice as well; a corner counts where both bright squares around it are brighter than both dark ones.  Coarser
copies cost little: one is not grown where nearly all of its saddles are corners that are known already.
"""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.chessboard import Chessboard
from correction.target.corners import ARM_LENGTH, MIN_HALF_WINDOW_PX, half_widths_px
from correction.target.lattice_growth import (
    LEAST_BOARD,
    MIN_PATCH_CORNERS,
    Patch,
    coarse_saddles,
    grow_patches,
)
from correction.target.marks import find_marks, grow_marks

COARSER_PX = 24.0, 48.0, 96.0  # squares for which copies of the frame are made
# Times that copies for dots are smaller
COARSER_DOTS = 2, 4
# Of the dots found, that a board holds at least for no copy to be searched
MIN_DOTS_SHARE = 0.5
COARSE_ERROR = 0.3  # of the shrinkage: how far corners of a copy may be off in the frame [px]
COARSER_GAIN = 1.02  # of the corners of a finer scale that a coarser one must show at least
KNOWN_SQUARES = 0.3  # from a known corner: the same corner
CROSSING, BESIDE = 0.5, 9  # of the median contrast of so many corners around, between squares of both shades
ALONG_EDGE = 0.2, 0.35  # squares from a corner, where its squares are sampled beside their edges


def find_patches(
    frame: NDArray[Any],
    board: Chessboard,
    mask: NDArray[np.bool_] | None = None,
    square_px: float | None = None,
) -> list[Patch]:
    """Find patches of lattice, largest first, in the scale that shows most corners.

    Parameters
    ----------
    frame, board, mask, square_px
        As of `find_marks`; with `square_px` other scales are searched only where its own shows no board.
    """
    marks = find_marks(frame, board, mask, square_px)
    best = grow_marks(marks)
    if square_px is not None:  # sharp cells of markers as wide as the filter hide the corners at its scale
        enough = bool(best) and len(best[0].index) >= LEAST_BOARD
        return best if enough else find_patches(frame, board, mask)
    if board.dots is not None:
        # Walls hide one level; the other is full by itself.
        walls_as_dark = bool(board.dots.levels) and not board.dots.bright
        is_full = bool(best) and _is_full(best[0], len(marks)) and not walls_as_dark
        return best if is_full else _dots_in_copies(frame, board, mask, best)
    counts = [_count_corners(frame, board, patch) for patch in best]
    most = max(counts, default=0)
    for side_px in COARSER_PX:
        if min(frame.shape) < 4.0 * side_px:
            break
        saddles = coarse_saddles(frame, side_px, mask)
        if _unknown_saddles(saddles.position_px, best) < max(MIN_PATCH_CORNERS, (COARSER_GAIN - 1.0) * most):
            continue
        patches = [replace(patch, error_px=COARSE_ERROR * side_px / 12.0) for patch in grow_patches(saddles)]
        seen = [_count_corners(frame, board, patch) for patch in patches]
        if max(seen, default=0) > COARSER_GAIN * most:
            best, counts, most = patches, seen, max(seen)
    order = sorted(range(len(best)), key=lambda n: -counts[n])
    return [best[n] for n in order]


def _is_full(patch: Patch, dots: int) -> bool:
    """Return whether a patch holds most dots of the frame, and more dots than its hull has squares."""
    import cv2

    count = len(patch.index)
    squares = cv2.contourArea(cv2.convexHull(patch.index.astype(np.float32)))
    return count >= max(LEAST_BOARD, MIN_DOTS_SHARE * dots, squares)


def _dots_in_copies(
    frame: NDArray[Any], board: Chessboard, mask: NDArray[np.bool_] | None, best: list[Patch]
) -> list[Patch]:
    """Patches of dots, of the copy that shows more of them: noise tears dots apart, walls of plates join them."""
    import cv2

    assert board.dots is not None
    copies = itertools.product((False, True) if board.dots.levels else (False,), COARSER_DOTS)
    for beside_walls, shrink in copies:
        most = len(best[0].index) if best else 0
        height, width = frame.shape[0] // shrink, frame.shape[1] // shrink
        cut = np.s_[: height * shrink, : width * shrink]
        small = cv2.resize(frame[cut].astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        middle = np.s_[shrink // 2 :: shrink, shrink // 2 :: shrink]
        seen = None if mask is None else np.ascontiguousarray(mask[cut][middle])
        patches = grow_marks(find_marks(small, board, seen, beside_walls=beside_walls))
        if patches and len(patches[0].index) > COARSER_GAIN * most:
            best = [
                replace(
                    patch,
                    position_px=(patch.position_px + 0.5) * shrink - 0.5,
                    axes_px=patch.axes_px * shrink,
                    error_px=patch.error_px * shrink,
                )
                for patch in patches
            ]
    return best


def crossing_corners(
    frame: NDArray[Any],
    board: Chessboard,
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    sign: NDArray[np.int8],
) -> NDArray[np.bool_]:
    """Return whether corners lie between four squares of alternating shade.

    Parameters
    ----------
    frame : (H, W) array
    board : Chessboard
        Says how much of a square beside its edges is clear of marks.
    position_px, axes_px, sign : (N, 2), (N, 2, 2) and (N,)
        As of `Patch`.
    """
    beside = 0.7 * board.arm
    within = np.array([place for far in ALONG_EDGE for place in ((far, beside), (beside, far))])
    signs = np.array(((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)))  # bright squares, then dark ones
    steps = (signs[:, None] * within).reshape(-1, 2)
    places = position_px[:, None] + np.einsum("nck,sk->nsc", axes_px, steps)
    shades = scipy.ndimage.map_coordinates(
        frame.astype(np.float32), [places[..., 1], places[..., 0]], order=1, mode="nearest"
    )
    shades = shades.reshape(len(position_px), 2, 2, len(within)).mean(axis=-1)
    shades = np.where(sign[:, None, None] > 0, shades, shades[:, ::-1])
    contrast = shades[:, 0].min(axis=1) - shades[:, 1].max(axis=1)
    seen = np.flatnonzero(np.isfinite(contrast))  # a corner that could not be fitted has no place
    crossing = np.zeros(len(contrast), dtype=bool)
    if len(seen):
        near = scipy.spatial.cKDTree(position_px[seen]).query(position_px[seen], k=min(BESIDE, len(seen)))[1]
        usual = np.median(contrast[seen][near.reshape(len(seen), -1)], axis=1)  # light may be uneven
        crossing[seen] = contrast[seen] > CROSSING * np.maximum(usual, 0.0)
    return crossing


def _count_corners(frame: NDArray[Any], board: Chessboard, patch: Patch) -> int:
    """Count corners of a patch that are no edge of something else, in squares large enough to be measured."""
    wide = half_widths_px(patch.axes_px, np.full(len(patch.index), ARM_LENGTH)) >= MIN_HALF_WINDOW_PX
    crossing = crossing_corners(frame, board, patch.position_px, patch.axes_px, patch.sign)
    return int(np.count_nonzero(crossing & wide))


def _unknown_saddles(position_px: NDArray[np.float64], patches: list[Patch]) -> int:
    """Count saddles (N, 2) that are not corners of the largest patch."""
    if not patches or not len(position_px):
        return len(position_px)
    away, nearest = scipy.spatial.cKDTree(patches[0].position_px).query(position_px)
    side = np.linalg.norm(patches[0].axes_px[nearest], axis=1).min(axis=1)
    return int(np.count_nonzero(away > KNOWN_SQUARES * side))
