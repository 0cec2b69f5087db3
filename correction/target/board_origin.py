"""Place of a patch of lattice on the board: by the three discs, or a prediction.

Discs: every square with four known corners is sampled in its own bilinear frame.  A plain square is as
bright in the middle as towards its corners; a disc square is not.  The pattern of discs fits the lattice in
exactly one of four turns and one shift, or the frame does not show this board.  The mean of the profile
from the middle to the edge gives the disc's diameter: another ratio of disc to square is another board.

Of a grid of dots the large ones do the same: every dot is sampled in the frame of its neighbours, and those that
are wider than halfway between both kinds count.  Other marks are squares whose middle is as bright as the dots
around it, whatever stands there, or dots that are left out: a place amid neighbours that is as bright as ground.

Prediction: every corner votes for the turn and shift that put it on the nearest predicted corner of its
kind; right votes agree, wrong ones scatter.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.lattice_growth import Patch
from correction.target.scale_search import crossing_corners
from tracer.board import CHIRAL, OLDER, Dots, Square

RATIO_TOLERANCE = 0.25  # of the disc's diameter in squares; squeezed views blur a disc of 6 px by as much
MIN_VOTE_SHARE = 0.5  # of the votes
AROUND_SQUARE, AROUND_DOT = ((0, 0), (1, 0), (1, 1), (0, 1)), ((1, 0), (0, 1), (-1, 0), (0, -1))  # in turn
WITHIN_ROW = 0.8  # of the rings around a dot: walls stand closer between staggered rows of a plate
# Of the contrast, where a mark begins
MARK_EDGE = 0.35
# Of a triangle (`_triangularity`), and times that of the other marks
TRIANGULAR, CLEARLY_MORE = 0.15, 2.0
WIDEST_MARK, CLEAR_OF_DOTS = 0.45, 0.3  # squares from the middle of a mark, and from the dots around it
CELLS_ALIKE = 9  # cells of one level that show walls and shadows alike
# Of the contrast of dots, in the middle of a mark
PRESENT, BRIGHTEST = 0.5, 1.8
DISC, NO_DISC = 0.5, 0.25  # of the contrast: middle of a square against its border, if it has a disc, or has none


@dataclass(frozen=True)
class Placing:
    """Turn and shift from relative to board indices: relative = turn @ board + shift."""

    turn: tuple[tuple[int, int], tuple[int, int]]
    shift: tuple[int, int]

    def board_index(self, relative: NDArray[np.int64]) -> NDArray[np.int64]:
        """Board indices (N, 2) of relative ones."""
        return np.asarray((relative - np.array(self.shift)) @ np.array(self.turn))  # the inverse turn, on rows

    def board_axes(self, axes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns along the board's x, y from columns (N, 2, 2) along relative i, j."""
        return axes @ np.array(self.turn, dtype=np.float64)


