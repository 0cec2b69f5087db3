"""Place of a patch of lattice on a board without marks: by its edges, its size, and the view.

A plain chessboard, or a grid of dots that are all alike, looks the same wherever it is moved by whole squares.  Of
all such places those are left where

* the patch is turned as the camera is believed to be,
* its corners are corners of the board, which has so many squares,
* an end that is seen (`board_ends`) is an edge of the board,
* it lies no farther from where it is expected than the camera may be off.

Of a grid of dots no end is looked for: it has one place where all of its rows and columns are in view, where the
camera is known to less than a pitch, or where `origin_px` points at the dot at the origin.

One place left is the place.  Several are refused, and what is missing is said; the nearest of them would be right
often, and else wrong by a whole square with nothing to show for it.
"""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_ends import Ends, ends_of
from correction.target.board_origin import Placing, dot_diameters
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.corners import ARM_LENGTH, LARGEST_RESIDUAL, CornerSearch, refine_corners
from correction.target.lattice_growth import Patch
from correction.target.scale_search import crossing_corners

UPRIGHT = 0.8  # cosine between an axis of the board and where it is expected: 37 degrees
LEAST_LINE = 3  # corners on a line of the lattice that count it as one of the board
ASKED = 25  # corners of a patch that say how far it lies from where it is expected
HALF_SQUARE = 0.5  # squares
NEAREST_DOT = 0.7  # pitches: one dot within this distance of a point is nearer to it than any other by far
POINTED = 0.35  # pitches from a dot, within which origin_px points at it
COUNTED_PX = 16.0  # half window of corners that are only counted: they are measured once their place is known


def place_by_count(
    frame: NDArray[Any],
    patch: Patch,
    board: Chessboard,
    view: tuple[NDArray[np.int64], NDArray[np.float64]],
    reach: float | None = None,
) -> tuple[Chessboard, Placing]:
    """Place a patch of a board of which no mark is seen, and say which of its squares are bright.

    Parameters
    ----------
    frame : (H, W) array
        The checked frame.
    patch : Patch
        The largest in it.
    board : Chessboard
    view : (M, 2) int64 and (M, 2) float64
        Board corners in view and where they are expected.
    reach : float
        How far the view may be off, in squares; not given, it is believed, and the nearest place is the place.

    Raises
    ------
    TargetNotFound
        Several places are possible, or none.
    """
    corners = patch if board.dots is not None else _refine_patch(frame, patch, board)
    turn, expected = as_expected(corners, *view)
    if board.dots is not None:
        dot_diameters(frame, corners, board)
        ends = Ends((None, None), (None, None))
    else:
        ends = ends_of(frame, corners)
    if board.origin_px is not None and reach is not None:
        expected, reach = -(_dot_at_origin_px(corners, board.origin_px) @ turn).astype(np.float64), 0.0
    else:
        reach = max(reach or 0.0, HALF_SQUARE if board.dots is None else NEAREST_DOT)
    found = _possible(corners, board, ends, turn, expected, reach)
    if len(found) != 1:
        raise TargetNotFound(_why(found, corners, board, ends.ends_along(turn), turn, reach))
    if board.is_plain and board.dots is None:
        board = replace(board, odd_bright=_odd_bright(corners, found[0]))
    return board, found[0]


def origin_basis(board: Chessboard, index: NDArray[np.int64], reach: float | None) -> str:
    """Say what the origin of a board that `place_by_count` has placed rests on, by the marks (N, 2) in view."""
    lines = board.outer_lines
    if board.origin_px is not None and reach is not None:
        return "origin_px of the board file"
    if lines is not None and (np.ptp(board.lines_of(index), axis=0) >= np.diff(lines, axis=0)[0] - 2).all():
        return "the number of its rows and columns"
    if lines is not None and board.dots is None:
        return "its edges"
    return "the camera as described"


