"""What may hang on the plane in a computer-generated picture: a board with markers, the target, particles.

The board with coloured markers along a diagonal is that of Fig. 4 of Martins et al. (2018): behind a lens one sees
at a glance which part of the plane is magnified, turned over, or shown twice.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from correction.target import Chessboard
from rtpiv.analysis.pictures.kernels.patterns import add_markers, add_particles, add_target

COLOURS = ("#ffffff", "#d62728", "#1f77b4", "#e377c2", "#ffd92f", "#ff7f0e", "#7f7f7f", "#8c564b", "#2ca02c")
ROUND = np.array([1.0, 2.0, 2.5, 5.0, 10.0])  # lengths that people like, a decade of them
SQUARES = 64.0  # across the view, as in the paper
BRIGHT_SHARE = 0.25  # of the pixels of a target at least; particles cover less


class Pattern(Protocol):
    """Something on the plane."""

    channels: ClassVar[int]

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """Add its colour at points (N, 2) [mm] to a picture (N, channels); NaN adds nothing."""


@dataclass(frozen=True)
class MarkerBoard:
    """A chessboard of `square_mm` with markers along the diagonal through the origin, in colours by turns."""

    square_mm: float
    channels: ClassVar[int] = 3

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        spacing, size = 1.2 * 2.0**0.5 * self.square_mm, 0.76 * self.square_mm
        add_markers(plane_mm, self.square_mm, spacing, size, _RGB, picture)


@dataclass(frozen=True)
class Target:
    """The target that hangs on the bench."""

    board: Chessboard
    channels: ClassVar[int] = 1

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        board = self.board
        discs = (np.array(board.discs, dtype=np.float64) + 0.5) * board.square_mm
        add_target(plane_mm, board.square_mm, discs, board.disc_mm, picture)


@dataclass(frozen=True)
class Particles:
    """Particles of `diameter_mm`, one at a random place in each square of `cell_mm`; not those of any frame."""

    cell_mm: float
    diameter_mm: float
    channels: ClassVar[int] = 1

    def add(self, plane_mm: NDArray[np.float64], picture: NDArray[np.float32]) -> None:
        """As `Pattern`."""
        add_particles(plane_mm, self.cell_mm, self.diameter_mm, picture)


def square_for(width_mm: float) -> float:
    """Side of the squares of a board that fills a view of some width [mm]: a round length, some 64 of them."""
    wanted = width_mm / SQUARES
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * ROUND[np.argmin(np.abs(np.log(ROUND * decade / wanted)))])


def shows_particles(frame: NDArray[Any]) -> bool:
    """Whether a frame (H, W) shows particles, few pixels brighter than half way, and not the target's squares."""
    some = frame[:: max(1, frame.shape[0] // 512), :: max(1, frame.shape[1] // 512)]
    low, high = np.percentile(some, (1.0, 99.0))
    return bool(np.mean(some > 0.5 * (low + high)) < BRIGHT_SHARE)


def _rgb(colour: str) -> tuple[float, float, float]:
    return (int(colour[1:3], 16) / 255.0, int(colour[3:5], 16) / 255.0, int(colour[5:7], 16) / 255.0)


_RGB = np.array([_rgb(colour) for colour in COLOURS])
