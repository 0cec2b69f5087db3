"""Position errors of target points, in both senses of Table 2 of Martins et al. (2018).

1. computer-generated against acquired: where a scene says a corner is, and where the raw frame shows it;
2. corrected against the regular grid: where the corner stands in the corrected frame, and where it should.

The paper aligned its camera with the bare target and believed the stages for the glass; "nominal" here
means the same: fitted camera, nominal glass.  Regions: outside (seen directly), inside (behind glass), rim
(behind glass, within RIM_PX of the border of its branch).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from correction.evaluate.target_error import TargetError, target_errors
from correction.fit.judge.result import FittedCorners, SceneFit
from correction.fit.seen.prediction import expect
from correction.fitted.prepared import prepare
from correction.maps.corrector import Corrector
from correction.target import Chessboard
from tracer.scene.scene import Scene
from tracer.strategies.sensitivity import TargetPose

RIM_PX = 40.0
FARTHEST_PX = 60.0  # a corner predicted farther away than this counts as not predicted


@dataclass(frozen=True)
class RegionErrors:
    """Computer-generated minus acquired, one region.

    Parameters
    ----------
    region : str
    corners : int
        Corners compared.
    bias_px, rms_px : (2,) float64
        Per axis u, v in raw px; rms holds the bias.
    largest_px : float
        Largest distance.
    """

    region: str
    corners: int
    bias_px: NDArray[np.float64]
    rms_px: NDArray[np.float64]
    largest_px: float


def aligned(fit: SceneFit) -> Scene:
    """Return the nominal glass before the fitted camera."""
    return fit.unknowns.scene.with_camera(fit.scene.camera)


def computed_against_acquired(
    scene: Scene, corners: FittedCorners, frame: int, board: Chessboard
) -> tuple[list[RegionErrors], NDArray[np.float64], NDArray[np.float64]]:
    """Sense 1 for one frame at z = 0.

    Returns
    -------
    regions : list of RegionErrors
    pixel, error_px : (N, 2) float64
        Acquired pixels and computer-generated minus acquired.
    """
    chosen = np.flatnonzero((corners.frame == frame) & corners.inlier)
    expected = expect(scene, TargetPose(), board)
    pairs = []
    for behind in (False, True):
        mine = chosen[corners.behind[chosen] == behind]
        theirs = np.flatnonzero((expected.branch != 0) == behind)
        if not (len(mine) and len(theirs)):
            continue
        # One lattice corner may be on several sheets: lift indices far apart, then take the nearest pixel.
        far = 4.0 * FARTHEST_PX
        tree = scipy.spatial.cKDTree(np.c_[expected.pixel[theirs], far * expected.index[theirs]])
        away, found = tree.query(np.c_[corners.pixel[mine], far * corners.index[mine]])
        near = away < FARTHEST_PX
        pairs.append((mine[near], theirs[found[near]]))
    mine, theirs = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    error = expected.pixel[theirs] - corners.pixel[mine]
    behind, rim = corners.behind[mine], corners.rim_px[mine] < RIM_PX
    regions = {"all": behind | True, "outside": ~behind, "inside": behind & ~rim, "rim": behind & rim}
    figures = [_figures(name, error[which]) for name, which in regions.items() if which.any()]
    return figures, corners.pixel[mine], error


def corrected_against_grid(scenes: Sequence[Scene], image: NDArray[Any], board: Chessboard) -> list[TargetError]:
    """Sense 2: correct a frame of the target at z = 0 with each scene and measure it."""

    def corrected() -> Iterator[tuple[NDArray[np.float32], Corrector]]:
        for scene in scenes:
            corrector = prepare(scene).corrector
            yield corrector(image), corrector

    return target_errors(corrected(), board)


def _figures(region: str, error: NDArray[np.float64]) -> RegionErrors:
    largest = float(np.linalg.norm(error, axis=1).max())
    return RegionErrors(region, len(error), error.mean(axis=0), np.sqrt((error**2).mean(axis=0)), largest)