def place_by_discs(
    frame: NDArray[Any], patch: Patch, board: Chessboard, turn: NDArray[np.int64] | None = None
) -> Placing | None:
    """Placing of a patch from the discs in it; None if the discs are not all in the patch.

    Marks that look the same after a turn need the `turn` (2, 2) to expect (relative = turn @ board).

    Raises
    ------
    TargetNotFound
        The discs are there, but of another size or with the shades exchanged, or they fit more than once.
    """
    find = _disc_squares if board.dots is None else _FIND[board.dots.marks]
    cells, bright, diameter = find(frame, patch, board)
    wanted = np.array(board.discs)
    triangle = board.dots is not None and board.dots.triangle is not None
    shades = np.zeros(len(wanted), bool) if triangle else board.disc_kinds()
    fits = _matches(cells, bright, board, wanted, shades)
    if triangle and fits:
        fits = _with_triangle(fits, diameter, board, turn)
        if not fits and turn is None:
            raise TargetNotFound(
                "light or focus hide which mark of the board is the triangle; give a prediction of its view, or"
                " light it evenly"
            )
    if len(fits) > 1 and board.dots is None:  # squares that something covers in part look like discs
        cells, bright, diameter = find(frame, _crossings(frame, patch, board), board)
        fits = _matches(cells, bright, board, wanted, shades)
    if board.is_turn_symmetric and turn is None:
        raise TargetNotFound(
            f"the {board.origin_marks} of the board look the same after a turn; give a prediction of its view"
        )
    if board.is_turn_symmetric and turn is not None:
        fits = [fit for fit in fits if np.array_equal(fit[0].turn, turn)]
    if len(fits) > 1:
        raise TargetNotFound(
            f"the pattern of {len(wanted)} {board.origin_marks} fits the frame {len(fits)} times; clean the board"
            f" or mask the spots that look like {board.origin_marks}"
        )
    if not fits:
        if board.dots is None and _matches(cells, bright, board, wanted, ~board.is_bright(wanted)):
            raise TargetNotFound(
                "bright and dark squares are exchanged compared to the board described; describe the board that"
                " is in the frame"
            )
        in_mirror = wanted * np.array((-1, 1))  # but for a shift
        mirrored = _matches(cells, bright, board, in_mirror, shades)
        if _with_triangle(mirrored, diameter, board, None) if triangle else mirrored:
            raise TargetNotFound(
                f"the {board.origin_marks} of the board are seen in a mirror: set ReverseX or ReverseY of the"
                " camera back, or mirrored: true in the camera section of the scene where it looks by a mirror"
            )
        older = CHIRAL[: len(OLDER)]
        if board.discs == CHIRAL and _matches(
            cells, bright, board, np.array(older), board.is_bright(np.array(older))
        ):
            raise TargetNotFound(
                f"{len(OLDER)} of the {len(CHIRAL)} discs described are in the frame: an older print, or a disc is"
                f" hidden; bring all into view, or leave discs out of board.yaml for {len(OLDER)} of them"
            )
        return None
    placing, members = fits[0]
    ratio, expected = float(np.mean(diameter[members])), board.disc_mm / board.square_mm
    if (board.dots is None or board.has_large_dots) and abs(ratio - expected) > RATIO_TOLERANCE * expected:
        raise TargetNotFound(
            f"the {board.origin_marks} measure {ratio:.2f} squares across, those of the board described"
            f" {expected:.2f}; put the described board into the frame, or describe this one"
        )
    return placing


def discs_elsewhere(frame: NDArray[Any], patch: Patch, placing: Placing, board: Chessboard) -> int:
    """Count squares of a patch that show a disc where a placed board has none, or none where it has one."""
    cells, _, share, _ = _squares(frame, _crossings(frame, patch, board))
    # A square turns about its middle, its index is that of its lower left corner.
    squares = np.rint((cells + 0.5 - np.array(placing.shift)) @ np.array(placing.turn) - 0.5).astype(int)
    described = np.array([tuple(square) in board.discs for square in squares.tolist()], bool)
    right, missing = described & (share > DISC), described & (share < NO_DISC)
    return int(np.count_nonzero(missing) or np.count_nonzero(~described & (share > DISC)) * (not right.any()))


def place_by_prediction(
    patch: Patch, index: NDArray[np.int64], predicted_px: NDArray[np.float64], board: Chessboard
) -> Placing | None:
    """Placing of a patch by votes for predicted corners.

    Parameters
    ----------
    patch : Patch
        Relative lattice.
    index, predicted_px : (M, 2)
        Board corners in view and where they are expected.
    board : Chessboard

    Returns
    -------
    Placing or None
        None if less than half of the corners agree.
    """
    if len(index) == 0:
        return None
    kinds = board.corner_sign(index)
    votes: Counter[Placing] = Counter()
    trees = {turn: scipy.spatial.cKDTree(predicted_px[kinds == turn]) for turn in (1, -1) if np.any(kinds == turn)}
    for turn in QUARTER_TURNS:
        # A quarter turn exchanges the kinds of corners; half turns keep them, and dots are all alike.
        swap = -1 if turn[0][0] == 0 and board.dots is None else 1
        for kind, tree in trees.items():
            mine = patch.sign == kind * swap
            if not mine.any():
                continue
            _, nearest = tree.query(patch.position_px[mine])
            shifts = patch.index[mine] - index[kinds == kind][nearest] @ np.array(turn).T
            votes.update(Placing(turn, (int(i), int(j))) for i, j in shifts)
    return _best_vote(votes, patch, index, predicted_px, board)


def _best_vote(
    votes: Counter[Placing],
    patch: Patch,
    index: NDArray[np.int64],
    predicted_px: NDArray[np.float64],
    board: Chessboard,
) -> Placing | None:
    """Most voted placing whose axes point as predicted; a prediction needs no disc to tell the turns apart."""
    place = {(i, j): p for (i, j), p in zip(index.tolist(), predicted_px, strict=True)}
    for placing, count in votes.most_common(8):
        if count < MIN_VOTE_SHARE * len(patch.index):
            return None
        mine = placing.board_index(patch.index)
        along = [
            float(axes[:, 0] @ (place[i + 1, j] - place[i, j]))
            for (i, j), axes in zip(mine.tolist(), placing.board_axes(patch.axes_px), strict=True)
            if (i, j) in place and (i + 1, j) in place
        ]
        if along and np.mean(np.array(along) > 0.0) > MIN_VOTE_SHARE:
            cross = _agreement(placing, patch, place)
            if cross > MIN_VOTE_SHARE:
                return placing
    return None


