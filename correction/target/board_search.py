"""Find the target in a frame: every corner with its place on the board and its sub-pixel position.

    saddles -> patches of lattice -> origin from the discs -> sub-pixel fit -> corners the saddles missed

`find_board` needs no start: any turn, tilt, barrel distortion, board partly outside.  `track_board` also
takes a prediction, from a nominal camera say: it places patches in which no disc is seen (a board moved
aside, glass above the discs) as long as the prediction is good to half a square somewhere, and uses the
discs, where they are seen, if it is worse.  Where it may be worse and no disc is seen, or the board has none, its
edges and the number of its squares must leave one place only (`board_count`).  Placed patches are then fitted
(`lattice_fit`).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_count import as_expected, origin_basis, place_by_count
from correction.target.board_origin import (
    MIN_VOTE_SHARE,
    Placing,
    discs_elsewhere,
    place_by_discs,
    place_by_prediction,
)
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.codes import Marker, place_by_codes, read_markers, square_px, why_mirrored, why_no_codes
from correction.target.evidence import View, squares_off, turn_and_scale, wrong_size
from correction.target.lattice_fit import (
    MOST_FOREIGN,
    BoardDetection,
    holds_discs,
    measure_lattice,
)
from correction.target.lattice_growth import LEAST_BOARD, Patch, lattice_axes
from correction.target.marks import find_marks, grow_marks
from correction.target.scale_search import crossing_corners, find_patches
from correction.target.size_seen import CLEARLY_OFF, size_seen
from correction.target.smooth_view import on_smooth_map
from piv.errors import FrameError
from piv.resampling.sample import checked_frame

Predict = Callable[[NDArray[np.float64]], NDArray[np.float64]]
HALF_SQUARE = 0.5  # squares
NEAR_MARKS, ENOUGH = 3, 300  # squares around the origin with all of its marks; corners that show a smooth view
MOST_TURN_DEG = 45.0  # of the board in its plane: beyond, another quarter turn of it is as likely
# Of the view near the discs against its prediction: a ball shows them twice as large, or turned
SCALES = 0.7, 1.4
SATURATED = 0.02  # fraction of pixels at full scale from which bright squares are seen widened
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
        No lattice, no discs, or another board; the message says which and the cure.
    """
    if board.is_plain:
        raise TargetNotFound("a plain board is found by its edges and a prediction of its view; give one")
    frame, patches, markers = _patches(image, board, mask)
    board, placed = _with_codes(frame, patches, markers, board)
    if placed:
        return measure_lattice(frame, board, placed, mask)
    if board.codes is not None:
        raise TargetNotFound(why_no_codes(frame, board, markers, patches[0]))
    marked = _with_discs(frame, patches, board)
    if marked is not None:
        return measure_lattice(frame, board, [marked], mask, discs_count=True)
    raise TargetNotFound(
        f"a lattice of {len(patches[0].index)} corners is in the frame, but not the {len(board.discs)}"
        f" {board.origin_marks} that mark the origin; bring them into view, or give a prediction of the view"
    )


def find_lattice(image: NDArray[Any], board: Chessboard, mask: NDArray[np.bool_] | None = None) -> BoardDetection:
    """Find the marks of a board whose place and turn do not matter, as of one that is held by hand.

    Marks that show the origin are used where they are seen, and required where the print is stretched along one of
    its directions only. Otherwise the corner at the origin is any one.

    Parameters
    ----------
    image, board, mask
        As in `find_board`.

    Raises
    ------
    FrameError
        Not a frame.
    TargetNotFound
        No lattice, or another board; the message says which and the cure.
    """
    turns_matter = board.scale[0] != board.scale[1] or len(board.depths_mm) > 1
    if board.codes is not None or turns_matter:
        return find_board(image, board, mask)
    endless = replace(board, discs=(), squares=None, origin_corner=None)
    frame, patches, _ = _patches(image, endless, mask)
    exchanged = float(np.mean(patches[0].sign == endless.corner_sign(patches[0].index))) < MIN_VOTE_SHARE
    place = Placing(QUARTER_TURNS[0], (int(exchanged), 0))  # one square on, bright and dark are exchanged
    return measure_lattice(frame, endless, [(patches[0], place)], mask)