def _dot_at_origin_px(patch: Patch, origin_px: tuple[float, float]) -> NDArray[np.int64]:
    """Relative index (2,) of the dot at which a user has pointed."""
    off = patch.position_px - np.array(origin_px)
    nearest = int(np.linalg.norm(off, axis=1).argmin())
    if np.abs(np.linalg.solve(patch.axes_px[nearest], off[nearest])).max() > POINTED:
        u, v = patch.position_px[nearest].round(1).tolist()
        raise TargetNotFound(
            f"origin_px {list(origin_px)} points at no dot that is found; the nearest is at [{u}, {v}]: give that,"
            " or the place of another in the bare frame at z = 0"
        )
    return np.asarray(patch.index[nearest])


def _refine_patch(frame: NDArray[Any], patch: Patch, board: Chessboard) -> Patch:
    """Corners of a patch between four squares, measured; TargetNotFound where they are few."""
    fit = refine_corners(
        frame,
        patch.position_px,
        patch.axes_px,
        sign=patch.sign,
        window=np.minimum(ARM_LENGTH, COUNTED_PX / np.linalg.norm(patch.axes_px, axis=1).max(axis=1)),
        search=CornerSearch(board.arm, patch.error_px, max_shift=0.3),
    )
    crossing = crossing_corners(frame, board, patch.position_px, patch.axes_px, patch.sign)
    corners = replace(patch, position_px=fit.position_px).take(fit.valid & crossing)
    if len(corners.index) < LEAST_LINE**2:
        whole, residual = len(corners.index), fit.residual[np.isfinite(fit.residual)]
        if 2 * whole > min(int(np.count_nonzero(crossing)), LEAST_LINE**2):
            raise TargetNotFound(
                f"only {whole} corners between four squares are in view, {LEAST_LINE**2} are needed; bring"
                " more of the board into view"
            )
        is_noisy = len(residual) and np.median(residual) > LARGEST_RESIDUAL
        cause, cure = ("noisy", "bring more light") if is_noisy else ("blurred", "check focus")
        raise TargetNotFound(f"the corners of the board are too {cause} to be measured; {cure}")
    return corners