def _agreement(placing: Placing, patch: Patch, place: dict[tuple[int, int], NDArray[np.float64]]) -> float:
    """Share of corners that lie within 0.6 squares of their predicted place."""
    near = []
    for (i, j), p, axes in zip(
        placing.board_index(patch.index).tolist(), patch.position_px, patch.axes_px, strict=True
    ):
        if (i, j) in place:
            miss = np.linalg.solve(axes, place[i, j] - p)
            near.append(np.abs(miss).max() < 0.6)
    return float(np.mean(near)) if near else 0.0


def _matches(
    cells: NDArray[np.int64],
    bright: NDArray[np.bool_],
    board: Chessboard,
    wanted: NDArray[np.int64],
    shades: NDArray[np.bool_],
) -> list[tuple[Placing, list[int]]]:
    """All turns and shifts in which every disc of the board meets a disc square of its shade."""
    place = {(int(i), int(j), bool(b)): n for n, ((i, j), b) in enumerate(zip(cells, bright, strict=True))}
    # Of what carries a disc, from its index:
    middle = 0.5 if board.dots is None or board.dots.marks == "between" else 0.0
    fits = []
    for turn in QUARTER_TURNS:
        centres = (wanted + middle) @ np.array(turn).T  # a square's middle turns, its corner does not
        for cell in cells[bright == shades[0]]:
            shift = np.rint(cell + middle - centres[0]).astype(np.int64)
            squares: Sequence[Sequence[float]] = (centres + shift - middle).tolist()
            keys = [(round(i), round(j), bool(b)) for (i, j), b in zip(squares, shades, strict=True)]
            if all(key in place for key in keys):
                fits.append((Placing(turn, (int(shift[0]), int(shift[1]))), [place[key] for key in keys]))
    return fits


def _crossings(frame: NDArray[Any], patch: Patch, board: Chessboard) -> Patch:
    """Corners of a patch that lie between four squares: those of a square that is half covered do not."""
    return patch.take(crossing_corners(frame, board, patch.position_px, patch.axes_px, patch.sign))


