"""The calibration target: a chessboard (`tracer.board`) whose discs mark its origin.

Corner (i, j) is the point (i a, j b), a and b the sides of a square on paper: the lower left corner of square
(i, j) as the camera sees it upright.
The pattern of the discs looks different after every quarter turn, so it fixes both the origin and the orientation;
it cannot tell a mirror image, which no camera shows of a board in air.

A grid of dots is the same with a dot at each corner; its discs are the dots that are larger, or other marks.  Dots
of a plate stand on two levels: that of the origin, which is the plane of the target, and one behind it, or before
it.  Staggered rows are a lattice turned by 45 degrees: every index is one of its steps, whichever way they lead.

Around a corner two edges cross.  What a fit may look at is a cross of arms along them: the arms end before
the next corner (1 square away) and are thinner than the distance from an edge to a disc.
"""

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from correction.errors import BoardError
from correction.masked import points_in
from tracer.board import Board, Dots, Square

LEAST_SQUARES = 4
DISC_ARM = 0.15  # squares: clear of discs of up to 0.6 of one, and of their blur
WIDEST_MARKER = 0.8  # squares
SMALLEST_DOT, WIDEST_DOT = 0.15, 0.75  # pitches: smaller ones are lost behind glass, wider ones touch the next
LARGER = 1.3  # times that large dots are wider than the others: blur must not make one of the other
CLEAR_ARM = 0.7  # of the room between an edge and what is printed in the square: blur takes the rest
STAGGERED = np.sqrt(0.5) * np.array([(1.0, -1.0), (1.0, 1.0)])  # columns: its steps, along x and y
LINES = np.array([(1, -1), (1, 1)])  # of corner (i, j) of staggered rows: half pitches i - j, row i + j
LEVEL_BY = {  # index times this odd: on the other level
    "rows": (0, 1), "columns": (1, 0), "alternating": (1, 1), "staggered": (1, 1),
}  # fmt: skip
QUARTER_TURNS: tuple[tuple[Square, Square], ...] = (
    ((1, 0), (0, 1)),
    ((0, -1), (1, 0)),
    ((-1, 0), (0, -1)),
    ((0, 1), (-1, 0)),
)


@cache
def _turn_discs(
    discs: tuple[Square, ...], other: tuple[bool, ...], turn: tuple[Square, Square]
) -> frozenset[tuple[int, int, bool]]:
    """Disc squares after a turn, relative to their lowest column and row, and which are of the other kind.

    Cached, since a fit makes a stretched board for each evaluation of its residuals.
    """
    cells = np.array(discs) @ np.array(turn).T
    cells -= cells.min(axis=0)
    return frozenset((int(i), int(j), b) for (i, j), b in zip(cells, other, strict=True))


