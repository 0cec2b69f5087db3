"""Lattices placed on the board, fitted to sub-pixel: their corners, and the neighbours that no saddle showed.

Every corner of the placed patches is fitted, then those that their neighbours predict, ring by ring.  Corners that
do not lie on one smooth view with the others (`smooth_view`) are seen through something and are left out; too many
of them, and the frame is refused.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_origin import Placing
from correction.target.chessboard import QUARTER_TURNS, Chessboard
from correction.target.corners import CornerSearch
from correction.target.evidence import contradiction, wrong_size
from correction.target.lattice_growth import LEAST_BOARD, STEPS, Patch, lattice_axes
from correction.target.marks import refine_marks
from correction.target.scale_search import crossing_corners
from correction.target.smooth_view import as_the_largest_piece_says, on_smooth_map

MOST_FOREIGN = 0.2  # of the corners may lie off the smooth view of the others
MISFIT_TIMES, LEAST_MISFIT = 5.0, 0.05  # of the median residual of all corners; of the half contrast, at least
UNSURE_TIMES, LEAST_UNSURE_PX = (
    6.0,
    0.1,
)  # of the median sigma, at least: edges of covers are none of squares
EXTENSIONS = 2  # rings of corners added around those found


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
    origin_basis : str
        What the origin rests on, if no mark shows it.
    """

    board: Chessboard
    index: NDArray[np.int64]
    position_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    axes_px: NDArray[np.float64]
    blurs_px: NDArray[np.float64]
    refused: dict[str, int]
    origin_basis: str = ""

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
    discs_count: bool = False,
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
        Too many corners lie off one smooth view, too few could be fitted, or shades or edges of squares contradict
        their place.
    """
    reason = contradiction(board, *placed[0])
    if reason:
        raise TargetNotFound(reason)
    index, start, axes = _claims(placed, board)
    error_px = max(patch.error_px for patch, _ in placed)
    smooth = on_smooth_map(index, start, axes, _deep(board, index))
    foreign = int(np.count_nonzero(~smooth))
    if foreign > MOST_FOREIGN * len(index) or (discs_count and not holds_discs(index[smooth], board)):
        if foreign == 0:
            raise TargetNotFound(
                f"one of the {board.origin_marks} stands at the border of the frame with too few marks around it;"
                " move the camera, or give a prediction of the view"
            )
        raise TargetNotFound(
            f"{foreign} of {len(index)} corners do not lie on one smooth view of the board, as if seen through"
            " glass; take it away, or mask it and give a prediction of the view"
        )
    index, start, axes = index[smooth], start[smooth], axes[smooth]
    known_index, known_axes = np.empty((0, 2), np.int64), np.empty((0, 2, 2))
    position, sigma, blurs = np.empty((3, 0, 2))
    tried: set[tuple[int, int]] = set()
    refused: dict[str, int] | None = None
    misfit = unsure_px = np.inf
    for extension in range(1 + EXTENSIONS):
        fit = refine_marks(
            frame,
            board,
            index,
            start,
            axes,
            mask,
            search=CornerSearch(board.arm, 5.0 if extension else error_px, max_shift=0.3),
        )
        refused = fit.counts() if refused is None else refused
        valid = fit.valid
        if board.dots is None:  # an edge of what covers a square passes for one of the square
            valid = valid & crossing_corners(frame, board, fit.position_px, axes, board.corner_sign(index))
            if valid.any():
                misfit = min(misfit, max(MISFIT_TIMES * float(np.median(fit.residual[valid])), LEAST_MISFIT))
                usual_px = float(np.median(fit.sigma_px[valid]))
                unsure_px = min(unsure_px, max(UNSURE_TIMES * usual_px, LEAST_UNSURE_PX))
            valid &= (fit.residual <= misfit) & (fit.sigma_px.max(axis=1) <= unsure_px)
        known_index = np.concatenate((known_index, index[valid]))
        known_axes = np.concatenate((known_axes, axes[valid]))
        position = np.concatenate((position, fit.position_px[valid]))
        sigma = np.concatenate((sigma, fit.sigma_px[valid]))
        blurs = np.concatenate((blurs, fit.blurs_px[valid]))
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
    if deep is not None and board.has_large_dots and not holds_discs(known_index, board):
        raise TargetNotFound(
            "the large dots of the plate do not lie on one smooth view with most others; take away what hides or"
            " bends the view around them"
        )
    if len(position) < LEAST_BOARD:
        others = ", ".join(f"{count} {reason.lower()}" for reason, count in refused.items() if reason != "OK")
        raise TargetNotFound(
            f"only {len(position)} corners could be fitted ({others or 'no others'}); check focus, light and the"
            " description of the board"
        )
    refused = {reason: n for reason, n in refused.items() if reason != "OK"}
    if foreign:
        refused["FOREIGN"] = foreign
    # A plain board was placed by its ends already.
    patch = Patch(known_index, position, known_axes, board.corner_sign(known_index))
    reason = "" if board.is_plain else wrong_size(frame, board, patch, Placing(QUARTER_TURNS[0], (0, 0)))
    if reason:
        raise TargetNotFound(reason)
    return BoardDetection(board, known_index, position, sigma, known_axes, blurs, refused)


def holds_discs(index: NDArray[np.int64], board: Chessboard) -> bool:
    """True if all four corners of every disc square, all large dots, or three around each other mark are there."""
    have = {(int(i), int(j)) for i, j in index}
    around: tuple[tuple[int, int], ...] = ((0, 0), (1, 0), (0, 1), (1, 1))
    if board.dots is not None and board.dots.marks != "between":
        around = ((0, 0),) if board.has_large_dots else STEPS
    least = len(around) if board.dots is None or board.has_large_dots else len(around) - 1
    return all(sum((i + a, j + b) in have for a, b in around) >= least for i, j in board.discs)


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


def _deep(board: Chessboard, index: NDArray[np.int64]) -> NDArray[np.bool_] | None:
    """Marks (N,) on the other level of a plate; None of any other board."""
    return np.asarray(board.depth_mm(index) != 0.0) if len(board.depths_mm) > 1 else None


def _beside(
    board: Chessboard, index: NDArray[np.int64], position_px: NDArray[np.float64], at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Offset (M, 2) [px] of marks `at` (M, 2) from the lattice of the origin's level, by N known ones."""
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