def _squares(
    frame: NDArray[Any], patch: Patch
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Squares (N, 2) of a patch, whether they are bright (N,), contrast of a disc (N,), corners (N, 4, 2) [px]."""
    place = {(int(i), int(j)): n for n, (i, j) in enumerate(patch.index)}
    cells = [c for c in place if all((c[0] + i, c[1] + j) in place for i, j in ((1, 0), (0, 1), (1, 1)))]
    if not cells:
        return np.empty((0, 2), np.int64), np.empty(0, bool), np.empty(0), np.empty((0, 4, 2))
    corners = np.array([[place[i + a, j + b] for a, b in ((0, 0), (1, 0), (0, 1), (1, 1))] for i, j in cells])
    bright, places = patch.sign[corners[:, 0]] > 0, patch.position_px[corners]
    middle, rim = _ends(_rings(frame, np.einsum("rak,nkc->nrac", _WEIGHTS[_OUTER_AND_INNER], places)))
    both = 0 < np.count_nonzero(bright) < len(bright)
    contrast = max(float(np.median(rim[bright]) - np.median(rim[~bright])), 1e-6) if both else np.inf
    return np.array(cells), bright, np.where(bright, rim - middle, middle - rim) / contrast, places


def _disc_squares(
    frame: NDArray[Any], patch: Patch, _: Chessboard
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Squares (N, 2) of a patch with a disc, whether the square is bright (N,), disc diameter in squares (N,)."""
    cells, bright, share, places = _squares(frame, patch)
    disc = share > DISC
    points = np.einsum("rak,nkc->nrac", _WEIGHTS, places[disc])  # few of many squares
    return cells[disc], bright[disc], _diameters(_rings(frame, points))


def _large_dots(
    frame: NDArray[Any], patch: Patch, board: Chessboard
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Large dots (N, 2) of a patch, their shade (N,), which is one, diameter in pitches (N,)."""
    assert board.dots is not None
    diameter = dot_diameters(frame, patch, board)
    chosen = diameter > 0.5 * (board.dots.dot_mm + board.disc_mm) / board.square_mm
    return patch.index[chosen], np.zeros(np.count_nonzero(chosen), bool), diameter[chosen]


def _marks_between(
    frame: NDArray[Any], patch: Patch, board: Chessboard
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Squares (N, 2) of a patch with a mark in their middle, one shade (N,), how like triangles they are (N,)."""
    assert board.dots is not None
    place, _holes = _with_holes(patch)
    place |= _cut_by_frame(place, patch, frame.shape, 0.5 * board.dots.dot_mm / board.square_mm)
    cells = [(i, j) for i, j in place if all((i + a, j + b) in place for a, b in AROUND_SQUARE)]
    dots = np.array([[place[i + a, j + b] for a, b in AROUND_SQUARE] for i, j in cells]).reshape(-1, 4, 2)
    # Two opposite corners are of the row of the mark, and on its level, where rows are staggered.
    middle = [dots[:, first::2].mean(axis=1) for first in (0, 1)]
    near = _cells_alike(cells, dots.mean(axis=1))
    share = np.stack([_share_of_row(frame, patch, dots, near, first) for first in (0, 1)])
    marked = share.max(axis=0) > PRESENT
    chosen = np.array(cells, np.int64).reshape(-1, 2)[marked]
    at = np.where((share[0] > share[1])[:, None], *middle)
    if board.dots.triangle is None:
        return chosen, np.zeros(len(chosen), bool), np.zeros(len(chosen))
    shape = [_triangularity(frame, at[near[n]], dots[near[n]], board.dots) for n in np.flatnonzero(marked)]
    return chosen, np.zeros(len(chosen), bool), np.array(shape)


def _cells_alike(cells: list[Square], middle_px: NDArray[np.float64]) -> NDArray[np.intp]:
    """Cells (N, CELLS_ALIKE) on the level of each, or fewer: itself first, then the nearest ones to it."""
    odd = np.array(cells, np.int64).reshape(-1, 2).sum(axis=1) % 2
    count = max(min(CELLS_ALIKE, *np.bincount(odd, minlength=2).tolist()), 1)
    near = np.repeat(np.arange(len(cells))[:, None], count, axis=1)
    for own in (np.flatnonzero(odd == 0), np.flatnonzero(odd)):
        if len(own) > 1:
            found = scipy.spatial.cKDTree(middle_px[own]).query(middle_px[own], k=count)[1]
            near[own] = own[found.reshape(len(own), count)]
    return near


def _with_triangle(
    fits: list[tuple[Placing, list[int]]],
    shape: NDArray[np.float64],
    board: Chessboard,
    turn: NDArray[np.int64] | None,
) -> list[tuple[Placing, list[int]]]:
    """Fits whose triangle is one; where light or blur hide its shape, those of the `turn` to expect."""
    assert board.dots is not None
    own = [square == board.dots.triangle for square in board.discs]
    clear, open_ = [], []
    for fit in fits:
        values = shape[fit[1]]
        triangle, other = float(values[own].max()), float(values[~np.array(own)].max(initial=0.0))
        if triangle > max(TRIANGULAR, CLEARLY_MORE * other):
            clear.append(fit)
        elif other <= max(TRIANGULAR, CLEARLY_MORE * triangle):
            open_.append(fit)
    if clear or not open_ or turn is None:
        return clear
    return [fit for fit in open_ if np.array_equal(fit[0].turn, turn)]


def _triangularity(
    frame: NDArray[Any], at_px: NDArray[np.float64], around_px: NDArray[np.float64], dots: Dots
) -> float:
    """Return how much like a triangle the first of some marks (M, 2), amid four dots (M, 4, 2) in turn, is.

    |<z^3>| / <|z|^2>^(3/2), z the complex place within the mark, is 0.8 of a triangle, 0 of a square or a disc.
    Walls and shadows are there beside the others too, and are taken off.
    """
    first, second, third, fourth = np.moveaxis(around_px, 1, 0)
    axes = 0.5 * np.stack((second - first + third - fourth, fourth - first + third - second), axis=-1)
    beside = np.linalg.solve(axes[0], (around_px[0] - at_px[0]).T).T  # squares; dots of a plate lie elsewhere
    away = np.linalg.norm(_GRID[:, None] - beside, axis=-1).min(axis=1)
    within = _GRID[(away > CLEAR_OF_DOTS) & (np.hypot(*_GRID.T) <= WIDEST_MARK)]
    light = _rings(frame, (at_px[:, None] + np.einsum("nij,kj->nki", axes, within))[:, :, None]).astype(np.float64)
    light /= np.maximum(np.median(light, axis=1, keepdims=True), 1e-9)  # most within is ground
    light = light[0] - np.median(light[1:], axis=0) if len(light) > 2 else light[0]
    light = light if dots.bright else -light
    ground, mark = np.percentile(light, (50.0, 95.0))
    weight = np.clip((light - ground) / max(float(mark - ground), 1e-9) - MARK_EDGE, 0.0, MARK_EDGE) + 1e-9
    z = within @ np.array((1.0, 1.0j))
    z = z - np.average(z, weights=weight)
    spread = float(np.average(np.abs(z) ** 2, weights=weight))
    return float(np.abs(np.average(z**3, weights=weight)) / spread**1.5)


def _missing_dots(
    frame: NDArray[Any], patch: Patch, _: Chessboard
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]:
    """Places (N, 2) in a patch at which a dot is left out, their shade (N,), which is one, no diameter (N,)."""
    place, holes = _with_holes(patch)
    holes = [(i, j) for i, j in holes if all((i + a, j + b) in place for a, b in AROUND_DOT)]
    dots = np.array([[place[i + a, j + b] for a, b in AROUND_DOT] for i, j in holes]).reshape(-1, 4, 2)
    middle = np.array([place[hole] for hole in holes]).reshape(-1, 2)
    chosen = np.array(holes, np.int64).reshape(-1, 2)[_share_of_dots(frame, patch, middle, dots) < PRESENT]
    return chosen, np.zeros(len(chosen), bool), np.zeros(len(chosen))


def _with_holes(patch: Patch) -> tuple[dict[Square, NDArray[np.float64]], list[Square]]:
    """Places [px] of a patch by index, and of its holes; and these, which have two neighbours along a diagonal.

    Those are on the level of what stands between them, if the patch is that of a plate.
    """
    place = {(i, j): patch.position_px[n] for n, (i, j) in enumerate(patch.index.tolist())}
    beside = {(i + a, j + b) for i, j in place for a, b in AROUND_DOT} - place.keys()
    holes: dict[Square, NDArray[np.float64]] = {}
    for i, j in sorted(beside):
        ends = [((i + a, j + b), (i - a, j - b)) for a, b in ((1, 1), (1, -1))]
        there = [0.5 * (place[one] + place[other]) for one, other in ends if one in place and other in place]
        if there:
            holes[i, j] = np.mean(there, axis=0)
    return place | holes, list(holes)


def _cut_by_frame(
    place: dict[Square, NDArray[np.float64]], patch: Patch, shape: tuple[int, ...], radius: float
) -> dict[Square, NDArray[np.float64]]:
    """Places [px] of the next dots beyond a patch that the border of the frame cuts; `radius` of a dot in squares.

    They go on from two dots along a diagonal, which are on their level.
    """
    edge, found = radius * float(np.median(np.linalg.norm(patch.axes_px, axis=1))), {}
    low, high = np.full(2, edge), np.array((shape[1], shape[0])) - 1.0 - edge
    for (i, j), own in place.items():
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            if (i - a, j - b) not in place and (i + a, j + b) in place:
                beyond = 2.0 * own - place[i + a, j + b]
                if (beyond < low).any() or (beyond > high).any():
                    found[i - a, j - b] = beyond
    return found


def _share_of_row(
    frame: NDArray[Any], patch: Patch, dots: NDArray[np.float64], near: NDArray[np.intp], first: int
) -> NDArray[np.float64]:
    """Level (N,) amid four dots (N, 4, 2), 0 of the ground and 1 of both dots `first`, `first` + 2; 0 of no mark.

    Ground is asked between these two: light and shadow of the other level do not reach there, and where they do,
    they are amid most of the cells `near` (N, M) as well.  What is brighter than both dots, or goes on across, as
    a rod before the plate does, is no mark.
    """
    one, other, left, right = np.moveaxis(np.roll(dots, -first, axis=1)[:, [0, 2, 1, 3]], 1, 0)
    at, along, across = 0.5 * (one + other), 0.25 * (other - one), 0.25 * (right - left)
    asked = np.stack((at, one, other, at - along, at + along, at - across, at + across), axis=1)
    value = _levels_at(frame, patch, asked)
    ends = asked[:, 1:3]  # of which the border of the frame may hide one
    seen = ((ends >= 0.0) & (ends <= np.array(frame.shape[::-1]) - 1.0)).all(axis=2)
    dot = np.average(value[:, 1:3], axis=1, weights=np.maximum(seen, 1e-6))
    ground = value[:, 3:5].mean(axis=1)
    share = (value - ground[:, None]) / np.where(dot == ground, np.inf, dot - ground)[:, None]
    share = share - np.median(share[near], axis=1)
    is_mark = (share[:, 0] < BRIGHTEST) & (share[:, 5:].min(axis=1) < PRESENT)
    return np.where(is_mark, share[:, 0], 0.0)


def _share_of_dots(
    frame: NDArray[Any], patch: Patch, middle: NDArray[np.float64], dots: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Level (N,) at some places (N, 2), 0 of the ground and 1 of the four dots (N, 4, 2) around each in turn."""
    between = 0.5 * (dots + np.roll(dots, 1, axis=1))
    value = _levels_at(frame, patch, np.concatenate((middle[:, None], dots, between), axis=1))
    dot, ground = value[:, 1:5].mean(axis=1), value[:, 5:].mean(axis=1)
    return np.asarray((value[:, 0] - ground) / np.where(dot == ground, np.inf, dot - ground))


def _levels_at(frame: NDArray[Any], patch: Patch, asked: NDArray[np.float64]) -> NDArray[np.float64]:
    """Levels (N, M) around places (N, M, 2), over about a tenth of a square."""
    size = float(np.median(np.linalg.norm(patch.axes_px, axis=1)))
    points = asked[:, None] + size * _AROUND[:_MIDDLE].reshape(-1, 1, 2)
    return _rings(frame, points.transpose(0, 2, 1, 3)).astype(np.float64)


_FIND = {"large": _large_dots, "between": _marks_between, "missing": _missing_dots}


def dot_diameters(frame: NDArray[Any], patch: Patch, board: Chessboard) -> NDArray[np.float64]:
    """Diameters (N,) of dots in pitches; TargetNotFound if the usual ones are of another size than described."""
    assert board.dots is not None
    within = WITHIN_ROW if board.dots.levels == "staggered" else 1.0
    points = patch.position_px[:, None, None] + np.einsum("rak,nck->nrac", within * _AROUND, patch.axes_px)
    diameter = within * _diameters(_rings(frame, points))
    usual = board.dots.dot_mm / board.square_mm
    seen = float(np.median(diameter))
    if abs(seen - usual) > RATIO_TOLERANCE * usual:
        raise TargetNotFound(
            f"the dots measure {seen:.2f} of the way from one to the next, those of the board described"
            f" {usual:.2f}; put the described board into the frame, or describe this one"
        )
    return diameter


_GRID = np.stack(np.meshgrid(*[np.linspace(-0.45, 0.45, 31)] * 2), axis=-1).reshape(-1, 2)  # around a mark
_RADII = np.linspace(0.02, 0.42, 21)  # squares
_ANGLES = np.arange(16) * (np.pi / 8.0) + 0.1
_AROUND = _RADII[:, None, None] * np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=-1)
_ACROSS, _UP = np.moveaxis(0.5 + _AROUND, -1, 0)
_WEIGHTS = np.stack(  # of the corners of a square
    ((1 - _ACROSS) * (1 - _UP), _ACROSS * (1 - _UP), (1 - _ACROSS) * _UP, _ACROSS * _UP), axis=-1
)


_MIDDLE, _RIM = 3, 2  # rings that say the level in the middle and at the border
_OUTER_AND_INNER = np.r_[:_MIDDLE, len(_RADII) - _RIM : len(_RADII)]


def _rings(frame: NDArray[Any], points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Mean levels (N, radii) of points (N, radii, angles, 2)."""
    values: NDArray[np.float32] = scipy.ndimage.map_coordinates(
        frame.astype(np.float32), [points[..., 1], points[..., 0]], order=1, mode="nearest"
    )
    return np.asarray(values.mean(axis=2))


def _ends(rings: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Levels (N,) in the middle and at the border, of the rings (N, radii) that say them at least."""
    return rings[:, :_MIDDLE].mean(axis=1), rings[:, -_RIM:].mean(axis=1)


def _diameters(rings: NDArray[np.float32]) -> NDArray[np.float64]:
    """Diameters in squares (N,): the profile from 1 in the middle to 0 at the border, integrated."""
    middle, rim = _ends(rings)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (rings - rim[:, None]) / (middle - rim)[:, None]
    return np.asarray(2.0 * (_RADII[0] + np.clip(inside, 0.0, 1.0).sum(axis=1) * (_RADII[1] - _RADII[0])))