@dataclass(frozen=True)
class Chessboard(Board):
    """A chessboard target that can be found: a `Board`, and where its corners are.

    Parameters
    ----------
    scale_sigma : (float, float)
        Standard deviations of its scale on paper; 0 takes the squares to be as large as they are said to be.
    step_sigma_mm : float
        Standard deviation of the step between two levels of dots.
    origin_px : (float, float), optional
        Pixel of a frame at z = 0 at which the origin of a grid of dots without large ones is seen.

    Raises
    ------
    BoardError
        A size is not positive, a disc does not leave room for the edges, or the discs look the same after a turn
        (of dots they may, but for large ones on two levels: the camera then shows how the grid is turned).
    """

    scale_sigma: tuple[float, float] = field(default=(0.0, 0.0), kw_only=True)
    step_sigma_mm: float = field(default=0.0, kw_only=True)
    origin_px: tuple[float, float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if not (self.square_mm > 0.0 and self.disc_mm > 0.0):
            raise BoardError("square_mm and disc_mm must be positive")
        if self.squares is not None and min(self.squares) < LEAST_SQUARES:
            raise BoardError(
                f"a board of {self.squares[0]} x {self.squares[1]} squares has too few corners; use"
                f" {LEAST_SQUARES} x {LEAST_SQUARES} or more"
            )
        if self.codes is not None and (self.squares is None or self.discs):
            raise BoardError("a board with codes has so many squares, and no discs")
        if self.codes is not None and not 0.2 <= self.codes.marker_share <= WIDEST_MARKER:
            raise BoardError(
                f"markers of {self.codes.marker_share * self.square_mm:g} mm leave no clear edge in squares of"
                f" {self.square_mm:g} mm; use {WIDEST_MARKER * self.square_mm:g} mm or less"
            )
        if self.dots is not None:
            self._check_dots(self.dots)
        if not self.discs:
            return
        if self.dots is None and not self.disc_mm <= 0.6 * self.square_mm:
            raise BoardError(
                f"discs of {self.disc_mm:g} mm leave no clear edge in squares of {self.square_mm:g} mm;"
                f" use {0.6 * self.square_mm:g} mm or less"
            )
        may_repeat = self.dots is not None and not (self.dots.levels and self.has_large_dots)
        least = 1 if may_repeat else 2
        if len(set(self.discs)) != len(self.discs) or len(self.discs) < least:
            raise BoardError("the origin needs at least two discs, each in a square of its own, or none")
        if self.is_turn_symmetric and not may_repeat:
            raise BoardError(
                "the discs look the same after a turn of the board; place them so that no turn repeats"
            )

    def _check_dots(self, dots: Dots) -> None:
        """Refuse dots that cannot be found, or do not say where the origin is, and levels that are none."""
        if dots.levels and dots.levels not in LEVEL_BY:
            raise BoardError(f"levels {dots.levels!r} are not known; say one of {', '.join(LEVEL_BY)}")
        if bool(dots.levels) != (dots.step_mm != 0.0):
            raise BoardError("a plate has levels, and a step_mm from one to the other which is not 0; say both")
        if self.codes is not None:
            raise BoardError("no grid of dots has markers")
        if dots.levels and self.staggered != (dots.levels == "staggered"):
            raise BoardError("levels of a plate with staggered rows change from row to row, and only these")
        large = self.has_large_dots
        least, most = SMALLEST_DOT * self.square_mm, WIDEST_DOT * self.square_mm / (LARGER if large else 1.0)
        if not least <= dots.dot_mm <= most:
            raise BoardError(
                f"dots of {dots.dot_mm:g} mm every {self.square_mm:g} mm are too small, or leave no room for"
                f" larger ones; use {least:.3g} to {most:.3g} mm"
            )
        if large and not LARGER * dots.dot_mm <= self.disc_mm <= WIDEST_DOT * self.square_mm:
            raise BoardError(
                f"large dots of {self.disc_mm:g} mm are too like those of {dots.dot_mm:g} mm, or touch the"
                f" next; use {LARGER * dots.dot_mm:.3g} to {WIDEST_DOT * self.square_mm:.3g} mm"
            )

    def _shape(self, turn: tuple[Square, Square]) -> frozenset[tuple[int, int, bool]]:
        return _turn_discs(self.discs, tuple(self.disc_kinds().tolist()), turn)

    @property
    def has_large_dots(self) -> bool:
        """True if its discs are dots that are larger than the others."""
        return self.dots is not None and bool(self.discs) and self.dots.marks == "large"

    @property
    def pitch_mm(self) -> float:
        """Side of a square as drawn, or from dot to dot along a row."""
        return self.square_mm * (np.sqrt(2.0) if self.staggered else 1.0)

    def disc_kinds(self) -> NDArray[np.bool_]:
        """True for its discs (N,) in bright squares; of dots for triangles."""
        if self.dots is None:
            return self.is_bright(np.array(self.discs).reshape(-1, 2))
        return np.array([disc == self.dots.triangle for disc in self.discs], bool)

    @property
    def is_turn_symmetric(self) -> bool:
        """True if its marks look the same after a quarter turn or a half one, as one large dot does."""
        return len({self._shape(turn) for turn in QUARTER_TURNS}) < len(QUARTER_TURNS)

    @property
    def is_mirror_symmetric(self) -> bool:
        """True if its marks look the same in a mirror, but for a turn: three discs do, `CHIRAL` do not."""
        return self._shape(((-1, 0), (0, 1))) in {self._shape(turn) for turn in QUARTER_TURNS}

    def is_bright(self, squares: ArrayLike) -> NDArray[np.bool_]:
        """True for squares (..., 2) int that are bright apart from their disc."""
        column, row = np.moveaxis(np.asarray(squares), -1, 0)
        return np.asarray(((column + row) & 1 == 1) == self.odd_bright)

    def has_corner(self, index: ArrayLike) -> NDArray[np.bool_]:
        """True for indices (..., 2) int of corners that the board has: not those on its edges."""
        lines, index = self.outer_lines, np.asarray(index)
        there = np.ones(index.shape[:-1], dtype=bool)
        if lines is not None:
            at = self.lines_of(index)
            there = np.asarray(((at > lines[0]) & (at < lines[1])).all(axis=-1))
        return there & ~self._is_disc(index) if self.dots is not None and self.dots.marks == "missing" else there

    @property
    def steps(self) -> NDArray[np.float64]:
        """Steps of the lattice, along i and along j (columns, 2), as drawn, in squares."""
        return STAGGERED if self.staggered else np.eye(2)

    def lines_of(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Lines along x and y (..., 2) of corners (..., 2): their index, or half pitch and row where staggered."""
        return index @ LINES.T if self.staggered else index

    def along_mm(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (..., 2) of the board along the steps of the lattice [mm]: x and y where not staggered."""
        if not self.staggered:
            return points_mm
        return np.asarray((points_mm / self.scale) @ STAGGERED * self.scale)

    def on_board_mm(self, along_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the board [mm] from those along the steps of the lattice; undoes `along_mm`."""
        if not self.staggered:
            return along_mm
        return np.asarray((along_mm / self.scale) @ STAGGERED.T * self.scale)

    def nearest_index(self, points_mm: NDArray[np.float64]) -> NDArray[np.int64]:
        """Index (..., 2) of the corners nearest to points (..., 2) of the board [mm]."""
        return np.rint(self.along_mm(points_mm) / self.sides_mm).astype(np.int64)

    def corner_mm(self, index: ArrayLike) -> NDArray[np.float64]:
        """Positions (..., 2) [mm] of the corners with index (..., 2) int."""
        return self.on_board_mm(np.asarray(index, dtype=np.float64) * self.sides_mm)

    @property
    def print_sigma(self) -> tuple[float, ...]:
        """Standard deviations of its width and height, and of its step if it has one, as shares of them."""
        if self.dots is None or not self.dots.levels:
            return self.scale_sigma
        return (*self.scale_sigma, self.step_sigma_mm / abs(self.dots.step_mm))

    @property
    def depths_mm(self) -> tuple[float, ...]:
        """Depth of each of its levels behind its plane: that of the origin first, and mostly alone."""
        return (0.0,) if self.dots is None or not self.dots.levels else (0.0, self.dots.step_mm)

    def depth_mm(self, index: ArrayLike) -> NDArray[np.float64]:
        """Depth (...) [mm] of marks with index (..., 2) int behind the plane of the board."""
        index = np.asarray(index)
        if self.dots is None or not self.dots.levels:
            return np.zeros(index.shape[:-1])
        return np.where(index @ LEVEL_BY[self.dots.levels] % 2 != 0, self.dots.step_mm, 0.0)

    def place_mm(self, index: ArrayLike) -> NDArray[np.float64]:
        """Places (..., 3) [mm] of marks with index (..., 2) int: x and y on the board, z before its plane."""
        return np.concatenate((self.corner_mm(index), -self.depth_mm(index)[..., None]), axis=-1)

    def stretch(self, by: ArrayLike) -> "Chessboard":
        """Return the same board, its squares wider and higher by two factors (2,), and its step by a third."""
        wider, higher, *deeper = np.asarray(by, np.float64).tolist()
        x, y = np.multiply(self.scale, (wider, higher)).tolist()
        dots = self.dots
        if dots is not None and deeper:
            dots = replace(dots, step_mm=dots.step_mm * deeper[0])
        return replace(self, scale=(x, y), dots=dots)

    @property
    def arm(self) -> float:
        """Half width of the strips along edges [squares] in which nothing but the edge is printed."""
        return DISC_ARM if self.codes is None else min(DISC_ARM, CLEAR_ARM * 0.5 * (1.0 - self.codes.marker_share))

    def corner_sign(self, index: ArrayLike) -> NDArray[np.int8]:
        """Return +1 for corners (..., 2) int whose square to +x, +y is bright, and for dots, else -1 (...)."""
        if self.dots is not None:
            return np.ones(np.shape(index)[:-1], np.int8)
        return np.where(self.is_bright(index), np.int8(1), np.int8(-1))

    def corners_within(self, outline_mm: ArrayLike) -> NDArray[np.int64]:
        """Index (N, 2) of all corners of the board inside a polygon.

        Parameters
        ----------
        outline_mm : (M, 2) float
            Vertices in order, M >= 3; or two opposite corners of an upright box, M = 2.

        Raises
        ------
        BoardError
            The outline has fewer than two points, one that is not finite, or another shape.

        Notes
        -----
        Even-odd rule; a corner exactly on the outline may fall on either side.
        """
        outline = np.asarray(outline_mm, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 2 or not np.isfinite(outline).all():
            raise BoardError("an outline is a list of at least three finite points x, y (two for an upright box)")
        if len(outline) == 2:
            (x0, y0), (x1, y1) = outline
            outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        along = self.along_mm(outline)
        low = np.ceil(along.min(axis=0) / self.sides_mm).astype(np.int64)
        high = np.floor(along.max(axis=0) / self.sides_mm).astype(np.int64)
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        index = np.stack((columns.ravel(), rows.ravel()), axis=-1)
        return index[points_in(outline, self.corner_mm(index)) & self.has_corner(index)]

    def dot_share(self, index: ArrayLike) -> NDArray[np.float64]:
        """Diameters (...) in pitches of the dots with index (..., 2) int."""
        assert self.dots is not None
        index = np.asarray(index)
        if not self.has_large_dots:
            return np.full(index.shape[:-1], self.dots.dot_mm / self.square_mm)
        return np.where(self._is_disc(index), self.disc_mm, self.dots.dot_mm) / self.square_mm

    def _is_disc(self, index: NDArray[np.int64]) -> NDArray[np.bool_]:
        """True for indices (..., 2) that its discs have."""
        own = np.zeros(index.shape[:-1], bool)
        for disc in self.discs:
            own |= (index == np.array(disc)).all(axis=-1)
        return own

    def _beside_dots(self, drawn_mm: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Index (..., 2) of the nearest dot of points (..., 2), and how far (...) [mm] they are from its rim."""
        place = drawn_mm @ STAGGERED if self.staggered else drawn_mm
        node = np.rint(place / self.square_mm).astype(np.int64)
        away = np.linalg.norm(place - node * self.square_mm, axis=-1)
        return node, away - 0.5 * self.square_mm * self.dot_share(node)

    def from_edges_mm(self, points_mm: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Distances (N, 2) of points (N, 2) of the board [mm] from its nearest edges along x and y."""
        if self.dots is not None:
            beside = self._beside_dots(np.asarray(points_mm, np.float64) / self.scale)[1]
            return np.asarray(np.abs(beside)[:, None] * np.array(self.scale))
        place = points_mm / self.sides_mm
        return np.asarray(np.abs(place - np.rint(place)) * self.sides_mm)

    @property
    def origin_marks(self) -> str:
        """The marks of the origin, in words."""
        if self.dots is None:
            return "discs"
        return {"large": "large dots", "between": "interstitial marks", "missing": "missing dots"}[self.dots.marks]

    def shade(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Reflectance (...) of board points (..., 2) [mm]: 0 dark, 1 bright."""
        points = np.asarray(points_mm, dtype=np.float64) / self.scale  # as drawn
        if self.dots is not None:
            node, beside = self._beside_dots(points)
            inside = (beside < 0.0) & self.has_corner(node)
            for cell in self.discs if self.dots.marks == "between" else ():  # of whatever shape: as wide as a dot
                middle = self.on_board_mm((np.array(cell) + 0.5) * self.sides_mm) / self.scale
                inside |= np.linalg.norm(points - middle, axis=-1) < 0.5 * self.dots.dot_mm
            return np.where(inside, float(self.dots.bright), float(not self.dots.bright))
        squares = np.floor(points / self.square_mm).astype(np.int64)
        bright = self.is_bright(squares)
        for disc in self.discs:
            centre = (np.array(disc) + 0.5) * self.square_mm
            across, up = (points[..., axis] - centre[axis] for axis in (0, 1))
            bright = bright ^ (across**2 + up**2 < 0.25 * self.disc_mm**2)
        if self.codes is not None:
            from correction.target.codes import marker_cells  # it knows boards, and OpenCV loads slowly

            bright = bright & ~marker_cells(self, points / self.square_mm)
        lines = self.outer_lines
        if lines is not None:  # paper
            bright = bright | ~((squares >= lines[0]) & (squares < lines[1])).all(axis=-1)
        return bright.astype(np.float64)
