"""Apparent size of the board against the camera's prediction: a wrong size, or a wrong camera.

A square is as large as the longer of its sides: one that leans is narrower one way, and as long the other.  Every
corner is compared with what is expected nearest to it, whichever that is: where a board is described with squares
of another size, no index is right.  A bare board is as much too large all over the frame; what is seen through
glass is not, and says nothing.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.target.chessboard import Chessboard

# Of the size, from the smallest tenth to the largest: noise, tilt and lens leave less, a ball more
MAX_SIZE_RANGE = 0.15
TENTHS, TENTHS_APART = (10.0, 90.0), 2.563  # per cent, and standard deviations of a normal one between them
OF_MEDIAN, SURE = 1.25, 3.0  # sigmas of a median in those of a mean; that count as sure
MIN_SIZED_CORNERS = 20  # that show a size: few of them may lie in a corner of the view, or on something else
CLEARLY_OFF = 0.03  # of the size: more than a camera that is known to a few millimetres


@dataclass(frozen=True)
class SizeSeen:
    """Side of a square, or from dot to dot, in a frame.

    Parameters
    ----------
    seen_px, expected_px : float
        As it is, and as the camera should see it, at the median of the corners.
    sigma : float
        Standard deviation of their ratio.
    board : Chessboard
        As described.
    """

    seen_px: float
    expected_px: float
    sigma: float
    board: Chessboard

    @property
    def times(self) -> float:
        """Ratio of apparent to described size."""
        return self.seen_px / self.expected_px

    def differs(self, by: float) -> bool:
        """True if it differs from the described size by more than this share and what the corners leave open."""
        return abs(self.times - 1.0) > by + SURE * self.sigma

    @property
    def sentence(self) -> str:
        """Describe apparent and expected size, and what to correct."""
        told_mm = self.board.pitch_mm
        what, wide, key = (
            ("squares", "wide", "square_mm")
            if self.board.dots is None
            else ("dots", "from one to the next", "pitch_mm")
        )
        return (
            f"the {what} in the frame are {self.seen_px:.1f} px {wide}, {self.times:.3g} times as large as the"
            f" camera should see those of {told_mm:g} mm ({self.expected_px:.1f} px); give the right {key} (about"
            f" {told_mm * self.times:.3g}), or correct focal length and distance of the camera"
        )


def size_seen(
    position_px: NDArray[np.float64],
    axes_px: NDArray[np.float64],
    view: tuple[NDArray[np.int64], NDArray[np.float64]],
    board: Chessboard,
) -> SizeSeen | None:
    """Compare corners of a lattice with a prediction; None where not all of them are as much too large.

    Parameters
    ----------
    position_px, axes_px : (N, 2) and (N, 2, 2) float64
        Corners seen, and displacement in the image by one square along each index.
    view : (M, 2) int64 and (M, 2) float64
        Board corners in view and where they are expected [px].
    board : Chessboard
        As described.
    """
    place = {(i, j): p for (i, j), p in zip(view[0].tolist(), view[1], strict=True)}
    far = len(board.depths_mm)  # of a plate the next dot but one is on the same level
    known = [(i, j) for i, j in place if {(i + far, j), (i, j + far)} <= place.keys()]
    if not known or len(position_px) < MIN_SIZED_CORNERS:
        return None
    sides = [(place[i + far, j] - place[i, j], place[i, j + far] - place[i, j]) for i, j in known]
    longer = np.linalg.norm(sides, axis=2).max(axis=1) / far
    _, nearest = scipy.spatial.cKDTree([place[corner] for corner in known]).query(position_px)
    times = np.linalg.norm(axes_px, axis=1) / longer[nearest][:, None]  # along either index
    along = times[:, int(np.median(times, axis=0).argmax())]
    low, middle, high = np.percentile(along, (TENTHS[0], 50.0, TENTHS[1])).tolist()
    if not high - low < MAX_SIZE_RANGE * middle:
        return None
    expected = float(np.median(longer[nearest]))
    sigma = OF_MEDIAN * (high - low) / TENTHS_APART / np.sqrt(len(along))
    return SizeSeen(middle * expected, expected, float(sigma), board)