def find_held_board(
    image: NDArray[Any], board: Chessboard, mask: NDArray[np.bool_] | None = None
) -> BoardDetection:
    """Find a board that is held by hand, at any pose, each mark with its own place on the board.

    Of a board without marks of its own the edges must be in view: they are counted in the view that its lattice
    shows, in whichever of four turns they fit.

    Parameters
    ----------
    image, board, mask
        As in `find_board`.  A board that was found before has its bright squares where that frame shows them.

    Raises
    ------
    FrameError, TargetNotFound
        As `find_board`.
    """
    if board.codes is not None or (board.discs and not board.is_turn_symmetric):
        return find_board(image, board, mask)
    import cv2

    loose = find_lattice(image, board, mask)
    to_frame, _ = cv2.findHomography(loose.plane_mm, loose.position_px)
    refused = None
    for turn in QUARTER_TURNS:
        turned = np.eye(3)
        turned[:2, :2] = turn
        predict = partial(_through_homography, np.asarray(to_frame) @ turned)
        try:
            found = track_board(image, board, predict, mask, float(FAR_SQUARES))
        except TargetNotFound as error:
            refused = refused or error
            continue
        if found.board.odd_bright == board.odd_bright:
            return found
    raise refused or TargetNotFound(
        "bright and dark squares are exchanged against the frame of the board at z = 0"
    )


