"""Ends of a board in a frame: a plain chessboard has no other mark, and one of its corners is as good as one.

The frame is sampled in the middle of squares, on past a patch of lattice by the smooth map of its corners.
Along a column of squares each differs from the two beside it by the full contrast, the way a chessboard has it;
walked outwards, that stops somewhere.  The board ends at a line of the lattice where

* at least MIN_END_COLUMNS columns stop and none goes on,
* dark squares end at the line itself, to ON_LINE of a square, side by side to STRAIGHT of one, and
* past it there is paper: as bright as bright squares.

A shadow, a hand or the edge of the frame stops columns too, but not side by side at one line with paper beyond;
a sheet of paper that hides a part of the board does not lie along a line of its lattice.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.chessboard import QUARTER_TURNS
from correction.target.lattice_growth import Patch

ORDER = 4  # of the map from lattice to frame
SQUARES_AROUND = 3  # squares around the patch that are looked at
MIN_END_COLUMNS = 4  # columns that must stop alike
MIN_END_SHARE = 0.8  # share of them that must show board before the line, and paper past it
GOES_ON = 0.5  # of its contrast that a column keeps from square to square
SAME_SHADE = 0.35  # of the contrast: shades so near to each other are the same
FEWEST_DARK = 3  # dark squares among them, which have an edge to paper
ON_LINE, STRAIGHT = 0.07, 0.03  # squares that such edges may lie beside the line, and beside each other
AWAY = np.linspace(-0.45, 0.45, 19)  # squares from the line, where its edge is looked for
SPOTS = 0.1 * np.array([(-1.0, -1.0), (-1.0, 1.0), (0.0, 0.0), (1.0, -1.0), (1.0, 1.0)])  # of a square, sampled
Shade = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Seen = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]  # of spots around places


@dataclass(frozen=True)
class Ends:
    """Lines of a patch's lattice at which the board ends, outer edges of its outer squares; None where not seen.

    Parameters
    ----------
    low, high : (int or None, int or None)
        Along i and along j.
    """

    low: tuple[int | None, int | None]
    high: tuple[int | None, int | None]

    def ends_along(self, turn: NDArray[np.int64]) -> list[tuple[int | None, int | None]]:
        """Lower and higher end along x and y, where relative = turn @ board but for a shift."""
        found: list[tuple[int | None, int | None]] = []
        for column in turn.T:
            axis = int(np.flatnonzero(column)[0])
            pair = self.low[axis], self.high[axis]
            if column[axis] > 0:
                found.append(pair)
            else:
                first, last = (None if line is None else -line for line in reversed(pair))
                found.append((first, last))
        return found


def ends_of(frame: NDArray[Any], patch: Patch, marker_share: float = 0.0) -> Ends:
    """Find the ends of the board around a patch of its lattice.

    Parameters
    ----------
    frame : (H, W) array
        The checked frame.
    patch : Patch
        Corners of the board; a few that are none do no harm.
    marker_share : float
        Side of markers in bright squares, which are sampled between these and their edges.
    """
    aside = 0.25 + 0.25 * marker_share
    spots = aside * np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)]) if marker_share else SPOTS
    shade = _shade_of(frame, patch)
    found: dict[tuple[int, int], int | None] = {}
    for rows in QUARTER_TURNS:  # the lattice is turned until the end that is looked for is the upper one
        turn = np.array(rows)
        back = np.linalg.inv(turn).round()
        towards_x, towards_y = (back @ (0.0, 1.0)).astype(int).tolist()
        corners = patch.index @ turn.T

        def turn_back(
            places: NDArray[np.float64], around: NDArray[np.float64], back: NDArray[np.float64] = back
        ) -> NDArray[np.float64]:
            return shade(places @ back.T, around)

        line = _upper_end(corners, _brightness(patch, back), turn_back, spots)
        found[towards_x, towards_y] = None if line is None else line * (towards_x + towards_y)
    return Ends((found[-1, 0], found[0, -1]), (found[1, 0], found[0, 1]))


def _shade_of(frame: NDArray[Any], patch: Patch) -> Seen:
    """Mean of the frame at spots (K, 2) around places (..., 2) of the lattice; NaN out of the frame."""
    centre, size = patch.index.mean(axis=0), max(1.0, 0.5 * float(np.ptp(patch.index, axis=0).max()))
    order = max(k for k in range(1, ORDER + 1) if k == 1 or 3 * (k + 1) * (k + 2) // 2 <= len(patch.index))
    powers = [(k, m) for k in range(order + 1) for m in range(order + 1 - k)]

    def terms(places: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = np.moveaxis((places - centre) / size, -1, 0)
        return np.stack([x**k * y**m for k, m in powers], axis=-1)

    solution = np.linalg.lstsq(terms(patch.index.astype(np.float64)), patch.position_px, rcond=None)[0]
    light = frame.astype(np.float32)

    def shade(places: NDArray[np.float64], spots: NDArray[np.float64]) -> NDArray[np.float64]:
        pixel = terms(places[..., None, :] + spots) @ solution
        value = scipy.ndimage.map_coordinates(
            light, [pixel[..., 1], pixel[..., 0]], order=1, mode="constant", cval=np.nan
        )
        return np.asarray(value.mean(axis=-1), dtype=np.float64)

    return shade


def _brightness(patch: Patch, back: NDArray[np.float64]) -> Shade:
    """Expected brightness of squares with their middles at turned places (..., 2): +1 or -1."""
    even = 1.0 if np.sum(np.where(patch.index.sum(axis=1) % 2 == 0, patch.sign, -patch.sign)) >= 0 else -1.0

    def bright(places: NDArray[np.float64]) -> NDArray[np.float64]:
        square = np.floor(places @ back.T)
        return np.where(square.sum(axis=-1) % 2 == 0, even, -even)

    return bright


def _upper_end(
    corners: NDArray[np.int64], brightness: Shade, shade: Seen, spots: NDArray[np.float64]
) -> int | None:
    """Line at which the board ends at the top, or None.

    Parameters
    ----------
    corners : (N, 2) int64
        Of the patch, column and row.
    brightness, shade : callable
        Of middles of squares: what should be seen, and what is.
    spots : (K, 2) float64
        Around the middle of a square, where it is sampled.
    """
    low, high = corners.min(axis=0) - 1, corners.max(axis=0) + SQUARES_AROUND
    columns, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])
    middle = np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1) + 0.5
    bright, seen = brightness(middle), shade(middle, spots)
    beside = np.full_like(seen, np.nan)
    beside[1:-1] = 0.5 * (seen[:-2] + seen[2:])
    swing = bright * (seen - beside)  # the contrast, within the board
    stop = _stops(corners - low, swing)
    if not (stop >= 0).any():
        return None
    line = int(stop.max())
    chosen = np.flatnonzero(stop == line)
    if len(chosen) < MIN_END_COLUMNS:
        return None
    last = line - 1
    dark = bright[chosen, last] < 0.0
    contrast, own = swing[chosen, last], seen[chosen, last]
    paper = np.where(dark, beside[chosen, last], own)
    across = np.broadcast_to((columns[chosen] + 0.5)[:, None], (len(chosen), len(AWAY)))
    profile = shade(np.stack((across, rows[0] + line + np.broadcast_to(AWAY, across.shape)), axis=-1), SPOTS)
    with np.errstate(invalid="ignore", divide="ignore"):  # False out of the frame
        ends = np.abs(profile[:, -1] - paper) < SAME_SHADE * contrast
        if spots is not SPOTS:  # beside a marker paper looks darker than it is
            paper = np.where(ends, profile[:, -1], paper)
        share = (profile - own[:, None]) / (paper - own)[:, None]
        edge = AWAY[0] + np.trapezoid(1.0 - share, AWAY, axis=1)  # of an edge from 0 to 1
        place = float(np.median(edge[dark & ends])) if (dark & ends).any() else np.inf
        straight = np.abs(edge - place) < STRAIGHT
    surely = (
        abs(place) < ON_LINE and ends.mean() >= MIN_END_SHARE and np.mean((ends & straight)[dark]) >= MIN_END_SHARE
    )
    return int(rows[0]) + line if surely and np.count_nonzero(ends & straight & dark) >= FEWEST_DARK else None


def _stops(corners: NDArray[np.int64], swing: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows (C,) at which columns are board no more; -1 where nothing of a column is in the patch.

    Parameters
    ----------
    corners : (N, 2) int64
        Column and row of those in the patch.
    swing : (C, R) float64
        Contrast of squares with those beside them, as a chessboard has it.
    """
    there = np.zeros(swing.shape, bool)
    there[corners[:, 0], corners[:, 1]] = True
    whole = np.zeros(swing.shape, bool)
    whole[:-1, :-1] = there[:-1, :-1] & there[1:, :-1] & there[:-1, 1:] & there[1:, 1:]
    stop = np.full(len(swing), -1)
    for column in np.flatnonzero(whole.any(axis=1)).tolist():
        rows = np.flatnonzero(whole[column])
        known = swing[column, rows[-4:]]
        own = float(np.median(known[np.isfinite(known)])) if np.isfinite(known).any() else 0.0
        if not own > 0.0:
            continue
        row = int(rows[-1])
        while row > 0 and not swing[column, row] > GOES_ON * own:
            row -= 1  # corners on the outer line are taken for corners of the lattice
        while row < swing.shape[1] and swing[column, row] > GOES_ON * own:
            row += 1
        stop[column] = row
    return stop
