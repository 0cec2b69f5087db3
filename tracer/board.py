"""The chessboard target as a noun: what is printed, and nothing about how it looks or where its corners are.

Square (i, j) spans [i a, (i+1) a] x [j a, (j+1) a] mm, a = square_mm; squares with i + j odd are bright.  A disc
of the other shade sits in the middle of a few squares: their pattern tells the origin, and which way is up.  Who
finds the board and who prints it share this description and compute with it apart.

A printer stretches, along the feed by another factor than across it: on paper a square is `sides_mm` wide and
high.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Square = tuple[int, int]


@dataclass(frozen=True)
class Board:
    """A printed chessboard.

    Parameters
    ----------
    square_mm : float
        Side of a square.
    disc_mm : float
        Diameter of the discs.
    discs : tuple of (int, int)
        Squares (column to +x, row to +y) that carry a disc.
    scale : (float, float)
        How much larger than that it is on paper, in x and in y.
    """

    square_mm: float = 2.5
    disc_mm: float = 1.0
    discs: tuple[Square, ...] = field(default=((0, 0), (0, -1), (-1, -1)), kw_only=True)
    scale: tuple[float, float] = field(default=(1.0, 1.0), kw_only=True)

    @property
    def sides_mm(self) -> NDArray[np.float64]:
        """Width and height (2,) of a square on paper."""
        return self.square_mm * np.array(self.scale)
