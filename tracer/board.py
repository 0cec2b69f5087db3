"""The chessboard target as a noun: what is printed, and nothing about how it looks or where its corners are.

Square (i, j) spans [i a, (i+1) a] x [j a, (j+1) a] mm, a = square_mm; squares with i + j odd are bright.  A disc
of the other shade sits in the middle of a few squares: their pattern tells the origin, and which way is up.
Without discs a board is plain, and its origin is counted from its edges.  Who finds the board and who prints it
share this description and compute with it apart.

A grid of dots has a dot at every corner (i a, j a) instead, a its pitch, and larger ones, its discs, at a few
corners.  Where its rows are staggered by half a pitch, the lattice stands on a corner: dots of a row are a sqrt(2)
apart, rows a / sqrt(2), and corner (i, j) lies in row i + j, i - j half pitches to the right of the origin.

A printer stretches, along the feed by another factor than across it: on paper a square is `sides_mm` wide and
high.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Square = tuple[int, int]
OLDER: tuple[Square, ...] = ((0, 0), (0, -1), (-1, -1))  # discs of boards whose file names none: no mirror shows
CHIRAL: tuple[Square, ...] = (*OLDER, (0, 1))  # of new boards: in a mirror they are another figure
LARGE_DOTS: tuple[Square, ...] = (
    (0, 0),
    (1, 0),
    (0, 2),
)  # of a grid; turned by any quarter they are another figure


@dataclass(frozen=True)
class Codes:
    """Markers in the bright squares of a board, by which each says where it is (ChArUco).

    Parameters
    ----------
    dictionary : str
        OpenCV's name of the set, such as DICT_4X4_1000.
    marker_share : float
        Side of a marker in squares.
    layout : {"", "new", "legacy"}
        Which squares carry markers on a board with an even number of rows: ``legacy`` is OpenCV's before 4.6, with
        a bright square in the upper left corner. Empty where nothing says it but a frame; drawn as ``new``.
    """

    dictionary: str
    marker_share: float
    layout: str = ""


@dataclass(frozen=True)
class Dots:
    """Measures of a grid of dots, in place of squares.

    Parameters
    ----------
    dot_mm : float
        Diameter of the usual dots.
    bright : bool
        Whether dots are bright on dark; otherwise dark on bright.
    levels : {"", "rows", "columns", "alternating", "staggered"}
        Of a plate with two levels, what lies on the other level than the origin: every second row or column, or
        every second dot, like the squares of a chessboard; of staggered rows every second one.
    step_mm : float
        How far that level lies behind the origin's, which is the plane of the target; negative, before it.
    marks : {"large", "between", "missing"}
        What the discs of the board are: dots that are larger, marks in the middle of squares, between the dots, or
        dots that are left out.
    triangle : (int, int), optional
        Square whose mark is a triangle; those of all others are squares then.
    """

    dot_mm: float
    bright: bool = False
    levels: str = ""
    step_mm: float = 0.0
    marks: str = "large"
    triangle: Square | None = None


@dataclass(frozen=True)
class Board:
    """A printed chessboard, or a grid of dots.

    Parameters
    ----------
    square_mm : float
        Side of a square; from dot to dot.
    disc_mm : float
        Diameter of the discs, of a grid its large dots.
    discs : tuple of (int, int)
        Squares (column to +x, row to +y) that carry a disc, of a grid corners with a large dot; none on a plain
        board.
    squares : (int, int), optional
        Columns and rows that there are; without, it goes on for ever.
    origin_corner : (int, int), optional
        Corner at the origin, counted from the lower left one of the board; without, the one nearest to its middle.
    odd_bright : bool
        Whether squares with i + j odd are bright, as said; otherwise the others are.
    codes : Codes, optional
        Markers in its bright squares.
    dots : Dots, optional
        Of a grid of dots.
    staggered : bool
        Whether its rows are staggered by half a pitch; `squares` and `origin_corner` then count half pitches and
        rows.
    scale : (float, float)
        How much larger than that it is on paper, in x and in y.
    """

    square_mm: float = 2.5
    disc_mm: float = 1.0
    discs: tuple[Square, ...] = field(default=OLDER, kw_only=True)
    squares: tuple[int, int] | None = field(default=None, kw_only=True)
    origin_corner: tuple[int, int] | None = field(default=None, kw_only=True)
    odd_bright: bool = field(default=True, kw_only=True)
    codes: Codes | None = field(default=None, kw_only=True)
    dots: Dots | None = field(default=None, kw_only=True)
    staggered: bool = field(default=False, kw_only=True)
    scale: tuple[float, float] = field(default=(1.0, 1.0), kw_only=True)

    @property
    def sides_mm(self) -> NDArray[np.float64]:
        """Width and height (2,) of a square on paper."""
        return self.square_mm * np.array(self.scale)

    @property
    def is_plain(self) -> bool:
        """Return whether it has no mark, so that nothing but its edges says where it is."""
        return not self.discs and self.codes is None

    @property
    def outer_lines(self) -> NDArray[np.int64] | None:
        """Lowest and highest lattice line (2, 2) along x and y, the edges of the board; None if it has none."""
        if self.squares is None:
            return None
        columns, rows = self.squares
        across, up = self.origin_corner or (columns // 2, rows // 2)
        return np.array([(-across, -up), (columns - across, rows - up)])
