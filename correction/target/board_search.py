"""Find the target in a frame: every corner with its place on the board and its sub-pixel position.

    saddles -> patches of lattice -> origin from the discs -> sub-pixel fit -> corners the saddles missed

`find_board` needs no start: any turn, tilt, barrel distortion, board partly outside.  `track_board` also
takes a prediction, from a nominal camera say: it places patches in which no disc is seen (a board moved
aside, glass above the discs) as long as the prediction is good to half a square somewhere, and uses the
discs, where they are seen, if it is worse.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_origin import Placing, place_by_discs, place_by_prediction
from correction.target.chessboard import Chessboard
from correction.target.corners import saturated_fraction
from correction.target.lattice_corners import LEAST_BOARD, BoardDetection, measure_lattice
from correction.target.lattice_growth import Patch, grow_patches
from correction.target.saddles import find_saddles
from piv.errors import FrameError
from piv.resampling.sample import checked_frame

Predict = Callable[[NDArray[np.float64]], NDArray[np.float64]]

NEAR_DISCS = 6  # squares around the origin in which the view and its prediction are compared
SCALES = 0.7, 1.4  # of the view near the discs against its prediction: a ball shows them twice as large, or turned
SATURATED = 0.02  # fraction of pixels at full scale from which edges are displaced
FAR_SQUARES = 512  # half side of the largest board looked at


def find_board(image: NDArray[Any], board: Chessboard, mask: NDArray[np.bool_] | None = None) -> BoardDetection:
    """Find the target without a start.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float
        The frame.
    board : Chessboard
        What is looked for.
    mask : (H, W) bool, optional
        True where pixels may be used.

    Returns
    -------
    BoardDetection
        Corners of the patch of lattice that holds the discs.

    Raises
    ------
    FrameError
        Not a frame.
    TargetNotFound
        No lattice, no discs, another board, or a saturated frame; the message says which and the cure.
    """
    frame, patches = _patches(image, mask)
    marked = _with_discs(frame, patches, board)
    if marked is not None:
        return measure_lattice(frame, board, [marked], mask, discs_count=True)
    raise TargetNotFound(
        f"a lattice of {len(patches[0].index)} corners is in the frame, but not the {len(board.discs)} discs that"
        " mark the origin; bring them into view, or give a prediction of the view"
    )


def track_board(
    image: NDArray[Any], board: Chessboard, predict: Predict, mask: NDArray[np.bool_] | None = None
) -> BoardDetection:
    """Find the target with the help of a prediction.

    Parameters
    ----------
    image, board, mask
        As in `find_board`.
    predict : callable
        Board points (M, 2) [mm] -> expected pixels (M, 2); NaN where the view cannot show the point.

    Returns
    -------
    BoardDetection
        Corners of all patches that could be placed.

    Raises
    ------
    FrameError
        Not a frame.
    TargetNotFound
        As in `find_board`, or neither the discs nor the prediction place any patch.
    """
    frame, patches = _patches(image, mask)
    index, predicted = corners_in_view(board, predict, (frame.shape[0], frame.shape[1]))
    if len(index) == 0:
        raise TargetNotFound("the prediction puts no corner of the board into the frame; check the nominal camera")
    placed: list[tuple[Patch, Placing]] = []
    marked = _with_discs(frame, patches, board)
    if marked is not None and _plausible(index, predicted, *marked):
        placed = [marked]
        predicted = _corrected(index, predicted, *marked)
        patches = [patch for patch in patches if patch is not marked[0]]
    for patch in patches:
        placing = place_by_prediction(patch, index, predicted, board)
        if placing is not None:
            placed.append((patch, placing))
            if len(placed) == 1:
                predicted = _corrected(index, predicted, patch, placing)
    if not placed:
        raise TargetNotFound(_why_not_placed(index, predicted, patches[0], board))
    return measure_lattice(frame, board, placed, mask, discs_count=False)


def corners_in_view(
    board: Chessboard, predict: Predict, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Corners that a prediction puts into a frame: index (N, 2) and pixels (N, 2).

    Parameters
    ----------
    board : Chessboard
    predict : callable
        Board points (M, 2) [mm] -> pixels (M, 2) or NaN.
    shape : (int, int)
        Rows and columns of the frame.
    """
    size = np.array((shape[1] - 1.0, shape[0] - 1.0))
    index, pixels, half, before = np.empty((0, 2), np.int64), np.empty((0, 2)), 16, -1
    while half <= FAR_SQUARES and len(index) != before:
        before = len(index)
        grid = np.arange(-half, half + 1)
        every = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        pixel = np.asarray(predict(board.corner_mm(every)), dtype=np.float64)
        inside = ((pixel >= 0.0) & (pixel <= size)).all(axis=1)  # False for NaN
        index, pixels = every[inside].astype(np.int64), pixel[inside]
        half *= 2
    return index, pixels


