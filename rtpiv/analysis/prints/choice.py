"""Choice of squares for a scene: those whose corners constrain best the ball that is seen worst.

Glass shrinks the board in its middle and squeezes it at the rim.  Small squares run into each other there and are
not measured; of large ones few corners are left.  A corner is found along its edges, so what it tells of a ball
grows with the width w of its square in the picture (its sigma falls with the root of w, see
`rtpiv.analysis.views.sigma_forecast`), and a board with N corners behind a ball says

    N mean(w)

of it.  The square with the largest least such sum over the balls is taken, as the fit itself expects the corners.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from correction.fit.seen.prediction import expect
from correction.target import Chessboard
from rtpiv.analysis.prints.pages import whole_dots
from tracer.scene.scene import Scene
from tracer.strategies.branches import branch_of
from tracer.strategies.sensitivity import TargetPose

SIDES_MM = (0.5, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0)
LEAST_PX, MOST_PX = 8.0, 60.0  # of a square seen without glass
LEAST_CODED_PX = 28.0  # the same with a marker in it, whose cells take 3 px each
WIDEST_SEARCH_PX = (
    1500.0  # a larger sensor is taken by steps of several pixels: which corners are seen is the same
)


@dataclass(frozen=True)
class Corners:
    """Corners of a board in a scene.

    Parameters
    ----------
    square_mm : float
        Side of its squares.
    direct : int
        Corners measured that no ball is before.
    behind : mapping of str to int
        Corners measured through each ball.
    worth : float
        Least sum of widths of squares over the balls [px].
    """

    square_mm: float
    direct: int
    behind: Mapping[str, int]
    worth: float

    @property
    def sentence(self) -> str:
        """Numbers of visible corners, by region."""
        if not self.behind:
            return f"squares of {self.square_mm:.4g} mm: {self.direct} corners"
        each = ", ".join(f"{count} through {name}" for name, count in self.behind.items())
        return f"squares of {self.square_mm:.4g} mm: {self.direct} corners beside the glass, {each}"


def corners_of(scene: Scene, square_mm: float, size_mm: tuple[float, float]) -> Corners:
    """Count the corners of a board in the target's plane that a fit could measure.

    Parameters
    ----------
    scene : Scene
        As planned or as fitted.
    square_mm : float
        Side of its squares.
    size_mm : (float, float)
        Width and height of the board, about the origin.

    Returns
    -------
    Corners
        Beside and behind glass.
    """
    times = max(1, int(max(scene.camera.sensor_px) / WIDEST_SEARCH_PX))
    expected = expect(scene, TargetPose((0.0, 0.0, 0.0)), Chessboard(square_mm, 0.4 * square_mm), times)
    on_board = np.all(np.abs(expected.index) * square_mm <= 0.5 * np.array(size_mm), axis=1)
    width_px = np.sqrt(np.abs(np.linalg.det(expected.axes_px)))
    names = [ball.name for ball in scene.spheres]
    behind, worth = dict.fromkeys(names, 0), dict.fromkeys(names, 0.0)
    for way in np.unique(expected.ways[on_board]):
        here = on_board & (expected.ways == way)
        for name in set(branch_of(str(way))) & set(names):
            behind[name] += int(here.sum())
            worth[name] += float(width_px[here].sum())
    direct = int((on_board & (expected.branch == 0)).sum())
    least = min(worth.values(), default=float(width_px[on_board].sum()))
    return Corners(square_mm, direct, behind, least)


def best_square(scene: Scene, size_mm: tuple[float, float], coded: bool = False) -> Corners:
    """Choose the squares of a board for a scene.

    Parameters
    ----------
    scene : Scene
        As planned or as fitted.
    size_mm : (float, float)
        Room for the board.
    coded : bool
        Whether there are markers in the squares, to be read beside the glass.

    Returns
    -------
    Corners
        Of the squares that tell most of the ball seen worst.
    """
    px_per_mm = scene.camera.focal_px / abs(scene.camera.position_mm[2])
    least_px = LEAST_CODED_PX if coded else LEAST_PX
    sides = [side for side in SIDES_MM if least_px <= side * px_per_mm <= MOST_PX] or [2.0 * least_px / px_per_mm]
    sides = [side for side in sides if min(size_mm) >= 4.0 * side] or sides[:1]
    return max((corners_of(scene, whole_dots(side), size_mm) for side in sides), key=lambda found: found.worth)