def _through_homography(to_frame: NDArray[np.float64], place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (M, 2) of marks (M, 3) of a board by a homography (3, 3); NaN behind the camera."""
    at = np.column_stack((place_mm[:, :2], np.ones(len(place_mm)))) @ to_frame.T
    return np.asarray(at[:, :2] / np.where(at[:, 2:] > 0.0, at[:, 2:], np.nan))


def track_board(
    image: NDArray[Any],
    board: Chessboard,
    predict: Predict,
    mask: NDArray[np.bool_] | None = None,
    reach: float | None = None,
) -> BoardDetection:
    """Find the target with the help of a prediction.

    Parameters
    ----------
    image, board, mask
        As in `find_board`.
    predict : callable
        Marks of the board (M, 3) [mm], x and y on it and z before it -> expected pixels (M, 2); NaN where the
        view cannot show them.
    reach : float, optional
        How far the prediction may be off, in squares.  Without, it is believed: what is nearest lies there.

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
    if _is_mirrored(board, predict):
        return _find_in_mirror(image, board, predict, mask, reach)
    frame, patches, markers = _patches(image, board, mask)
    index, predicted = corners_in_view(board, predict, (frame.shape[0], frame.shape[1]))
    if len(index) == 0:
        raise TargetNotFound("the prediction puts no corner of the board into the frame; check the nominal camera")
    view = index, predicted
    board, placed = _with_codes(frame, patches, markers, board, view, reach)
    marked = _with_discs(frame, patches, board, view) if board.discs else None
    if marked is not None and not _plausible(board, view, *marked):
        marked = None
    if placed:
        _plausible(board, view, *placed[0])
    if board.codes is not None and not placed and reach is not None:
        raise TargetNotFound(why_no_codes(frame, board, markers, patches[0]))
    if marked is not None and board.is_turn_symmetric:
        off, most = squares_off(view, *marked), max(reach or 0.0, HALF_SQUARE)
        if off > most:
            raise TargetNotFound(
                f"the {board.origin_marks} in the frame are {off:.1f} pitches from where the camera should see"
                f" them, and it is known to {most:.2g}; correct the camera, or clean spots off the board"
            )
    if board.dots is not None and board.discs and marked is None and reach is not None:
        raise TargetNotFound(
            _why_another_size(frame, patches[0], view, board)
            or f"a grid of {len(patches[0].index)} dots is in the frame, but not the {len(board.discs)}"
            f" {board.origin_marks} that mark the origin, whole and as large as the camera should see them; bring"
            " them into view,"
            " or correct pitch and camera"
        )
    counted = marked is None and not placed and (reach is not None or board.is_plain)
    if counted:
        try:
            board, place = place_by_count(frame, patches[0], board, view, reach)
        except TargetNotFound as error:
            raise TargetNotFound(_why_another_size(frame, patches[0], view, board) or str(error)) from None
        marked = patches[0], place
        elsewhere = discs_elsewhere(frame, *marked, board) if board.discs else 0
        if elsewhere:
            raise TargetNotFound(
                f"{elsewhere} squares show a disc where the edges of the board put none, or none where they put"
                " one: the frame may be a mirror image or turned, or the board described is not the print; bring"
                " all discs into view"
            )
    if marked is not None:
        placed = [marked]
    if placed:
        predicted = _correct_prediction(index, predicted, *placed[0])
        patches = [patch for patch in patches if all(patch is not other for other, _ in placed)]
    for patch in patches:
        placing = place_by_prediction(patch, index, predicted, board)
        if placing is not None:
            placed.append((patch, placing))
            if len(placed) == 1:
                predicted = _correct_prediction(index, predicted, patch, placing)
    if not placed:
        raise TargetNotFound(_why_not_placed(frame, patches[0], (index, predicted), board))
    found = measure_lattice(frame, board, placed, mask)
    return replace(found, origin_basis=origin_basis(board, found.index, reach)) if counted else found


def _is_mirrored(board: Chessboard, predict: Predict) -> bool:
    """Return whether a prediction shows the board in a mirror: at its origin, or else at any corner in view."""
    grid = np.arange(-16, 17)
    index = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    step = (predict(board.place_mm(index + move)) for move in ((0, 0), (1, 0), (0, 1)))
    origin, right, up = (np.asarray(pixel, dtype=np.float64) for pixel in step)
    sides = np.stack((right - origin, up - origin), axis=-1)
    sides = sides[np.isfinite(sides).all(axis=(1, 2))]
    return bool(len(sides)) and float(np.median(np.linalg.det(sides))) > 0.0  # v points down


def _find_in_mirror(
    image: NDArray[Any],
    board: Chessboard,
    predict: Predict,
    mask: NDArray[np.bool_] | None,
    reach: float | None,
) -> BoardDetection:
    """Find the target of a mirrored camera in the frame with its columns reversed; arguments as `track_board`."""
    last = np.asarray(image).shape[1] - 1.0

    def mirror_view(place_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(predict(place_mm), np.float64) * (-1.0, 1.0) + (last, 0.0)

    seen = None if mask is None else np.ascontiguousarray(mask[:, ::-1])
    return mirror_found(track_board(np.ascontiguousarray(image[:, ::-1]), board, mirror_view, seen, reach), last)


def mirror_found(found: BoardDetection, last_px: float) -> BoardDetection:
    """Return a board as it is seen in the frame with its columns, the last of which is `last_px`, reversed."""
    across = np.array((-1.0, 1.0))
    return replace(
        found, position_px=found.position_px * across + (last_px, 0.0), axes_px=found.axes_px * across[:, None]
    )


def corners_in_view(
    board: Chessboard, predict: Predict, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Corners that a prediction puts into a frame: index (N, 2) and pixels (N, 2).

    Parameters
    ----------
    board : Chessboard
    predict : callable
        Marks of the board (M, 3) [mm], x and y on it and z before it -> pixels (M, 2) or NaN.
    shape : (int, int)
        Rows and columns of the frame.
    """
    size = np.array((shape[1] - 1.0, shape[0] - 1.0))
    index, pixels, half, before = np.empty((0, 2), np.int64), np.empty((0, 2)), 16, -1
    while half <= FAR_SQUARES and len(index) != before:
        before = len(index)
        grid = np.arange(-half, half + 1)
        every = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        pixel = np.asarray(predict(board.place_mm(every)), dtype=np.float64)
        inside = ((pixel >= 0.0) & (pixel <= size)).all(axis=1) & board.has_corner(every)  # False for NaN
        index, pixels = every[inside].astype(np.int64), pixel[inside]
        half *= 2
    return index, pixels


def _patches(
    image: NDArray[Any], board: Chessboard, mask: NDArray[np.bool_] | None
) -> tuple[NDArray[Any], list[Patch], list[Marker]]:
    """Check the frame; return it with its patches of lattice, and the markers of the board in it."""
    frame = checked_frame(image)
    if mask is not None and mask.shape != frame.shape:
        raise FrameError(f"the mask has shape {mask.shape}, the frame {frame.shape}; they must agree")
    if frame.dtype == np.float32 and not np.isfinite(frame.sum(dtype=np.float64)):
        raise FrameError("the frame holds NaN or infinity; fill those pixels and mask them")
    markers = [] if board.codes is None else read_markers(frame, board)
    patches = find_patches(frame, board, mask, square_px(board, markers) if markers else None)
    if not patches or len(patches[0].index) < LEAST_BOARD:
        seen = len(patches[0].index) if patches else 0
        raise TargetNotFound(_why_no_lattice(frame, board, seen))
    return frame, patches, markers


def _why_no_lattice(frame: NDArray[Any], board: Chessboard, seen: int) -> str:
    """Say why no lattice of `seen` corners is enough, and which other board it may be."""
    if board.dots is None:
        return (
            f"no chessboard in the frame (largest lattice: {seen} corners, {LEAST_BOARD} are needed); check light,"
            " focus and that squares are at least 8 px wide"
        )
    other = replace(board, dots=replace(board.dots, bright=not board.dots.bright))
    squares = Chessboard(board.square_mm, discs=())
    for kind, words in (
        (other, "dots of the other shade: change bright_dots"),
        (squares, "a chessboard: change kind"),
    ):
        patches = grow_marks(find_marks(frame, kind))
        if patches and len(patches[0].index) > max(seen, LEAST_BOARD):
            return f"the frame shows {words} in the board file, or show the board that it describes"
    return (
        f"no grid of dots in the frame (largest: {seen} dots, {LEAST_BOARD} are needed); check light, focus"
        " and that dots are at least 4 px wide and 8 px apart"
    )


def _with_discs(
    frame: NDArray[Any], patches: list[Patch], board: Chessboard, view: View | None = None
) -> tuple[Patch, Placing] | None:
    """Patch that holds the discs and its placing, if it is a main part of what is seen.

    Discs in a small patch apart from the main lattice are seen through something, or on another board.
    """
    for patch in patches:
        if 2 * len(patch.index) < len(patches[0].index):
            break
        needs_turn = (
            view is not None and board.dots is not None and (board.is_turn_symmetric or board.dots.triangle)
        )
        turn = as_expected(patch, *view)[0] if view is not None and needs_turn else None
        placing = place_by_discs(frame, patch, board, turn)
        if placing is not None:
            return patch, placing
    return None


def _with_codes(
    frame: NDArray[Any],
    patches: list[Patch],
    markers: list[Marker],
    board: Chessboard,
    view: View | None = None,
    reach: float | None = None,
) -> tuple[Chessboard, list[tuple[Patch, Placing]]]:
    """Place patches by their markers; return the board in the layout that the frame shows, and what is placed.

    Markers of a part of a board may agree in both layouts, a square apart: edges, shades, or a view that is good
    to `reach` squares must leave one.
    """
    try:
        found = place_by_codes(patches, markers, board)
    except TargetNotFound as error:
        raise TargetNotFound(why_mirrored(frame, board, markers, patches[0]) or str(error)) from None
    kept = found
    if len(kept) > 1:
        patch, _ = found[0][1][0]
        patch = patch.take(on_smooth_map(patch.index, patch.position_px, patch.axes_px))
        kept = [(one, placed) for one, placed in found if not wrong_size(frame, one, patch, placed[0][1])] or found
    if len(kept) > 1 and view is not None:
        kept = [one for one in kept if squares_off(view, *one[1][0]) <= max(reach or 0.0, HALF_SQUARE)] or kept
    if len({placed[0][1] for _, placed in kept}) > 1:
        raise TargetNotFound(
            "the markers in the frame agree with both layouts of the board, a square apart; give its layout (new,"
            " or legacy: OpenCV before 4.6, calib.io) in board.yaml, or show more of the board"
        )
    return kept[0] if kept else (board, [])


def _plausible(board: Chessboard, view: View, patch: Patch, placing: Placing) -> bool:
    """True if the board near its marks is as large as predicted, and turned so: no view through glass.

    How far off it is says nothing: an axis wrong by two degrees moves the view by five squares, where the lattice
    fits as well as in its place.

    Raises
    ------
    TargetNotFound
        Board, or frame, are turned: marks and most corners lie on one smooth view, as none is through glass.
    """
    seen = turn_and_scale(view, patch, placing)
    if seen is None or not SCALES[0] < seen.scale < SCALES[1]:
        return False
    index = placing.board_index(patch.index)
    own = (np.abs(index) <= NEAR_MARKS).all(axis=1) if board.discs else np.zeros(len(index), dtype=bool)
    for mark in board.discs if board.dots is not None and not board.has_large_dots else ():  # anywhere on a plate
        own |= (np.abs(index - np.array(mark)) <= NEAR_MARKS).all(axis=1)
    some = own | (np.arange(len(index)) % max(1, len(index) // ENOUGH) == 0)
    deep = board.depth_mm(index[some]) != 0.0 if len(board.depths_mm) > 1 else None
    smooth = on_smooth_map(index[some], patch.position_px[some], patch.axes_px[some], deep)
    if not holds_discs(index[some][smooth], board):  # they are seen through something, or beside the others
        return False
    if abs(seen.turn_deg) <= MOST_TURN_DEG:
        return True
    if smooth.mean() < 1.0 - MOST_FOREIGN:
        return False
    quarter = abs(abs(seen.turn_deg) - 90.0) < MOST_TURN_DEG and board.discs and board.is_mirror_symmetric
    mirror = (
        " Its discs look the same in a mirror: if it hangs upright, the frame is a mirror image; set ReverseX or"
        " ReverseY of the camera back, or mirrored: true in the camera section of the scene."
    )
    raise TargetNotFound(
        f"the board in the frame is turned by {seen.turn_deg:+.0f} degrees against what the camera should see;"
        f" hang it upright, turn the frames, or give the camera its roll.{mirror if quarter else ''}"
    )


def _why_another_size(frame: NDArray[Any], patch: Patch, view: View, board: Chessboard) -> str:
    """Say how much larger than described the board is, where a patch is so all over; "" where it is not."""
    if board.dots is None:  # saddles along an edge of the paper are of no size
        patch = patch.take(crossing_corners(frame, board, patch.position_px, patch.axes_px, patch.sign))
        lattice_axes(patch.index, patch.position_px, patch.axes_px)
    size = size_seen(patch.position_px, patch.axes_px, view, board)
    return size.sentence if size is not None and size.differs(CLEARLY_OFF) else ""


def _why_not_placed(frame: NDArray[Any], patch: Patch, view: View, board: Chessboard) -> str:
    """Say why the largest patch lies on no predicted corners: squares of another size, or too far off."""
    return _why_another_size(frame, patch, view, board) or (
        f"the lattice in the frame lies more than half a square from its prediction and no"
        f" {board.origin_marks[:-1]} is seen; give a better start, or bring the {board.origin_marks} into view"
    )


def _correct_prediction(
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
