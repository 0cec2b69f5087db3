"""What corners have in common because lines and points of the print are not where they were drawn.

A printer sets whole dots.  At 600 dpi each line of a board is moved to the nearest dot, by up to 21 um, with all
its corners, and every frame shows the same board: a thousand corners in five frames then err as some fifty
columns and as many rows, not as five thousand numbers.  (`rtpiv target` draws squares of whole dots, whose lines
are moved alike; prints of others, and paper that stretches here and there, are not so kind.)

With r the residuals of corners in sigmas, g how much of r one square of the print is, u = sum g . r over all
corners of a line, in whatever frame, and p the same over all views of one point of it, pairs of different points
say

    s^2 = sum over lines (u^2 - sum p^2) / sum over lines ((sum g^2)^2 - sum over points (sum g^2)^2)

the variance of lines, whose expectation is 0 if lines are where they were drawn.  It counts if it stands out of
its noise by SIGNIFICANT.  A line that lies off by s pulls the free vector by s G, G = sum J^T g, and the
covariance of the fit, which takes corners as independent, lacks A^-1 (s^2 sum over lines G G^T) A^-1.  Points of
the board, each seen in several frames, are counted alike, by the pairs of their views, for what they share beyond
their lines.

The variances are those of the print, so corners beside the glass tell them, where there are some: a ball has a few
corners and six numbers of its own, which follow the print and leave little in their residuals, and weigh much.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIGNIFICANT = 3.0  # sigmas of a variance of zero
ENOUGH = 8  # lines or points


@dataclass(frozen=True)
class OnPrint:
    """Corners of one frame, as the print moves them.

    Parameters
    ----------
    index : (N, 2) int64
        Corner of the board.
    behind : (N,) bool
        Seen through glass.
    value : (N, 2) float64
        Residual in sigmas.
    per_square : (N, 2, 2) float64
        Columns: what one square along the board's x, along y is of it.
    rate : (N, 2, P) float64
        Derivatives of the residual by the free vector.
    """

    index: NDArray[np.int64]
    behind: NDArray[np.bool_]
    value: NDArray[np.float64]
    per_square: NDArray[np.float64]
    rate: NDArray[np.float64]


@dataclass(frozen=True)
class PrintErrors:
    """How far a print is off, in squares.

    Parameters
    ----------
    lines : (float, float)
        Standard deviation of its columns along x, and of its rows along y; 0 if nothing stands out.
    points : (float, float)
        The same of single points, from where their lines are.
    spread : (P, P) float64
        Covariance of what that pulls at the free vector with: between A^-1 and A^-1 it is that of the vector.
    """

    lines: tuple[float, float]
    points: tuple[float, float]
    spread: NDArray[np.float64]

    def __str__(self) -> str:
        """Say it; nothing if nothing stands out."""
        told = [
            f"{what} of the print lie off by {100.0 * float(np.hypot(*off)) / np.sqrt(2.0):.2g} % of a square"
            for what, off in (("lines", self.lines), ("points", self.points))
            if any(off)
        ]
        return ", ".join(told)


def print_errors(frames: Sequence[OnPrint]) -> PrintErrors:
    """Estimate how far a print is off, and what that does, from all frames of it."""
    index = np.concatenate([frame.index for frame in frames])
    value = np.concatenate([frame.value for frame in frames])
    per_square = np.concatenate([frame.per_square for frame in frames])
    told = ~np.concatenate([frame.behind for frame in frames])
    told = told if told.any() else ~told
    spread = np.zeros((frames[0].rate.shape[2],) * 2)
    point = np.unique(index, axis=0, return_inverse=True)[1].ravel()
    lines, points = list[float](), list[float]()
    for axis in range(2):
        g = per_square[:, :, axis]
        pull = np.concatenate(
            [np.einsum("nip,ni->np", f.rate, f.per_square[:, :, axis], optimize=True) for f in frames]
        )
        along = np.sum(g * value, axis=1)
        _, line = np.unique(index[:, axis], return_inverse=True)
        own, variance = np.arange(len(index)), 0.0
        for kind, member, part in ((lines, line, point), (points, point, own)):
            variance = _variance(member, part, along * told, np.sum(g * g, axis=1) * told, variance)
            kind.append(float(np.sqrt(variance)))
            if variance:
                together = np.zeros((member.max() + 1, pull.shape[1]))
                np.add.at(together, member, pull)
                spread += variance * together.T @ together
    return PrintErrors((lines[0], lines[1]), (points[0], points[1]), spread)


def _variance(
    member: NDArray[np.intp],
    part: NDArray[np.intp],
    along: NDArray[np.float64],
    weight: NDArray[np.float64],
    known: float,
) -> float:
    """Variance that the members of each group share beyond one that is known; 0 if it does not stand out.

    member (N,) number of the group; part (N,) of the part of it, in which pairs are not counted; along (N,) g . r;
    weight (N,) g . g.
    """
    own = np.bincount(part, along) ** 2
    whose = np.zeros(len(own), np.intp)
    whose[part] = member
    alike = np.sum(np.bincount(member, along) ** 2) - np.sum(own)
    pairs = np.sum(np.bincount(member, weight) ** 2) - np.sum(np.bincount(part, weight) ** 2)
    noise = np.sqrt(max(2.0 * (np.sum(np.bincount(whose, own) ** 2) - np.sum(own**2)), 0.0))  # of a sum over pairs
    beyond, several = float(alike - known * pairs), int(np.count_nonzero(np.bincount(whose) > 1))
    return beyond / float(pairs) if several >= ENOUGH and beyond > SIGNIFICANT * noise > 0.0 else 0.0