def _patches(image: NDArray[Any], mask: NDArray[np.bool_] | None) -> tuple[NDArray[Any], list[Patch]]:
    """Check the frame; return it with its patches of lattice."""
    full = saturated_fraction(np.asarray(image))
    frame = checked_frame(image)
    if mask is not None and mask.shape != frame.shape:
        raise FrameError(f"the mask has shape {mask.shape}, the frame {frame.shape}; they must agree")
    if frame.dtype == np.float32 and not np.isfinite(frame.sum(dtype=np.float64)):
        raise FrameError("the frame holds NaN or infinity; fill those pixels and mask them")
    if full > SATURATED:
        raise TargetNotFound(
            f"{100 * full:.0f} % of the pixels are at full scale {int(frame.max())}, which displaces every edge;"
            " expose shorter or close the aperture"
        )
    patches = grow_patches(find_saddles(frame, mask))
    if not patches or len(patches[0].index) < LEAST_BOARD:
        seen = len(patches[0].index) if patches else 0
        raise TargetNotFound(
            f"no chessboard in the frame (largest lattice: {seen} corners, {LEAST_BOARD} are needed); check light,"
            " focus and that squares are at least 8 px wide"
        )
    return frame, patches


def _with_discs(frame: NDArray[Any], patches: list[Patch], board: Chessboard) -> tuple[Patch, Placing] | None:
    """Patch that holds the discs and its placing, if it is a main part of what is seen.

    Discs in a small patch apart from the main lattice are seen through something, or on another board.
    """
    for patch in patches:
        if 2 * len(patch.index) < len(patches[0].index):
            break
        placing = place_by_discs(frame, patch, board)
        if placing is not None:
            return patch, placing
    return None


def _plausible(index: NDArray[np.int64], predicted: NDArray[np.float64], patch: Patch, placing: Placing) -> bool:
    """True if the board near the discs is as large as predicted, and turned so: no view through glass.

    How far off it is says nothing: an axis wrong by two degrees moves the view by five squares, where the lattice
    fits as well as in its place.
    """
    place = {(int(i), int(j)): p for (i, j), p in zip(index, predicted, strict=True)}
    axes = placing.board_axes(patch.axes_px)
    scale, along = [], []
    for (i, j), own in zip(placing.board_index(patch.index).tolist(), axes, strict=True):
        if max(abs(i), abs(j)) <= NEAR_DISCS and {(i, j), (i + 1, j), (i, j + 1)} <= place.keys():
            expected = np.stack((place[i + 1, j] - place[i, j], place[i, j + 1] - place[i, j]), axis=1)
            scale.append(float(np.linalg.det(own) / np.linalg.det(expected)))
            along.append(float(own[:, 0] @ expected[:, 0]) > 0.0)
    low, high = SCALES
    return bool(scale) and low**2 < float(np.median(scale)) < high**2 and float(np.mean(along)) > 0.5


def _why_not_placed(
    index: NDArray[np.int64], predicted: NDArray[np.float64], patch: Patch, board: Chessboard
) -> str:
    """Say why the largest patch lies on no predicted corners: squares of another size, or too far off."""
    place = {(i, j): p for (i, j), p in zip(index.tolist(), predicted, strict=True)}
    steps = [np.hypot(*(place[i + 1, j] - p)) for (i, j), p in place.items() if (i + 1, j) in place]
    seen = float(np.median(np.linalg.norm(patch.axes_px, axis=1)))
    expected = float(np.median(steps)) if steps else seen
    if abs(seen / expected - 1.0) * np.sqrt(len(patch.index)) > 1.0:  # half a square at the ends of the patch
        return (
            f"the squares in the frame are {seen:.1f} px wide, where the camera should see those of"
            f" {board.square_mm:g} mm with {expected:.1f} px; give the right square_mm (about"
            f" {board.square_mm * seen / expected:.2g}), or correct focal length and distance of the camera"
        )
    return (
        "the lattice in the frame lies more than half a square from its prediction and no disc is seen; give a"
        " better start, or bring the discs into view"
    )


def _corrected(
    index: NDArray[np.int64], predicted: NDArray[np.float64], patch: Patch, placing: Placing
) -> NDArray[np.float64]:
    """Predicted pixels moved by the 2nd-order polynomial that takes them to a patch already placed."""
    place = {(int(i), int(j)): n for n, (i, j) in enumerate(index)}
    mine = placing.board_index(patch.index)
    pairs = [(place[i, j], n) for n, (i, j) in enumerate(mine.tolist()) if (i, j) in place]
    if len(pairs) < LEAST_BOARD:
        return predicted
    rows, columns = np.array(pairs).T
    miss = patch.position_px[columns] - predicted[rows]
    centre, scale = predicted.mean(axis=0), np.ptp(predicted, axis=0).max()
    x, y = ((predicted - centre) / scale).T
    terms = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y), axis=-1)
    # Ridge: a small patch must not throw far corners about.
    normal = terms[rows].T @ terms[rows] + np.diag((0.0, 0.1, 0.1, 1.0, 1.0, 1.0))
    return np.asarray(predicted + terms @ np.linalg.solve(normal, terms[rows].T @ miss))
