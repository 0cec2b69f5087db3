"""From placed patches of lattice to measured corners.

Every corner of the patches is fitted to sub-pixel, then those that their neighbours predict and no saddle
showed, ring by ring.  Corners that do not lie on one smooth view with the others are seen through something
and are left out; too many of them, and the frame is refused.

Seen through air, board and image are joined by a smooth map: a polynomial of order 5 follows any tilt and
any usable lens to a fraction of a pixel.  Corners seen through something that bends the view (glass left in
front of the target, a mirror) may be linked to the bare lattice at a rim and would be counted on with
indices that look right.  They do not lie on the smooth map of the others, and that shows them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.errors import TargetNotFound
from correction.target.board_origin import Placing
from correction.target.chessboard import Chessboard
from correction.target.corners import CornerSearch, refine_corners
from correction.target.lattice_growth import STEPS, Patch, lattice_axes

ORDER = 5
LARGEST_SQUARES = 0.35  # from the smooth map, at most
SMALLEST_SQUARES = 0.03  # nothing is judged more finely than this
TIMES_MEDIAN = 12.0  # of all deviations: between, the limit follows how well the map fits
KNEE_SQUARES = 0.15  # deviations beyond weigh little
ROUNDS = 25
LEAST_BOARD = 12  # corners: the six squares around the discs and a little more
MOST_FOREIGN = 0.2  # of the corners may lie off the smooth view of the others
EXTENSIONS = 2  # rings of corners added around those found


def on_smooth_map(
    index: NDArray[np.int64], position_px: NDArray[np.float64], axes_px: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Corners (N,) that lie on one smooth map with the majority.

    Parameters
    ----------
    index : (N, 2) int
        Lattice indices.
    position_px : (N, 2) float
    axes_px : (N, 2, 2) float
        Image displacement by one square along each index.

    Notes
    -----
    Iteratively reweighted least squares with Cauchy weights squared, from a plane up to order 5 (less for few
    corners), so that a minority of foreign corners does not drag the map along.
    """
    if not len(index):  # a frame in which nothing of the board was found
        return np.zeros(0, dtype=bool)
    size = max(float(np.ptp(index, axis=0).max()), 1.0)
    x, y = (2.0 * (index - index.mean(axis=0)) / size).T
    side = np.hypot(axes_px[:, 0], axes_px[:, 1]).mean(axis=1)
    weight = np.ones(len(index))
    off = np.zeros(len(index))
    for round_ in range(ROUNDS):
        order = min(1 + round_ // 3, ORDER)
        powers = [(k, m) for k in range(order + 1) for m in range(order + 1 - k)]
        if 3 * len(powers) > len(index):
            break
        terms = np.stack([x**k * y**m for k, m in powers], axis=-1)
        weighted = terms * weight[:, None] ** 2
        solution = np.linalg.solve(weighted.T @ terms, weighted.T @ position_px)  # condition 1e3: fine squared
        off = np.hypot(*(position_px - terms @ solution).T) / side
        knee = max(KNEE_SQUARES, float(np.median(off)))
        weight = 1.0 / (1.0 + (off / knee) ** 2)
    limit = min(max(TIMES_MEDIAN * float(np.median(off)), SMALLEST_SQUARES), LARGEST_SQUARES)
    return np.asarray(off <= limit, dtype=bool)


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
    refused : dict
        Corners that were seen and not used: reason -> count.
    """

    board: Chessboard
    index: NDArray[np.int64]
    position_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    axes_px: NDArray[np.float64]
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
    index, start, axes = _claims(placed)
    smooth = on_smooth_map(index, start, axes)
    foreign = int(np.count_nonzero(~smooth))
    if foreign > MOST_FOREIGN * len(index) or (discs_count and not _holds_discs(index[smooth], board)):
        raise TargetNotFound(
            f"{foreign} of {len(index)} corners do not lie on one smooth view of the board, as if seen through"
            " glass; take it away, or mask it and give a prediction of the view"
        )
    index, start, axes = index[smooth], start[smooth], axes[smooth]
    known_index, known_axes = np.empty((0, 2), np.int64), np.empty((0, 2, 2))
    position, sigma = np.empty((0, 2)), np.empty((0, 2))
    tried: set[tuple[int, int]] = set()
    refused: dict[str, int] | None = None
    for extension in range(1 + EXTENSIONS):
        fit = refine_corners(
            frame,
            start,
            axes,
            sign=board.corner_sign(index),
            mask=mask,
            search=CornerSearch(start_error_px=5.0 if extension else 0.5, max_shift=0.3),
        )
        refused = fit.counts() if refused is None else refused
        known_index = np.concatenate((known_index, index[fit.valid]))
        known_axes = np.concatenate((known_axes, axes[fit.valid]))
        position = np.concatenate((position, fit.position_px[fit.valid]))
        sigma = np.concatenate((sigma, fit.sigma_px[fit.valid]))
        lattice_axes(known_index, position, known_axes)
        tried.update((int(i), int(j)) for i, j in index)
        index, start, axes = _neighbours(known_index, position, known_axes, tried)
        if len(index) == 0:
            break
    refused = refused or {}
    smooth = on_smooth_map(known_index, position, known_axes)
    foreign += int(np.count_nonzero(~smooth))
    known_index, known_axes, position, sigma = (
        known_index[smooth],
        known_axes[smooth],
        position[smooth],
        sigma[smooth],
    )
    if len(position) < LEAST_BOARD:
        raise TargetNotFound(f"only {len(position)} corners could be fitted ({refused}); check focus and light")
    refused = {reason: n for reason, n in refused.items() if reason != "OK"}
    if foreign:
        refused["FOREIGN"] = foreign
    return BoardDetection(board, known_index, position, sigma, known_axes, refused)


def _holds_discs(index: NDArray[np.int64], board: Chessboard) -> bool:
    """True if all four corners of every disc square are among the corners (N, 2)."""
    have = {(int(i), int(j)) for i, j in index}
    return all((i + a, j + b) in have for i, j in board.discs for a in (0, 1) for b in (0, 1))


def _claims(
    placed: list[tuple[Patch, Placing]],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Board index, start and axes of all placed corners; of two claims to a corner the earlier patch wins."""
    index = np.concatenate([placing.board_index(patch.index) for patch, placing in placed])
    start = np.concatenate([patch.position_px for patch, _ in placed])
    axes = np.concatenate([placing.board_axes(patch.axes_px) for patch, placing in placed])
    _, first = np.unique(index, axis=0, return_index=True)
    first.sort()
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