def as_expected(
    patch: Patch, index: NDArray[np.int64], predicted: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Turn (2, 2) of a patch, relative = turn @ board, and where its corner (0, 0) is expected (2,), as index."""
    place = {(i, j): p for (i, j), p in zip(index.tolist(), predicted, strict=True)}
    known = [(i, j) for i, j in place if {(i + 1, j), (i, j + 1)} <= place.keys()]
    if not known:
        raise TargetNotFound(
            "the camera should see too little of the board; check its place, and the board's size"
        )
    tree = scipy.spatial.cKDTree([place[corner] for corner in known])
    near = np.argsort(np.linalg.norm(patch.position_px - np.median(patch.position_px, axis=0), axis=1))[:ASKED]
    turns = np.array(QUARTER_TURNS)
    upright, where = np.zeros((len(turns), 0)), np.zeros((0, len(turns), 2))
    for n in near.tolist():
        i, j = known[int(tree.query(patch.position_px[n])[1])]
        axes = np.stack((place[i + 1, j] - place[i, j], place[i, j + 1] - place[i, j]), axis=1)
        own = patch.axes_px[n] @ turns
        cosine = np.sum(own * axes, axis=1) / np.linalg.norm(own, axis=1) / np.linalg.norm(axes, axis=0)
        upright = np.column_stack((upright, cosine.min(axis=1)))
        here = np.array((i, j)) + np.linalg.solve(axes, patch.position_px[n] - place[i, j])
        where = np.concatenate((where, (here - patch.index[n] @ turns)[None]))
    if np.median(upright, axis=1).max() < UPRIGHT:
        raise TargetNotFound(
            "the board in the frame hangs turned against the camera as described, by more than a plain chessboard"
            " can tell; hang it upright, or give the camera its roll"
        )
    best = int(np.median(upright, axis=1).argmax())
    return turns[best], np.median(where[:, best], axis=0)


def _possible(
    patch: Patch,
    board: Chessboard,
    ends: Ends,
    turn: NDArray[np.int64],
    expected: NDArray[np.float64],
    reach: float,
) -> list[Placing]:
    """All places that a patch may have."""
    near = [
        np.arange(np.ceil(middle - reach), np.floor(middle + reach) + 1.0)
        if reach > HALF_SQUARE
        else np.rint([middle])
        for middle in expected.tolist()
    ]
    moves = np.array(list(itertools.product(*near))).reshape(-1, 2).astype(np.int64)
    if board.outer_lines is not None:
        (low, high), by = _extent(board.lines_of(patch.index @ turn)), board.lines_of(moves)
        first, last = board.outer_lines
        held = ((low + by > first) & (high + by < last)).all(axis=1)
        for axis, seen in enumerate(ends.ends_along(turn)):
            for line, edge in zip(seen, (first[axis], last[axis]), strict=True):
                held &= line is None or line + by[:, axis] == edge
        moves = moves[held]
    (a, b), (c, d) = turn.tolist()
    places = [Placing(((a, b), (c, d)), (-(a * x + b * y), -(c * x + d * y))) for x, y in moves.tolist()]
    if board.dots is not None:
        return places
    return [one for one in places if not board.discs or _odd_bright(patch, one) == board.odd_bright]


def _extent(on_lines: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lowest and highest line (2, 2) along x and y with enough of the corners on lines (N, 2) to count."""
    extent = np.empty((2, 2), np.int64)
    for axis in range(2):
        lines, count = np.unique(on_lines[:, axis], return_counts=True)
        kept = lines[count >= min(LEAST_LINE, count.max())]
        extent[:, axis] = kept.min(), kept.max()
    return extent


def _odd_bright(patch: Patch, placing: Placing) -> bool:
    """Return whether squares with i + j odd are bright, if a patch lies there."""
    odd = placing.board_index(patch.index).sum(axis=1) % 2 == 1
    turned = 1 if placing.turn[0][0] else -1  # after a quarter turn the square towards +x, +y is another
    return bool(np.sum(np.where(odd, patch.sign, -patch.sign)) * turned > 0)


def _why(
    found: list[Placing],
    patch: Patch,
    board: Chessboard,
    ends: list[tuple[int | None, int | None]],
    turn: NDArray[np.int64],
    reach: float,
) -> str:
    """Say why a patch has no place, or several."""
    across, up = (np.diff(_extent(board.lines_of(patch.index @ turn)), axis=0)[0] + 1).tolist()
    seen = f"a lattice of {across} x {up} corners is in the frame"
    if board.dots is not None:
        return _why_no_dot_place(len(found), (across, up), board, reach)
    if found and board.discs:
        return f"{seen}, but not the {len(board.discs)} discs that mark the origin; bring them into view"
    if board.squares is None:
        return (
            f"{seen}, and no mark that says which they are, and the camera is known to {reach:.2g} squares only:"
            " say how many squares the board has (squares: [columns, rows] in board.yaml) and bring one of its"
            " corners into view, or print one with marks (rtpiv setup target)"
        )
    columns, rows = board.squares
    if found:
        return (
            f"{seen}, which may be any of {len(found)} places on a board of {columns} x {rows} squares: bring a"
            " corner of the board into view with white paper around it, print one with marks"
            " (rtpiv setup target), or give the camera's place better in fit.camera"
        )
    apart = [
        f"{high - low} squares from edge to edge" for low, high in ends if low is not None and high is not None
    ]
    return (
        f"{' and '.join([seen, *apart])}, and no such place on a board of {columns} x {rows} squares lies within"
        f" {reach:.2g} squares of where the camera should see it; count the squares again, or correct the camera"
    )


def _why_no_dot_place(places: int, seen: tuple[int, int], board: Chessboard, reach: float) -> str:
    """Say why a grid of dots without large ones has no place, or several."""
    grid = "the grid"
    if board.squares is not None:
        columns, rows = board.squares
        grid = f"a grid of {columns - 1} x {rows - 1}"
    dots = "half pitches and rows of dots" if board.staggered else "dots"
    words = f"{seen[0]} x {seen[1]} {dots} are in the frame, all alike"
    if not places:
        return (
            f"{words}, which is no part of {grid} within {reach:.2g} pitches of where the camera should see it;"
            " count its dots again (squares: one more than dots, each way), or correct the camera"
        )
    return (
        f"{words}, which may be any of {places} places on {grid}, as the camera is known to {reach:.2g} pitches"
        " only: point at the dot at the origin (origin_px: [u, v] in board.yaml), show all rows and columns and"
        " say how many there are (squares), or use a grid with large dots (large_dot_mm)"
    )
