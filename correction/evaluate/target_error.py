"""How far the target's corners lie from the regular grid in a corrected frame (Table 2 of Martins et al.).

In a perfectly corrected frame of the target, corner (i, j) stands at ((i a - x0), (y0 - j a)) / pitch.  Every
corner whose window lies in recovered nodes is measured, and its distance from there is an error of the
correction plus the noise of the measurement.  Corners whose window sees more than one branch are not
counted: half of such a window belongs to another picture of the plane.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from correction.board import Chessboard
from correction.board.corners import refine_corners
from correction.corrector import Corrector
from ground.short_repr import short_repr

# A magnified view comes out so sharp that an edge along a pixel row leaves no pixel to measure it by; a
# symmetric blur moves nothing and gives the edge a width again.
SOFTEN_PX, SOFTEN_REACH_PX = 0.6, 2
REGIONS = ("all", "seen directly", "behind glass")


@dataclass(frozen=True)
class Region:
    """Errors of the corners of one region.

    Parameters
    ----------
    expected : int
        Corners whose window is recovered.
    found : int
        Corners measured.
    bias_px, rms_px : (float, float)
        Mean and root mean square (bias included) per axis, u and v, in corrected pixels.
    largest_px : float
        Largest distance.
    """

    expected: int
    found: int
    bias_px: tuple[float, float]
    rms_px: tuple[float, float]
    largest_px: float


@short_repr
@dataclass(frozen=True)
class TargetError:
    """Errors by region; `corners` and `errors_px` keep the single corners (N, 2) for pictures."""

    regions: Mapping[str, Region]
    corners_px: NDArray[np.float64] = field(repr=False)
    errors_px: NDArray[np.float64] = field(repr=False)

    def rows(self) -> list[tuple[str, ...]]:
        """Table rows: region, corners found of expected, bias, rms, largest."""
        return [
            (
                name,
                f"{region.found} of {region.expected}",
                f"{region.bias_px[0]:+.3f}, {region.bias_px[1]:+.3f}",
                f"{region.rms_px[0]:.3f}, {region.rms_px[1]:.3f}",
                f"{region.largest_px:.2f}",
            )
            for name, region in self.regions.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """JSON-able figures; regions where nothing was found have no numbers."""
        return {
            name: vars(region) if region.found else {"expected": region.expected, "found": 0}
            for name, region in self.regions.items()
        }


def target_error(corrected: NDArray[np.float32], corrector: Corrector, board: Chessboard) -> TargetError:
    """Measure a corrected frame of the target.

    Parameters
    ----------
    corrected : ndarray of float32
        What `corrector` returned.
    corrector : Corrector
        Tells grid, mask and branches.
    board : Chessboard
        The target, at the investigation plane.

    Returns
    -------
    TargetError
        Figures for all corners, those seen directly, and those behind glass.
    """
    import cv2

    grid = corrector.map.grid
    whole = corrector.recovered & (_same_branch(corrector.map.branch[0]) > 0)
    reach = np.ones((2 * SOFTEN_REACH_PX + 1,) * 2, np.uint8)
    usable = cv2.erode(whole.astype(np.uint8), reach, borderValue=0) > 0
    soft = cv2.GaussianBlur(np.nan_to_num(corrected), (2 * SOFTEN_REACH_PX + 1,) * 2, SOFTEN_PX)
    outline = grid.to_mm(np.array([[0.0, 0.0], [grid.shape[1] - 1.0, grid.shape[0] - 1.0]]))
    index = board.corners_within(outline)
    expected = grid.to_px(board.corner_mm(index))
    square = board.square_mm / grid.pitch_mm
    window = np.ones((2 * int(0.3 * square) + 1,) * 2, np.uint8)
    inner = cv2.erode(whole.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    nearest = np.clip(np.rint(expected).astype(int), 0, np.array(grid.shape[::-1]) - 1)
    seen = inner[nearest[:, 1], nearest[:, 0]] > 0
    expected, nearest = expected[seen], nearest[seen]
    fit = refine_corners(
        soft,
        expected,
        np.array([[square, 0.0], [0.0, -square]]),
        sign=board.corner_sign(index[seen]),
        mask=usable,
    )
    errors = fit.position_px - expected
    glass = corrector.map.branch[0][nearest[:, 1], nearest[:, 0]] != 0
    chosen = dict(zip(REGIONS, (np.ones(len(glass), bool), ~glass, glass), strict=True))
    regions = {name: _region(errors[which], fit.valid[which]) for name, which in chosen.items() if which.any()}
    return TargetError(regions, expected[fit.valid], errors[fit.valid])


def _same_branch(branch: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """1 where a node and its neighbours show the same branch."""
    import cv2

    low = cv2.erode(branch, np.ones((3, 3), np.uint8))
    high = cv2.dilate(branch, np.ones((3, 3), np.uint8))
    return np.asarray(low == high, dtype=np.uint8)


def _region(errors: NDArray[np.float64], valid: NDArray[np.bool_]) -> Region:
    good = errors[valid]
    if not len(good):
        nan = (float("nan"), float("nan"))
        return Region(len(errors), 0, nan, nan, float("nan"))
    bias, rms = good.mean(axis=0), np.sqrt((good**2).mean(axis=0))
    largest = float(np.hypot(good[:, 0], good[:, 1]).max())
    return Region(
        len(errors), len(good), (float(bias[0]), float(bias[1])), (float(rms[0]), float(rms[1])), largest
    )
