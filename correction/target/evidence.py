"""Evidence of a frame against the place that marks give a board: shades of squares, edges, corners beyond them.

Marks alone do not show a wrong number of squares, a board file of another board, or a negative print: the origin
is counted from a corner of the board, so one row too many in the file moves every place by a square.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.target.board_ends import ends_of
from correction.target.board_origin import Placing
from correction.target.chessboard import Chessboard
from correction.target.lattice_growth import Patch

View = tuple[NDArray[np.int64], NDArray[np.float64]]  # corners of the board, and where they are expected [px]
NEAR_MARKS = 6  # squares around the origin in which the view and its prediction are compared
MOST_OTHER_SHADE = 0.1  # of the corners: saddles of something else are few
BEYOND_EDGE, MOST_ON_EDGE = (
    4,
    0.6,
)  # corners on the end of the board that show squares beyond it, and of the line before


@dataclass(frozen=True)
class TurnAndScale:
    """A view of the board against its prediction.

    Parameters
    ----------
    turn_deg : float
        By how much it is turned in the image, clockwise.
    scale : float
        How many times as large it is near the origin.
    """

    turn_deg: float
    scale: float


def turn_and_scale(view: View, patch: Patch, placing: Placing) -> TurnAndScale | None:
    """Compare a placed patch with its prediction near the origin, or all over where nothing is seen there."""
    place = {(int(i), int(j)): p for (i, j), p in zip(*view, strict=True)}
    axes, index = placing.board_axes(patch.axes_px), placing.board_index(patch.index)
    known = [n for n, (i, j) in enumerate(index.tolist()) if {(i, j), (i + 1, j), (i, j + 1)} <= place.keys()]
    if not known:
        return None
    at = [tuple(corner) for corner in index[known].tolist()]
    expected = np.array([(place[i + 1, j] - place[i, j], place[i, j + 1] - place[i, j]) for i, j in at])
    own = axes[known]
    scale = np.sqrt(np.abs(np.linalg.det(own) / np.linalg.det(expected)))
    along, ahead = (vectors[..., 0] + 1j * vectors[..., 1] for vectors in (own[:, :, 0], expected[:, 0]))
    turn = along / ahead
    near = np.abs(index[known]).max(axis=1) <= NEAR_MARKS
    near = near if near.any() else ~near
    angle = np.angle(np.mean((turn / np.abs(turn))[near]))
    return TurnAndScale(float(np.rad2deg(angle)), float(np.median(scale[near])))


def squares_off(view: View, patch: Patch, placing: Placing) -> float:
    """Return how many squares a placed patch lies from where it is expected; infinite where nothing is."""
    place = {(int(i), int(j)): p for (i, j), p in zip(*view, strict=True)}
    off = [
        float(np.abs(np.linalg.solve(axes, place[i, j] - p)).max())
        for (i, j), p, axes in zip(
            placing.board_index(patch.index).tolist(), patch.position_px, patch.axes_px, strict=True
        )
        if (i, j) in place
    ]
    return float(np.median(off)) if off else np.inf


def contradiction(board: Chessboard, patch: Patch, placing: Placing) -> str:
    """Say how the shades of squares contradict the place that marks give a patch; "" where they agree."""
    if board.dots is not None:
        return ""
    # After a quarter turn the square towards +x, +y is one of the other shade.
    kept = 1 if placing.turn[0][0] else -1
    other = float(np.mean(patch.sign * kept != board.corner_sign(placing.board_index(patch.index))))
    if other <= MOST_OTHER_SHADE:
        return ""
    return (
        f"{100.0 * other:.0f} % of the corners have bright and dark squares exchanged, where the marks put the"
        " board; describe the board that is in the frame"
    )


def wrong_size(frame: NDArray[Any], board: Chessboard, patch: Patch, placing: Placing) -> str:
    """Say where edges of a board are seen elsewhere than its number of squares puts them; "" where none is.

    Parameters
    ----------
    frame : (H, W) array
        The checked frame.
    board : Chessboard
    patch : Patch
        Corners of the board, and none of anything else.
    placing : Placing
        Where they lie by the marks.
    """
    lines, size = board.outer_lines, board.squares
    if board.dots is not None or lines is None or size is None:
        return ""
    turn = np.array(placing.turn)
    shift = turn.T @ np.array(placing.shift)
    index = placing.board_index(patch.index)
    ends = ends_of(frame, patch, board.codes.marker_share if board.codes else 0.0).ends_along(turn)
    for axis, (words, way) in enumerate((("columns", "left to right"), ("rows", "bottom to top"))):
        seen = [
            int(end - shift[axis]) - int(line)
            for end, line in zip(ends[axis], lines[:, axis], strict=True)
            if end is not None
        ]
        # Discs show the origin itself; markers are counted from the upper edge, the origin from the lower.
        by = [off for off in seen if off and (board.codes is not None or 0 not in seen)]
        # Saddles beside the end of a board are some of its last line; squares beyond it show all of them.
        beyond = [
            count
            for line, inwards in ((int(lines[0, axis]), 1), (int(lines[1, axis]), -1))
            if (count := np.count_nonzero(index[:, axis] == line)) >= BEYOND_EDGE
            and count >= MOST_ON_EDGE * np.count_nonzero(index[:, axis] == line + inwards)
        ]
        if by or beyond:
            where = f"an edge of the board is seen {abs(by[0])} squares from" if by else "squares are seen beyond"
            return (
                f"{where} where its marks and {size[0]} x {size[1]} squares put the edge of the board: count its"
                f" {words} ({way}) again, and the squares up to its origin_corner"
            )
    return ""
