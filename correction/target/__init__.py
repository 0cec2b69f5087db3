"""The calibration target: what it looks like, and where its corners are in a frame.

    saddles -> lattice_growth -> board_origin -> lattice_corners (smooth_lattice, corners)

`board_search` leads through it.
"""

from correction.target.chessboard import Chessboard

__all__ = ["Chessboard"]
