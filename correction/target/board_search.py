"""Find the target in a frame: every corner with its place on the board and its sub-pixel position.

    saddles -> patches of lattice -> origin from the discs -> sub-pixel fit -> corners the saddles missed

`find_board` needs no start: any turn, tilt, barrel distortion, board partly outside.  `track_board` also
takes a prediction, from a nominal camera say: it places patches in which no disc is seen (a board moved
aside, glass above the discs) as long as the prediction is good to half a square somewhere, and uses the
discs, where they are seen, if it is worse.  Where it may be worse and no disc is seen, or the board has none, its
edges and the number of its squares must leave one place only (`board_count`).

Every corner of the placed patches is fitted to sub-pixel, then those that their neighbours predict and no saddle
showed, ring by ring.  Corners that do not lie on one smooth view with the others are seen through something
and are left out; too many of them, and the frame is refused.

Seen through air, board and image are joined by a smooth map: a polynomial of order 5 follows any tilt and
any usable lens to a fraction of a pixel.  Corners seen through something that bends the view (glass left in
front of the target, a mirror) may be linked to the bare lattice at a rim and would be counted on with
indices that look right.  They do not lie on the smooth map of the others, and that shows them.

Dots of a plate's other level lie beside that map by another smooth one, of order 2.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_count import place_by_count
from correction.target.board_origin import Placing, place_by_discs, place_by_prediction
from correction.target.chessboard import Chessboard
from correction.target.codes import Marker, place_by_codes, read_markers, square_px
from correction.target.corners import CornerSearch, saturated_fraction
from correction.target.lattice_growth import (
    STEPS,
    Patch,
    grow_patches,
    lattice_axes,
)
from correction.target.marks import find_marks, refine_marks
from correction.target.size_seen import CLEARLY_OFF, size_seen
from piv.errors import FrameError
from piv.resampling.sample import checked_frame

ORDER, LEVEL_ORDER = 5, 2  # of the map, and of what lies between both levels of a plate
LARGEST_SQUARES = 0.35  # from the smooth map, at most
SMALLEST_SQUARES = 0.03  # nothing is judged more finely than this
LEAST_OTHERS = 0.02  # of what says where a corner should be, that comes from others
TIMES_MEDIAN = 12.0  # of all deviations: between, the limit follows how well the map fits
APART_SQUARES = 0.3  # from where the largest piece says, at most
TORN_SQUARES = 0.1  # that neighbours may lie beside where the axes of both have them
KNEE_SQUARES, NARROWER = 0.15, 0.85  # deviations beyond weigh little; the same of each round of the second half
ROUNDS = 25
LEAST_BOARD = 12  # corners: the six squares around the discs and a little more
MOST_FOREIGN = 0.2  # of the corners may lie off the smooth view of the others
EXTENSIONS = 2  # rings of corners added around those found
Predict = Callable[[NDArray[np.float64]], NDArray[np.float64]]
NEAR_DISCS = 6  # squares around the origin in which the view and its prediction are compared
SCALES = 0.7, 1.4  # of the view near the discs against its prediction: a ball shows them twice as large, or turned
SATURATED = 0.02  # fraction of pixels at full scale from which edges are displaced
FAR_SQUARES = 512  # half side of the largest board looked at


def on_smooth_map(
    index: NDArray[np.int64],
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    deep: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Corners (N,) that lie on one smooth map with the majority.

    Parameters
    ----------
    index : (N, 2) int
        Lattice indices.
    position_px : (N, 2) float
    axes_px : (N, 2, 2) float
        Image displacement by one square along each index.
    deep : (N,) bool, optional
        Which are on the other level of a plate.

    Notes
    -----
    Iteratively reweighted least squares with Cauchy weights squared, from a plane up to order 5 (less for few
    corners), so that a minority of foreign corners does not drag the map along.  Each is judged by what the others
    say without it: its deviation over 1 - h, with h the share of its own word in its place on the map, so that one
    at the end of the lattice does not bend the map to itself.
    """
    if not len(index):  # a frame in which nothing of the board was found
        return np.zeros(0, dtype=bool)
    size = max(float(np.ptp(index, axis=0).max()), 1.0)
    x, y = (2.0 * (index - index.mean(axis=0)) / size).T
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    across, down = np.vander(x, ORDER + 1, increasing=True).T, np.vander(y, ORDER + 1, increasing=True).T
    weight = np.ones(len(index))
    off = np.zeros(len(index))
    order, terms = 0, np.empty((len(index), 0))
    for round_ in range(ROUNDS):
        wanted = min(1 + round_ // 3, ORDER)
        powers = [(k, m) for k in range(wanted + 1) for m in range(wanted + 1 - k)]
        if 3 * len(powers) > len(index):
            break
        if wanted != order:
            order, terms = wanted, np.stack([across[k] * down[m] for k, m in powers], axis=-1)
            if deep is not None:
                beside = [across[k] * down[m] * deep for k, m in powers if k + m <= LEVEL_ORDER]
                terms = np.column_stack((terms, *beside))
        weighted = terms * weight[:, None] ** 2
        normal = weighted.T @ terms  # condition 1e3: fine squared; singular where all corners lie on few lines
        solution = np.linalg.lstsq(normal, weighted.T @ position_px, rcond=None)[0]
        own = np.sum(weighted * (terms @ np.linalg.pinv(normal)), axis=1)
        off = np.hypot(*(position_px - terms @ solution).T) / side / np.maximum(1.0 - own, LEAST_OTHERS)
        narrower = NARROWER ** max(0, round_ - ROUNDS // 2)
        knee = max(KNEE_SQUARES * narrower, SMALLEST_SQUARES, float(np.median(off)))
        weight = 1.0 / (1.0 + (off / knee) ** 2)
    limit = min(max(TIMES_MEDIAN * float(np.median(off)), SMALLEST_SQUARES), LARGEST_SQUARES)
    return np.asarray(off <= limit, dtype=bool)


def as_the_largest_piece_says(
    index: NDArray[np.int64],
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    deep: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Corners (N,) of the largest piece of lattice, and of those pieces apart that lie where it has them.

    Pieces apart are few corners at the end of a polynomial, or in a hole of it, which follows them wherever they
    lie: a view through a ball beside the board, or before it, passes for a part of it.  So they are judged by what
    the largest says without them, the more strictly the better it can: within it to SMALLEST_SQUARES, and far from
    it by as much more as its own word is worth less there.  Corners side by side that are not a square apart, by
    the axes of both, are of two pieces.

    Parameters
    ----------
    index, position_px, axes_px, deep
        As in `on_smooth_map`.
    """
    number = {(i, j): n for n, (i, j) in enumerate(index.tolist())}
    pairs = [
        (n, number[i + di, j + dj])
        for (i, j), n in number.items()
        for di, dj in ((1, 0), (0, 1))
        if (i + di, j + dj) in number
    ]
    count = len(index)
    start, end = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    along = np.where((index[end] - index[start])[:, None, 0] == 1, axes_px[start, :, 0], axes_px[start, :, 1])
    ahead = np.where((index[end] - index[start])[:, None, 0] == 1, axes_px[end, :, 0], axes_px[end, :, 1])
    miss = position_px[end] - position_px[start] - 0.5 * (along + ahead)
    holds = np.hypot(*miss.T) < TORN_SQUARES * np.hypot(*(0.5 * (along + ahead)).T)
    if deep is not None:  # levels of a plate lie beside each other by more
        holds |= deep[start] != deep[end]
    start, end = start[holds], end[holds]
    joined = scipy.sparse.coo_array((np.ones(len(start)), (start, end)), shape=(count, count))
    pieces, piece = scipy.sparse.csgraph.connected_components(joined, directed=False)
    if pieces < 2:  # usually
        return np.ones(count, dtype=bool)
    kept = np.asarray(piece == np.bincount(piece).argmax())
    x, y = ((index - index[kept].mean(axis=0)) / max(float(np.ptp(index[kept], axis=0).max()), 1.0)).T
    order = 3 if np.count_nonzero(kept) >= 30 else 2
    terms = np.stack([x**k * y**m for k in range(order + 1) for m in range(order + 1 - k)], axis=-1)
    if deep is not None:
        terms = np.column_stack((terms, deep, deep * x, deep * y))
    solution = np.linalg.lstsq(terms[kept], position_px[kept], rcond=None)[0]
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    worth = np.sum(terms * (terms @ np.linalg.pinv(terms[kept].T @ terms[kept])), axis=1)  # about p/n within it
    less = worth * np.count_nonzero(kept) / terms.shape[1]
    limit = np.minimum(SMALLEST_SQUARES * np.maximum(less, 1.0), APART_SQUARES)
    near = np.hypot(*(position_px - terms @ solution).T) < limit * side
    for other in range(pieces):
        kept |= (piece == other) & near[piece == other].all()
    return kept


def _deep(board: Chessboard, index: NDArray[np.int64]) -> NDArray[np.bool_] | None:
    """Marks (N,) on the other level of a plate; None of any other board."""
    return np.asarray(board.depth_mm(index) != 0.0) if len(board.depths_mm) > 1 else None


def _beside(
    board: Chessboard, index: NDArray[np.int64], position_px: NDArray[np.float64], at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """How far marks `at` (M, 2) are seen beside the lattice of the origin's level (M, 2) [px], by N known ones."""
    deep = _deep(board, index)
    if deep is None or not 0 < np.count_nonzero(deep) < len(deep):
        return np.zeros((len(at), 2))
    middle, size = index.mean(axis=0), max(float(np.ptp(index, axis=0).max()), 1.0)

    def terms(of: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        x, y = ((of - middle) / size).T
        linear = np.stack((np.ones(len(of)), x, y), axis=-1) * (board.depth_mm(of) != 0.0)[:, None]
        return linear, np.stack([x**k * y**m for k in range(4) for m in range(4 - k)], axis=-1)

    solution = np.linalg.lstsq(np.column_stack(terms(index)), position_px, rcond=None)[0]
    return np.asarray(terms(at)[0] @ solution[:3])


@dataclass(frozen=True)
class BoardDetection:
    """Corners of the target in a frame, N of them.

    Attributes
    ----------
    board : Chessboard
    index : (N, 2) int64
        Corner (i, j) of the board.
    position_px, sigma_px : (N, 2) float64
        u, v and their standard deviations.
    axes_px : (N, 2, 2) float64
        Columns: displacement in the image by one square along the board's +x and +y.
    blurs_px : (N, 2) float64
        Standard deviation of the spread of the edges along the board's +x and +y, pixel integration included.
    refused : dict
        Corners that were seen and not used: reason -> count.
    """

    board: Chessboard
    index: NDArray[np.int64]
    position_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    axes_px: NDArray[np.float64]
    blurs_px: NDArray[np.float64]
    refused: dict[str, int]

    @property
    def plane_mm(self) -> NDArray[np.float64]:
        """Positions (N, 2) of the corners on the board [mm]."""
        return self.board.corner_mm(self.index)

    def __len__(self) -> int:
        return len(self.index)


def measure_lattice(
    frame: NDArray[Any],
    board: Chessboard,
    placed: list[tuple[Patch, Placing]],
    mask: NDArray[np.bool_] | None,
    discs_count: bool,
) -> BoardDetection:
    """Sub-pixel fit of all placed corners, then of those that their neighbours predict.

    Parameters
    ----------
    frame : (H, W) array
        The checked frame.
    board : Chessboard
    placed : list of (Patch, Placing)
        Patches with their place on the board; of two claims to a corner the earlier patch wins.
    mask : (H, W) bool, optional
        True where pixels may be used.
    discs_count : bool
        The indices hang on the discs alone, so the corners around them must be part of the result.

    Raises
    ------
    TargetNotFound
        Too many corners lie off one smooth view, or too few could be fitted.
    """
    index, start, axes = _claims(placed, board)
    smooth = on_smooth_map(index, start, axes, _deep(board, index))
    foreign = int(np.count_nonzero(~smooth))
    if foreign > MOST_FOREIGN * len(index) or (discs_count and not _holds_discs(index[smooth], board)):
        raise TargetNotFound(
            f"{foreign} of {len(index)} corners do not lie on one smooth view of the board, as if seen through"
            " glass; take it away, or mask it and give a prediction of the view"
        )
    index, start, axes = index[smooth], start[smooth], axes[smooth]
    known_index, known_axes = np.empty((0, 2), np.int64), np.empty((0, 2, 2))
    position, sigma, blurs = np.empty((3, 0, 2))
    tried: set[tuple[int, int]] = set()
    refused: dict[str, int] | None = None
    for extension in range(1 + EXTENSIONS):
        fit = refine_marks(
            frame,
            board,
            index,
            start,
            axes,
            mask,
            search=CornerSearch(board.arm, 5.0 if extension else 0.5, max_shift=0.3),
        )
        refused = fit.counts() if refused is None else refused
        known_index = np.concatenate((known_index, index[fit.valid]))
        known_axes = np.concatenate((known_axes, axes[fit.valid]))
        position = np.concatenate((position, fit.position_px[fit.valid]))
        sigma = np.concatenate((sigma, fit.sigma_px[fit.valid]))
        blurs = np.concatenate((blurs, fit.blurs_px[fit.valid]))
        lattice_axes(known_index, position, known_axes, len(board.depths_mm) > 1)
        tried.update((int(i), int(j)) for i, j in index)
        flat = position - _beside(board, known_index, position, known_index)
        index, start, axes = _neighbours(known_index, flat, known_axes, tried)
        start = start + _beside(board, known_index, position, index)
        there = board.has_corner(index)
        index, start, axes = index[there], start[there], axes[there]
        if len(index) == 0:
            break
    refused = refused or {}
    deep = _deep(board, known_index)
    smooth = on_smooth_map(known_index, position, known_axes, deep)
    smooth[smooth] = as_the_largest_piece_says(
        known_index[smooth], position[smooth], known_axes[smooth], None if deep is None else deep[smooth]
    )
    foreign += int(np.count_nonzero(~smooth))
    known_index, known_axes = known_index[smooth], known_axes[smooth]
    position, sigma, blurs = position[smooth], sigma[smooth], blurs[smooth]
    if deep is not None and not _holds_discs(known_index, board):
        raise TargetNotFound(
            "the large dots of the plate do not lie on one smooth view with most others; take away what hides or"
            " bends the view around them"
        )
    if len(position) < LEAST_BOARD:
        raise TargetNotFound(f"only {len(position)} corners could be fitted ({refused}); check focus and light")
    refused = {reason: n for reason, n in refused.items() if reason != "OK"}
    if foreign:
        refused["FOREIGN"] = foreign
    return BoardDetection(board, known_index, position, sigma, known_axes, blurs, refused)


def _holds_discs(index: NDArray[np.int64], board: Chessboard) -> bool:
    """True if all four corners of every disc square, or all large dots, are among the corners (N, 2)."""
    have, size = {(int(i), int(j)) for i, j in index}, (0, 1) if board.dots is None else (0,)
    return all((i + a, j + b) in have for i, j in board.discs for a in size for b in size)


def _claims(
    placed: list[tuple[Patch, Placing]], board: Chessboard
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Board index, start and axes of all placed corners; of two claims to a corner the earlier patch wins."""
    index = np.concatenate([placing.board_index(patch.index) for patch, placing in placed])
    start = np.concatenate([patch.position_px for patch, _ in placed])
    axes = np.concatenate([placing.board_axes(patch.axes_px) for patch, placing in placed])
    _, first = np.unique(index, axis=0, return_index=True)
    first.sort()
    first = first[board.has_corner(index[first])]
    return index[first], start[first], axes[first]


def _neighbours(
    index: NDArray[np.int64], position: NDArray[np.float64], axes: NDArray[np.float64], tried: set[tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Untried corners next to known ones: index, mean of what their neighbours predict, mean axes."""
    claims: dict[tuple[int, int], list[int]] = {}
    for n, (i, j) in enumerate(index.tolist()):
        for di, dj in STEPS:
            if (i + di, j + dj) not in tried:
                claims.setdefault((i + di, j + dj), []).append(n)
    keys = np.array(list(claims), dtype=np.int64).reshape(-1, 2)
    start, mean_axes = np.empty((len(keys), 2)), np.empty((len(keys), 2, 2))
    for k, (key, by) in enumerate(zip(keys, claims.values(), strict=True)):
        step = (key - index[by]).astype(np.float64)
        start[k] = (position[by] + np.einsum("nck,nk->nc", axes[by], step)).mean(axis=0)
        mean_axes[k] = axes[by].mean(axis=0)
    return keys, start, mean_axes


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
    if board.is_plain:
        raise TargetNotFound("a plain board is found by its edges and a prediction of its view; give one")
    frame, patches, markers = _patches(image, board, mask)
    placed = place_by_codes(patches, markers)
    if placed:
        return measure_lattice(frame, board, placed, mask, discs_count=False)
    if board.codes is not None:
        raise TargetNotFound(_why_no_codes(markers))
    marked = _with_discs(frame, patches, board)
    if marked is not None:
        return measure_lattice(frame, board, [marked], mask, discs_count=True)
    raise TargetNotFound(
        f"a lattice of {len(patches[0].index)} corners is in the frame, but not the {len(board.discs)}"
        f" {board.origin_marks} that mark the origin; bring them into view, or give a prediction of the view"
    )


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
    frame, patches, markers = _patches(image, board, mask)
    index, predicted = corners_in_view(board, predict, (frame.shape[0], frame.shape[1]))
    if len(index) == 0:
        raise TargetNotFound("the prediction puts no corner of the board into the frame; check the nominal camera")
    placed = place_by_codes(patches, markers)
    marked = _with_discs(frame, patches, board) if board.discs else None
    if marked is not None and not _plausible(index, predicted, *marked):
        marked = None
    if board.codes is not None and not placed and reach is not None:
        raise TargetNotFound(_why_no_codes(markers))
    if board.dots is not None and marked is None and reach is not None:
        raise TargetNotFound(
            _why_another_size(patches[0], (index, predicted), board)
            or f"a grid of {len(patches[0].index)} dots is in the frame, but not the {len(board.discs)} large"
            " dots that mark the origin, whole and as large as the camera should see them; bring them into view,"
            " or correct pitch and camera"
        )
    if marked is None and not placed and (reach is not None or board.is_plain):
        try:
            board, place = place_by_count(frame, patches[0], board, (index, predicted), reach)
        except TargetNotFound as error:
            raise TargetNotFound(_why_another_size(patches[0], (index, predicted), board) or str(error)) from None
        marked = patches[0], place
    if marked is not None:
        placed = [marked]
    if placed:
        predicted = _corrected(index, predicted, *placed[0])
        patches = [patch for patch in patches if all(patch is not other for other, _ in placed)]
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
    markers = [] if board.codes is None else read_markers(frame, board)
    patches = grow_patches(find_marks(frame, board, mask, square_px(board, markers) if markers else None))
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
        patches = grow_patches(find_marks(frame, kind))
        if patches and len(patches[0].index) > max(seen, LEAST_BOARD):
            return f"the frame shows {words} in the board file, or show the board that it describes"
    return (
        f"no grid of dots in the frame (largest: {seen} dots, {LEAST_BOARD} are needed); check light, focus"
        " and that dots are at least 4 px wide and 8 px apart"
    )


def _why_no_codes(markers: list[Marker]) -> str:
    """Say why codes place nothing."""
    return (
        f"{len(markers)} markers of the board could be read, which are too few to say which squares are seen; use"
        " squares of 16 px or more, more light, or give the dictionary that it was printed with"
    )


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


def _why_another_size(patch: Patch, view: tuple[NDArray[np.int64], NDArray[np.float64]], board: Chessboard) -> str:
    """Say how much larger than told the board is, where a patch is so all over; "" where it is not."""
    size = size_seen(patch.position_px, patch.axes_px, view, board)
    return size.sentence if size is not None and size.differs(CLEARLY_OFF) else ""


def _why_not_placed(
    index: NDArray[np.int64], predicted: NDArray[np.float64], patch: Patch, board: Chessboard
) -> str:
    """Say why the largest patch lies on no predicted corners: squares of another size, or too far off."""
    return _why_another_size(patch, (index, predicted), board) or (
        f"the lattice in the frame lies more than half a square from its prediction and no"
        f" {board.origin_marks[:-1]} is seen; give a better start, or bring the {board.origin_marks} into view"
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
